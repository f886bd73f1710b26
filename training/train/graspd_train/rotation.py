"""Quaternions x, y, z, w and R6D (the first two columns of a rotation matrix), as tensors with numbers last."""

from __future__ import annotations

import torch
from torch import Tensor


def matrix(q: Tensor) -> Tensor:
    """Rotation matrices [..., 3, 3] of unit quaternions [..., 4]."""
    x, y, z, w = q.unbind(-1)
    rows = [
        torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)], -1),
        torch.stack([2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)], -1),
        torch.stack([2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)], -1),
    ]
    return torch.stack(rows, -2)


def r6d(q: Tensor) -> Tensor:
    """First two columns [..., 6] of the rotation matrices of unit quaternions: x axis, then y axis."""
    m = matrix(q)
    return torch.cat([m[..., 0], m[..., 1]], -1)


def normalized(v: Tensor) -> Tensor:
    """Of unit length; what has none stays 0."""
    return v / v.norm(dim=-1, keepdim=True).clamp_min(1e-12)


def inward(numbers: Tensor) -> Tensor:
    """The image of +z, finger into object, of what a network answers: [..., 4] quaternions or [..., 6] R6D."""
    if numbers.shape[-1] == 4:
        return matrix(normalized(numbers))[..., 2]
    x = normalized(numbers[..., :3])
    y = numbers[..., 3:]
    y = normalized(y - (x * y).sum(-1, keepdim=True) * x)
    return torch.linalg.cross(x, y)
