"""One view of a scene with its labels, as training takes it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Sample:
    """A volume and sparse labels; voxels that are not named have score 0.

    `volume` [n, n, n], axes x, y, z. Indices are memory indices (x·n + y)·n + z. Scores are 0 to 1; orientations are
    unit quaternions x, y, z, w whose +z points from the finger into the object.
    """

    volume: np.ndarray
    contact_index: np.ndarray
    contact_score: np.ndarray
    contact_orientation: np.ndarray
    centroid_index: np.ndarray
    centroid_score: np.ndarray

    @property
    def side(self) -> int:
        """Voxels along an edge."""
        return self.volume.shape[0]

    def occupied(self, kind: str) -> np.ndarray:
        """What the volume shows occupied, as a mask over all voxels in memory order."""
        values = self.volume.reshape(-1)
        return values > 0.5 if kind == "occupancy" else (values > 0.001) & (values <= 0.5)
