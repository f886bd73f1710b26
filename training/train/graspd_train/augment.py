"""The eight symmetries of the cube about the vertical: quarter turns, with or without a mirror.

A mirrored grasp is a grasp: its closing and approach axes are mirrored, and the third axis follows from them, so that
the orientation stays a rotation. The labels of the mirrored scene are therefore exact, not approximations.
"""

from __future__ import annotations

import numpy as np

from .sample import Sample

SYMMETRIES = 8


def turned(q: np.ndarray, quarters: int) -> np.ndarray:
    """Quaternions [n, 4] after quarter turns about +z: (z-rotation) · q."""
    angle = quarters * np.pi / 4
    s, c = np.sin(angle), np.cos(angle)
    x, y, z, w = q.T
    return np.stack([c * x - s * y, c * y + s * x, c * z + s * w, c * w - s * z], axis=1).astype(q.dtype)


def mirrored(q: np.ndarray) -> np.ndarray:
    """Quaternions [n, 4] of frames whose x and z axes are mirrored at the plane x = 0, and y = z × x.

    With M = diag(-1, 1, 1), R' = M·R·diag(1, -1, 1) = Rx(π)·R·Ry(π), hence q' = i·q·j.
    """
    x, y, z, w = q.T
    return np.stack([-y, -x, w, z], axis=1)


def moved(index: np.ndarray, side: int, quarters: int, mirror: bool) -> np.ndarray:
    """Memory indices after a mirror at the middle plane of x (first) and quarter turns about the middle (second)."""
    x, y, z = index // (side * side), index // side % side, index % side
    if mirror:
        x = side - 1 - x
    for _ in range(quarters % 4):
        x, y = side - 1 - y, x
    return (x * side + y) * side + z


def transform(sample: Sample, symmetry: int) -> Sample:
    """The sample as the symmetry 0 to 7 shows it: quarter turns symmetry mod 4, mirrored first from 4 on."""
    quarters, mirror = symmetry % 4, symmetry >= 4
    volume, orientation = sample.volume, sample.contact_orientation
    if mirror:
        volume, orientation = volume[::-1], mirrored(orientation)
    # rot90 from axis 0 to axis 1 takes what lies at +x to +y.
    volume = np.ascontiguousarray(np.rot90(volume, quarters, axes=(0, 1)))
    return Sample(
        volume=volume,
        contact_index=moved(sample.contact_index, sample.side, quarters, mirror),
        contact_score=sample.contact_score,
        contact_orientation=turned(orientation, quarters),
        centroid_index=moved(sample.centroid_index, sample.side, quarters, mirror),
        centroid_score=sample.centroid_score,
    )
