"""Poses as scipy rotations, and back. Needs `pip install 'graspd[scipy]'`."""

from __future__ import annotations

from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from graspd.poses import Array, checked_pose, pose


def rotation(matrix: ArrayLike) -> Rotation:
    """The rotation of a 4 × 4 pose.

    >>> from graspd import pose
    >>> float(rotation(pose([1, 2, 3])).magnitude())
    0.0
    """
    # A copy: older versions of scipy take no arrays that cannot be written to.
    return Rotation.from_matrix(checked_pose(matrix, "matrix")[:3, :3].copy())


def pose_of(rotation: Rotation, position: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    """The 4 × 4 pose of a rotation and a position."""
    return pose(position, rotation.as_quat())
