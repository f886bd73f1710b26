"""Costs and shapes of the networks."""

import pytest
import torch

from graspd_train.models import ORIENTATION_NUMBERS, build, gflop


@pytest.mark.parametrize("orientation", list(ORIENTATION_NUMBERS))
def test_ours_costs_at_most_six_gflop_and_eight_megabytes(orientation):
    net = build("ours", orientation)
    assert gflop(net) <= 6.0
    assert sum(p.numel() for p in net.parameters()) * 4 <= 8e6


def test_reference_costs_what_was_counted_of_the_published_graph():
    net = build("reference", "quaternion")
    assert gflop(net) == pytest.approx(59.9, abs=0.1)
    assert sum(p.numel() for p in net.parameters()) == pytest.approx(1.19e6, rel=0.01)


def by_hand(side: int) -> float:
    """The cost of our network, layer by layer: 2 · cells · kernel³ · inputs · outputs."""
    def conv(cells, kernel, inputs, outputs):
        return 2 * cells**3 * kernel**3 * inputs * outputs

    a, b, c, d = side // 2, side // 4, side // 8, side // 16
    layers = [
        conv(a, 6, 1, 16), conv(b, 2, 16, 48), 2 * conv(b, 3, 48, 48), conv(c, 2, 48, 64), 2 * conv(c, 3, 64, 64),
        conv(d, 2, 64, 96), 2 * conv(d, 3, 96, 96), conv(d, 2, 96, 64), conv(c, 3, 64, 64), conv(c, 2, 64, 48),
        conv(b, 3, 48, 48), conv(b, 2, 48, 16), conv(a, 3, 16, 16), conv(a, 1, 16, 32), conv(a, 2, 1, 32),
        conv(a, 2, 32, 6),
    ]
    return sum(layers) / 1e9


def test_the_counter_counts_every_layer():
    assert gflop(build("ours", "quaternion")) == pytest.approx(by_hand(80), rel=1e-6)


@pytest.mark.parametrize("model", ["ours", "reference"])
@pytest.mark.parametrize("orientation", list(ORIENTATION_NUMBERS))
def test_every_voxel_gets_an_answer_that_depends_on_it(model, orientation):
    net = build(model, orientation).eval()
    volume = torch.rand(1, 1, 16, 16, 16, requires_grad=True)
    answer = net(volume)
    assert answer.shape == (1, 2 + ORIENTATION_NUMBERS[orientation], 16, 16, 16)
    # Neighbouring voxels of one cell are told apart: gradients of their answers differ.
    (a,) = torch.autograd.grad(answer[0, 0, 8, 8, 8], volume, retain_graph=True)
    (b,) = torch.autograd.grad(answer[0, 0, 8, 8, 9], volume)
    assert a[0, 0, 8, 8, 8] != 0
    assert not torch.allclose(a, b)
