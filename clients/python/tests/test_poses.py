"""Poses: matrices and quaternions, there and back, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from graspd.poses import (
    checked_pose,
    inverse,
    matrix_from_quaternion,
    pose,
    pose_from_wire,
    pose_to_wire,
    quaternion_from_matrix,
    transform,
)


def rotations() -> list[np.ndarray]:
    random = np.random.default_rng(7)
    turns = random.normal(size=(300, 4))
    # Half turns about each axis are where a careless conversion divides by 0.
    special = np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [0, 0.6, 0.8, 0], [1, 1, 0, 1e-9]])
    return [q / np.linalg.norm(q) for q in (*turns, *special)]


def test_quaternions_agree_with_scipy() -> None:
    for q in rotations():
        matrix = matrix_from_quaternion(q)
        assert np.allclose(matrix, Rotation.from_quat(q).as_matrix(), atol=1e-12)
        back = quaternion_from_matrix(matrix)
        assert np.isclose(np.linalg.norm(back), 1) and back[3] >= 0
        assert np.isclose(abs(back @ q), 1, atol=1e-12)


def test_poses_cross_the_wire() -> None:
    for q in rotations():
        matrix = pose([0.1, -2.0, 3.5], q)
        back = pose_from_wire(pose_to_wire(matrix, "pose"))
        assert np.allclose(back, matrix, atol=1e-12)
        with pytest.raises(ValueError, match="read-only"):
            back[0, 0] = 0


def test_inverse_and_transform() -> None:
    matrix = pose([1, 2, 3], [0.5, 0.5, 0.5, 0.5])
    assert np.allclose(inverse(matrix) @ matrix, np.eye(4))
    assert np.allclose(transform(matrix, [[0, 0, 1.0]]), [[2, 2, 3]])
    assert transform(matrix, np.zeros((5, 4, 3))).shape == (5, 4, 3)


@pytest.mark.parametrize(
    ("matrix", "found"),
    [
        (np.eye(3), "shape"),
        (np.full((4, 4), np.nan), "not finite"),
        (np.diag([1, 1, -1, 1]), "no rigid motion"),
        (np.diag([2, 2, 2, 1]), "no rigid motion"),
        (np.diag([1, 1, 1, 2]), "no rigid motion"),
    ],
)
def test_what_is_no_pose_is_refused_by_name(matrix: np.ndarray, found: str) -> None:
    with pytest.raises(ValueError, match=f"^camera_pose: .*{found}"):
        checked_pose(matrix, "camera_pose")


def test_a_quaternion_of_no_length_is_refused() -> None:
    with pytest.raises(ValueError, match="quaternion"):
        pose([0, 0, 0], [0, 0, 0, 0])
