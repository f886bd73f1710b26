"""A scene as the planner reads it: the volume, where contacts are expected, and the points that the cameras saw."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from graspd import requests
from graspd.answers import workspace_from_wire
from graspd.errors import ProtocolError
from graspd.frames import IntrinsicsLike
from graspd.options import SceneOptions
from graspd.plans import Workspace
from graspd.poses import Array
from graspd.v1 import planner_service_pb2 as wire


@dataclass(frozen=True, eq=False)
class ContactField:
    """Where grasps are looked for: the focal contacts and the centred centroids (Supplementary Note 3)."""

    contacts: Array
    """Centres of the voxels in which contacts are expected (N, 3), metres, world frame."""
    inward: Array
    """Direction of a finger into the object at each of them (N, 3), unit length, world frame."""
    certainties: Array
    """How certain each contact is (N), 0 to 1."""
    centroids: Array
    """Where the middle of a grasp's contacts is expected (M, 3), metres, world frame."""
    centroid_weights: Array
    """Weight of each centroid (M)."""


@dataclass(frozen=True, eq=False)
class SceneReading:
    """What the planner makes of frames before it looks for grasps."""

    workspace: Workspace
    """The volume that was looked at."""
    contact_field: ContactField
    """Where grasps are looked for."""
    points: tuple[Array, ...]
    """What each frame saw, in its rows and columns (H, W, 3), metres, world frame; NaN where there is no return.
    Empty where no points were asked for."""
    stages: Mapping[str, float]
    """Seconds of each stage."""
    estimator: str
    """The contact estimator."""


def reading_request(
    scene: requests.Scene, intrinsics: IntrinsicsLike | None, scene_options: SceneOptions | None, max_points: int
) -> wire.ReadSceneRequest:
    """The question as a message."""
    return wire.ReadSceneRequest(
        frames=requests.frames(scene, intrinsics),
        scene_options=None if scene_options is None else scene_options.to_wire(),
        max_point_count=max_points,
    )


def reading_from_wire(message: wire.ReadSceneResponse) -> SceneReading:
    """A reading from its message.

    Raises:
        ProtocolError: If lists that belong together have different lengths.
    """
    field = message.contact_field
    contacts = _vectors(field.contacts_m, "contacts_m")
    inward = _vectors(field.inward, "inward")
    centroids = _vectors(field.centroids_m, "centroids_m")
    if not len(contacts) == len(inward) == len(field.certainties):
        raise ProtocolError(
            f"contact_field: {len(contacts)} contacts, {len(inward)} directions, {len(field.certainties)} certainties"
        )
    if len(centroids) != len(field.centroid_weights):
        raise ProtocolError(f"contact_field: {len(centroids)} centroids, {len(field.centroid_weights)} weights")
    return SceneReading(
        workspace=workspace_from_wire(message.workspace),
        contact_field=ContactField(
            contacts=contacts,
            inward=inward,
            certainties=_array(field.certainties),
            centroids=centroids,
            centroid_weights=_array(field.centroid_weights),
        ),
        points=tuple(_points(frame) for frame in message.points),
        stages={stage.name: stage.duration.ToNanoseconds() * 1e-9 for stage in message.stages},
        estimator=message.estimator,
    )


def _array(values: Sequence[float]) -> Array:
    # Over 32 bits, as they came: a list of a million numbers is slow as a list of Python's.
    narrow: NDArray[np.float32] = np.fromiter(values, dtype=np.float32, count=len(values))
    return narrow.astype(np.float64)


def _vectors(values: Sequence[float], name: str) -> Array:
    if len(values) % 3 != 0:
        raise ProtocolError(f"contact_field.{name}: found {len(values)} numbers, expected three for each")
    return _array(values).reshape(-1, 3)


def _points(message: wire.FramePoints) -> Array:
    expected = 3 * message.width * message.height
    if len(message.points_m) != expected:
        raise ProtocolError(f"points_m: found {len(message.points_m)} numbers, expected {expected}")
    return _array(message.points_m).reshape(message.height, message.width, 3)
