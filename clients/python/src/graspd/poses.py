"""Poses as 4 × 4 matrices: between matrices, unit quaternions and the wire.

A pose named `a_from_b` takes homogeneous coordinates in frame b to coordinates in frame a. Metres.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from graspd.v1 import geometry_pb2 as wire

Array: TypeAlias = NDArray[np.float64]
"""An array of double precision."""

_RIGID_TOLERANCE = 1e-3


def pose(position: ArrayLike = (0.0, 0.0, 0.0), quaternion_xyzw: ArrayLike = (0.0, 0.0, 0.0, 1.0)) -> Array:
    """A 4 × 4 pose from a position (metres) and a unit quaternion (x, y, z, w).

    >>> pose([0.1, 0.2, 0.3])[:3, 3].tolist()
    [0.1, 0.2, 0.3]
    """
    matrix = np.eye(4)
    matrix[:3, :3] = matrix_from_quaternion(quaternion_xyzw)
    matrix[:3, 3] = _vector(position, "position")
    return matrix


def matrix_from_quaternion(quaternion_xyzw: ArrayLike) -> Array:
    """The 3 × 3 rotation of a quaternion (x, y, z, w) of any length but 0.

    Raises:
        ValueError: If there are not four finite numbers, or all of them are 0.
    """
    q = np.asarray(quaternion_xyzw, dtype=np.float64)
    if q.shape != (4,) or not np.isfinite(q).all() or not q.any():
        raise ValueError(f"quaternion: found {q.tolist()}, expected four finite numbers that are not all 0")
    x, y, z, w = q / np.linalg.norm(q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def quaternion_from_matrix(rotation: ArrayLike) -> Array:
    """The unit quaternion (x, y, z, w) of a 3 × 3 rotation or a 4 × 4 pose; w is not negative."""
    r = np.asarray(rotation, dtype=np.float64)[:3, :3]
    # The largest of the four squares is divided by, so no precision is lost (Shepperd's method).
    diagonal = np.array([r[0, 0], r[1, 1], r[2, 2]])
    squares = np.append(2 * diagonal - diagonal.sum(), diagonal.sum())
    k = int(np.argmax(squares))
    q = np.empty(4)
    if k == 3:
        q[:] = [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], 1 + squares[3]]
    else:
        i, j, m = k, (k + 1) % 3, (k + 2) % 3
        q[i] = 1 + squares[k]
        q[j] = r[j, i] + r[i, j]
        q[m] = r[m, i] + r[i, m]
        q[3] = r[m, j] - r[j, m]
    q /= np.linalg.norm(q)
    unit: Array = -q if q[3] < 0 else q
    return unit


def checked_pose(matrix: ArrayLike, name: str) -> Array:
    """A 4 × 4 matrix that is a rigid motion, as doubles.

    Raises:
        ValueError: Naming `name`, what was found and what was expected.
    """
    m = np.asarray(matrix, dtype=np.float64)
    if m.shape != (4, 4):
        raise ValueError(f"{name}: found an array of shape {m.shape}, expected a 4 × 4 pose")
    if not np.isfinite(m).all():
        raise ValueError(f"{name}: found numbers that are not finite, expected a 4 × 4 pose")
    r = m[:3, :3]
    rigid = np.abs(r @ r.T - np.eye(3)).max() < _RIGID_TOLERANCE and np.linalg.det(r) > 0
    if not rigid or not np.allclose(m[3], [0, 0, 0, 1], atol=1e-9):
        raise ValueError(
            f"{name}: found a matrix that is no rigid motion, expected a right-handed rotation, a translation in "
            "the last column and a last row of 0, 0, 0, 1"
        )
    return m


def transform(matrix: Array, points: ArrayLike) -> Array:
    """Points (… × 3) moved by a 4 × 4 pose.

    >>> transform(pose([1, 0, 0]), [[0, 0, 0], [0, 2, 0]]).tolist()
    [[1.0, 0.0, 0.0], [1.0, 2.0, 0.0]]
    """
    p = np.asarray(points, dtype=np.float64)
    moved: Array = p @ matrix[:3, :3].T + matrix[:3, 3]
    return moved


def inverse(matrix: Array) -> Array:
    """The inverse of a rigid motion: `a_from_b` becomes `b_from_a`."""
    m = np.eye(4)
    m[:3, :3] = matrix[:3, :3].T
    m[:3, 3] = -matrix[:3, :3].T @ matrix[:3, 3]
    return m


def _vector(values: ArrayLike, name: str) -> Array:
    v = np.asarray(values, dtype=np.float64)
    if v.shape != (3,):
        raise ValueError(f"{name}: found an array of shape {v.shape}, expected three numbers")
    return v


def vector_to_wire(values: ArrayLike, name: str) -> wire.Vector3:
    """Three numbers as a message; what they may be is for the server to say."""
    x, y, z = _vector(values, name).tolist()
    return wire.Vector3(x=x, y=y, z=z)


def pose_to_wire(matrix: ArrayLike, name: str) -> wire.Pose:
    """A 4 × 4 pose as a message.

    Raises:
        ValueError: If it is not a rigid motion.
    """
    m = checked_pose(matrix, name)
    x, y, z, w = quaternion_from_matrix(m).tolist()
    return wire.Pose(position=vector_to_wire(m[:3, 3], name), orientation=wire.Quaternion(x=x, y=y, z=z, w=w))


def vector_from_wire(message: wire.Vector3) -> Array:
    """A message as an array of three numbers that cannot be written to."""
    return frozen(np.array([message.x, message.y, message.z]))


def pose_from_wire(message: wire.Pose) -> Array:
    """A message as a 4 × 4 pose that cannot be written to."""
    p, q = message.position, message.orientation
    return frozen(pose([p.x, p.y, p.z], [q.x, q.y, q.z, q.w]))


def frozen(array: Array) -> Array:
    """The array, which cannot be written to any more: answers are shared, not copied."""
    array.setflags(write=False)
    return array
