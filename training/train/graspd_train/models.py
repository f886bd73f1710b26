"""The two networks: graspd's own, made for a CPU, and the reference 3D U-Net.

Both read one volume `[batch, 1, n, n, n]` (axes x, y, z, memory order x, y, z with z fastest, as the planner's grid)
and answer with `[batch, 2 + 4 or 6, n, n, n]`: the logit of contact certainty, the logit of contact centroid, and the
numbers of the contact orientation: a quaternion x, y, z, w that is not normalized yet, or the first two columns of a
rotation matrix that are not orthonormalized yet (R6D).
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

# How many numbers an orientation is.
ORIENTATION_NUMBERS = {"quaternion": 4, "r6d": 6}

# Side of the volume, voxels.
SIDE = 80


class Conv(nn.Sequential):
    """Convolution, batch norm, ReLU. The convolution has no bias: batch norm brings one."""

    def __init__(self, inputs: int, outputs: int, kernel: int = 3, stride: int = 1, padding: int | None = None):
        padding = (kernel - 1) // 2 if padding is None else padding
        super().__init__(
            nn.Conv3d(inputs, outputs, kernel, stride, padding, bias=False),
            nn.BatchNorm3d(outputs),
            nn.ReLU(inplace=True),
        )


class Residual(nn.Module):
    """Two 3³ convolutions around which the input is led past."""

    def __init__(self, width: int):
        super().__init__()
        self.first = Conv(width, width)
        self.second = nn.Conv3d(width, width, 3, padding=1, bias=False)
        self.norm = nn.BatchNorm3d(width)

    def forward(self, x: Tensor) -> Tensor:
        return torch.relu(self.norm(self.second(self.first(x))) + x)


class Up(nn.Module):
    """To twice the resolution by a transposed convolution; the encoder's features of that level are added."""

    def __init__(self, inputs: int, outputs: int):
        super().__init__()
        self.up = nn.ConvTranspose3d(inputs, outputs, 2, 2, bias=False)
        self.norm = nn.BatchNorm3d(outputs)

    def forward(self, x: Tensor, skip: Tensor) -> Tensor:
        return torch.relu(self.norm(self.up(x)) + skip)


class ContactNet(nn.Module):
    """graspd's own network: 40³ and below, at most 6 GFLOP for a volume of 80³.

    The stem takes 2³ voxels to one cell (a 6³ convolution with stride 2 is a space-to-depth followed by a 3³
    convolution); a residual encoder and decoder work on 40³, 20³, 10³ and 5³ cells, so every cell sees the whole
    volume; the head sees the features of a cell and once more its raw 2³ voxels, so that nothing of the full
    resolution is lost, and its transposed convolution (a pixel shuffle) answers for each of the 2³ voxels.
    Skips are added, not concatenated: that halves the widest layers and keeps every layer a plain convolution.
    """

    def __init__(
        self,
        orientation: str = "quaternion",
        widths: tuple[int, int, int, int] = (16, 48, 64, 96),
        blocks: tuple[int, int, int] = (1, 1, 1),
        detail: int = 32,
    ):
        super().__init__()
        w0, w1, w2, w3 = widths
        self.settings = {"widths": list(widths), "blocks": list(blocks), "detail": detail}
        self.stem = Conv(1, w0, kernel=6, stride=2, padding=2)
        self.down1 = Conv(w0, w1, kernel=2, stride=2, padding=0)
        self.encode1 = nn.Sequential(*[Residual(w1) for _ in range(blocks[0])])
        self.down2 = Conv(w1, w2, kernel=2, stride=2, padding=0)
        self.encode2 = nn.Sequential(*[Residual(w2) for _ in range(blocks[1])])
        self.down3 = Conv(w2, w3, kernel=2, stride=2, padding=0)
        self.encode3 = nn.Sequential(*[Residual(w3) for _ in range(blocks[2])])
        self.up2, self.decode2 = Up(w3, w2), Conv(w2, w2)
        self.up1, self.decode1 = Up(w2, w1), Conv(w1, w1)
        self.up0, self.decode0 = Up(w1, w0), Conv(w0, w0)
        self.features = nn.Conv3d(w0, detail, 1, bias=False)
        self.features_norm = nn.BatchNorm3d(detail)
        self.raw = nn.Conv3d(1, detail, 2, 2, bias=False)
        self.head = nn.ConvTranspose3d(detail, channels(orientation), 2, 2)
        begin_rare(self.head.bias)

    def forward(self, volume: Tensor) -> Tensor:
        x0 = self.stem(volume)
        x1 = self.encode1(self.down1(x0))
        x2 = self.encode2(self.down2(x1))
        x3 = self.encode3(self.down3(x2))
        y = self.decode2(self.up2(x3, x2))
        y = self.decode1(self.up1(y, x1))
        y = self.decode0(self.up0(y, x0))
        return self.head(torch.relu(self.features_norm(self.features(y)) + self.raw(volume)))


class Double(nn.Sequential):
    """Two 3³ convolutions of the reference."""

    def __init__(self, inputs: int, middle: int, outputs: int):
        super().__init__(Conv(inputs, middle), Conv(middle, outputs))


class ReferenceUNet(nn.Module):
    """The paper's 3D U-Net as its published code builds it: 16/32/64 channels, bottleneck 128, decoder at 80³."""

    def __init__(self, orientation: str = "quaternion", widths: tuple[int, int, int, int] = (16, 32, 64, 128)):
        super().__init__()
        self.settings = {"widths": list(widths)}

        def double(inputs: int, outputs: int) -> Double:
            return Double(inputs, outputs // 2, outputs)

        a, b, c, d = widths
        self.encode = nn.ModuleList([double(1, a), double(a, b), double(b, c)])
        self.pool = nn.MaxPool3d(2)
        self.bottom = double(c, d)
        self.up = nn.ModuleList([nn.ConvTranspose3d(w, w, 2, 2) for w in (d, c, b)])
        self.decode = nn.ModuleList([Double(d + c, c, c), Double(c + b, b, b), Double(b + a, a, a)])
        self.head = nn.Conv3d(a, channels(orientation), 1)
        begin_rare(self.head.bias)

    def forward(self, volume: Tensor) -> Tensor:
        skips = []
        x = volume
        for block in self.encode:
            x = block(x)
            skips.append(x)
            x = self.pool(x)
        x = self.bottom(x)
        for up, block, skip in zip(self.up, self.decode, reversed(skips), strict=True):
            x = block(torch.cat([up(x), skip], dim=1))
        return self.head(x)


def channels(orientation: str) -> int:
    """Channels that a network answers with: certainty, centroid and the numbers of the orientation."""
    return 2 + ORIENTATION_NUMBERS[orientation]


def begin_rare(bias: Tensor) -> None:
    """Contacts are rare: certainty and centroid begin at one in fifty, not at one in two."""
    with torch.no_grad():
        bias.zero_()
        bias[:2] = -4.0


def build(name: str, orientation: str, **settings) -> nn.Module:
    """The network of that name, `ours` or `reference`."""
    match name:
        case "ours":
            return ContactNet(orientation, **settings)
        case "reference":
            return ReferenceUNet(orientation, **settings)
    raise ValueError(f"model: found {name!r}, expected 'ours' or 'reference'")


def gflop(model: nn.Module, side: int = SIDE) -> float:
    """Floating-point operations of one forward pass at batch 1, in 10⁹; a multiplication and an addition are two."""
    from torch.utils.flop_counter import FlopCounterMode

    was_training = model.training
    device = next(model.parameters()).device
    with FlopCounterMode(display=False) as counter, torch.no_grad():
        model.eval()(torch.zeros(1, 1, side, side, side, device=device))
    model.train(was_training)
    return counter.get_total_flops() / 1e9
