"""A scene to try things with where there is no camera at hand: a box on a table, seen from above."""

from __future__ import annotations

from typing import cast

import numpy as np
from numpy.typing import NDArray

from graspd.frames import DepthFrame, Intrinsics
from graspd.poses import Array

BOX_SIZE = (0.04, 0.07, 0.08)
"""The box: width, depth and height, metres. It stands in the middle of the table z = 0."""

_WIDTH, _HEIGHT, _FOCAL = 320, 240, 300.0
_EYE, _TARGET = np.array([0.05, -0.30, 0.55]), np.array([0.0, 0.0, 0.02])


def camera_pose() -> Array:
    """Where the camera stands, world_from_camera: half a metre above the table, looking at the foot of the box."""
    forward = (_TARGET - _EYE) / np.linalg.norm(_TARGET - _EYE)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = np.column_stack([right, np.cross(forward, right), forward])
    matrix[:3, 3] = _EYE
    return matrix


def box_on_table(*, box: bool = True) -> tuple[NDArray[np.uint16], Intrinsics]:
    """A depth image in millimetres and its lens; without the box, an empty table."""
    lens = Intrinsics(_FOCAL, _FOCAL, _WIDTH / 2 - 0.5, _HEIGHT / 2 - 0.5)
    pose = camera_pose()
    rays = lens.rays(_WIDTH, _HEIGHT) @ pose[:3, :3].T
    depth = -pose[2, 3] / rays[..., 2]
    if box:
        half = np.array(BOX_SIZE) / 2
        center = np.array([0.0, 0.0, half[2]])
        # Where each ray enters and leaves the box (the slab method); no ray of this view is parallel to a face.
        near, far = (center - half - pose[:3, 3]) / rays, (center + half - pose[:3, 3]) / rays
        enter, leave = np.minimum(near, far).max(axis=-1), np.maximum(near, far).min(axis=-1)
        depth = np.where(enter < leave, np.minimum(enter, depth), depth)
    return cast("NDArray[np.uint16]", np.rint(depth * 1000).astype(np.uint16)), lens


def box_frame() -> DepthFrame:
    """The same as a frame whose camera's pose is known: plans come in the table's frame, z up."""
    depth, lens = box_on_table()
    return DepthFrame(depth, lens, camera_pose=camera_pose(), world_frame="table")
