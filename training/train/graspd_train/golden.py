"""Small networks with random weights and PyTorch's answers: `python -m graspd_train.golden ../../inference/tests/models`.

The inference's tests compare with them. Every voxel of the volume is a number that both sides make from its index;
of the answers every eighth voxel is kept: certainty, centroid, orientation, 32-bit little-endian.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import torch
from torch import nn

from .export import to_onnx, write
from .models import build

SIDE = 16
EVERY = 8

MODELS = {
    # Widths that are no multiples of a vector, below and above one.
    "ours-tsdf-quaternion": ("ours", "tsdf", "quaternion", {"widths": (8, 18, 4, 4), "blocks": (1, 0, 0), "detail": 24}),
    "ours-occupancy-r6d": ("ours", "occupancy", "r6d", {"widths": (8, 4, 4, 12), "blocks": (0, 2, 1), "detail": 4}),
    "reference-tsdf-quaternion": ("reference", "tsdf", "quaternion", {"widths": (4, 8, 4, 8)}),
}


def volume(side: int = SIDE) -> np.ndarray:
    """A volume of numbers 0 to 1 that follow from the voxel's index alone."""
    index = np.arange(side**3, dtype=np.uint64)
    return ((index * 2654435761 % 2**32 >> 8) / 2**24).astype(np.float32).reshape(side, side, side)


def randomized(net: nn.Module, side: int = SIDE) -> nn.Module:
    """The network with batch norms that do something, so that folding them shows."""
    net.train()
    with torch.no_grad():
        for part in net.modules():
            if isinstance(part, nn.BatchNorm3d):
                part.weight.uniform_(0.5, 1.5)
                part.bias.normal_(0, 0.3)
        for _ in range(4):
            net(torch.rand(2, 1, side, side, side))
    return net.eval()


def main(folder: Path) -> None:
    """Writes models and answers."""
    for name, (model, kind, orientation, settings) in MODELS.items():
        torch.manual_seed(7)
        net = randomized(build(model, orientation, **settings))
        write(to_onnx(net, kind, orientation, side=SIDE), folder / f"{name}.onnx")
        with torch.no_grad():
            answer = net(torch.from_numpy(volume())[None, None])[0].reshape(-1, SIDE**3)
        answer[:2] = answer[:2].sigmoid()
        kept = answer[:, ::EVERY].T.contiguous()
        (folder / f"{name}.f32").write_bytes(kept.numpy().astype("<f4").tobytes())


if __name__ == "__main__":
    main(Path(sys.argv[1]))
