"""Symmetries of the cube about the vertical."""

import numpy as np
import torch

from graspd_train import rotation
from graspd_train.augment import SYMMETRIES, mirrored, transform, turned
from graspd_train.sample import Sample


def random_sample(rng: np.random.Generator, side: int = 6) -> Sample:
    contacts = np.sort(rng.choice(side**3, 20, replace=False))
    q = rng.normal(size=(20, 4)).astype(np.float32)
    return Sample(
        volume=rng.random((side, side, side)).astype(np.float32),
        contact_index=contacts,
        contact_score=rng.random(20).astype(np.float32),
        contact_orientation=q / np.linalg.norm(q, axis=1, keepdims=True),
        centroid_index=np.sort(rng.choice(side**3, 5, replace=False)),
        centroid_score=rng.random(5).astype(np.float32),
    )


def axes(q: np.ndarray) -> np.ndarray:
    return rotation.matrix(torch.from_numpy(q)).numpy()


def linear(symmetry: int) -> np.ndarray:
    """What a symmetry does to directions."""
    turn = np.linalg.matrix_power(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), symmetry % 4)
    return turn @ np.diag([-1.0, 1, 1]) if symmetry >= 4 else turn


def test_every_symmetry_moves_volume_labels_and_directions_alike():
    sample = random_sample(np.random.default_rng(1))
    side = sample.side
    seen = set()
    for symmetry in range(SYMMETRIES):
        moved, m = transform(sample, symmetry), linear(symmetry)
        seen.add(moved.volume.tobytes())
        # The value at a voxel is found again where the linear map takes the voxel.
        for before, after in zip(sample.contact_index, moved.contact_index, strict=True):
            place = np.array(np.unravel_index(before, (side,) * 3)) - (side - 1) / 2
            there = tuple(np.round(m @ place + (side - 1) / 2).astype(int))
            assert np.ravel_multi_index(there, (side,) * 3) == after
            assert moved.volume[there] == sample.volume.reshape(-1)[before]
        for before, after in zip(sample.centroid_index, moved.centroid_index, strict=True):
            assert moved.volume.reshape(-1)[after] == sample.volume.reshape(-1)[before]
        # Inward direction and approach are moved like any direction; what comes out is a rotation.
        old, new = axes(sample.contact_orientation), axes(moved.contact_orientation)
        np.testing.assert_allclose(new[..., 2], old[..., 2] @ m.T, atol=1e-6)
        np.testing.assert_allclose(new[..., 0], old[..., 0] @ m.T, atol=1e-6)
        np.testing.assert_allclose(np.linalg.det(new), 1, atol=1e-5)
    assert len(seen) == SYMMETRIES


def test_four_quarters_and_two_mirrors_change_nothing():
    q = random_sample(np.random.default_rng(2)).contact_orientation
    for again in (turned(turned(q, 3), 1), mirrored(mirrored(q))):
        np.testing.assert_allclose(np.abs((again * q).sum(1)), 1, atol=1e-6)
