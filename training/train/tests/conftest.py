"""Small shards with balls in them, whose labels follow a rule that a network can learn."""

from __future__ import annotations

import json
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest

SIDE = 16


def quaternions_to(direction: np.ndarray) -> np.ndarray:
    """Unit quaternions [n, 4] that take +z to the directions [n, 3], w ≥ 0."""
    x, y, z = direction.T
    q = np.stack([-y, x, np.zeros_like(x), 1 + z], axis=1)
    q[np.linalg.norm(q, axis=1) < 1e-6] = [1, 0, 0, 0]
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def ball(rng: np.random.Generator, scene: int, view: int) -> bytes:
    """The payload of a view of one ball: contacts around it that point at its middle, centroids inside."""
    middle, radius = rng.uniform(6, SIDE - 6, 3), rng.uniform(2.0, 3.5)
    grid = np.stack(np.meshgrid(*[np.arange(SIDE) + 0.5] * 3, indexing="ij"), -1).reshape(-1, 3)
    away = grid - middle
    distance = np.linalg.norm(away, axis=1) - radius
    tsdf = np.clip(distance / 8 + 1, 0, 2) / 2
    tsdf[np.abs(distance) > 7.8] = 0
    contacts = np.flatnonzero((distance > 0.2) & (distance < 1.5))
    centroids = np.flatnonzero(distance < -radius / 2)
    inward = -away[contacts] / np.linalg.norm(away[contacts], axis=1, keepdims=True)
    out = struct.pack("<III", scene, view, SIDE)
    out += np.eye(4, dtype="<f4").tobytes() * 2 + struct.pack("<f", 0.1)
    out += np.round(tsdf * 255).astype("u1").tobytes()
    out += np.packbits(distance < 0.2, bitorder="little").tobytes()
    out += struct.pack("<I", len(contacts)) + contacts.astype("<u4").tobytes() + b"\xff" * len(contacts)
    out += np.round(quaternions_to(inward) * 32767).astype("<i2").tobytes()
    out += struct.pack("<I", len(centroids)) + centroids.astype("<u4").tobytes() + b"\xff" * len(centroids)
    return out + struct.pack("<HH", 0, 0)


def write_shard(path: Path, scenes: int, views: int, seed: int) -> None:
    """A shard 0 of 1 of scenes with one ball each view."""
    header = json.dumps({
        "format": "graspd contact dataset", "program": "test", "commit": None, "seed": seed, "scenes": scenes,
        "views": views, "shard": [0, 1], "grid": {"resolution": SIDE, "size_m": 0.08}, "truncation_voxels": 8.0,
        "sensor": "none", "families": "all", "objects": ["ball"], "recipe": {},
    }).encode()
    rng = np.random.default_rng(seed)
    out = b"GCDS" + struct.pack("<III", 1, len(header), zlib.crc32(header)) + header
    for k in range(scenes * views):
        packed = zlib.compress(ball(rng, k // views, k % views))
        out += struct.pack("<II", len(packed), zlib.crc32(packed)) + packed
    path.write_bytes(out)


@pytest.fixture(scope="session")
def balls(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of 40 scenes of two views."""
    folder = tmp_path_factory.mktemp("balls")
    write_shard(folder / "contacts-00000-of-00001.gcd", scenes=40, views=2, seed=3)
    return folder
