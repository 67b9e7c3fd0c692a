"""U-Nets: sizes, what a pixel sees, translation, initial weights, number formats."""

from itertools import pairwise

import numpy as np
import pytest
import torch
from torch import nn

from learning.layers.unet import GridAttention, UNet
from simulator.errors import InputError


@pytest.mark.parametrize("attention", [False, True])
@pytest.mark.parametrize(("size", "stem"), [((16, 16), 1), ((17, 19), 1), ((1, 30), 1), ((24, 20), 2), ((13, 21), 4)])
def test_any_size_of_image(size, stem, attention):
    network = UNet(5, 2, filters=4, levels=3, attention=attention, stem=stem).eval()
    assert network(torch.rand(2, 5, *size)).shape == (2, 2, *size)


@pytest.mark.parametrize("size", [(1, 8, 8), (2, 9, 7), (5, 16, 12)])
def test_any_number_of_frames(size):
    network = UNet(3, 4, filters=2, levels=3, dimensions=3, attention=True).eval()
    assert network(torch.rand(2, 3, *size)).shape == (2, 4, *size)


@pytest.mark.parametrize("stem", [1, 2])
def test_odd_sizes_are_continued_at_their_ends(stem):
    network = UNet(1, 1, filters=4, levels=3, stem=stem).eval()
    image = torch.rand(1, 1, 15, 13)
    continued = nn.functional.pad(image, (0, 3, 0, 1), mode="replicate")
    with torch.no_grad():
        torch.testing.assert_close(network(image), network(continued)[..., :15, :13])


def seen(levels: int, at: int, size: int) -> tuple[int, int]:
    """Return the first and last input sample that an output sample depends on, level by level."""
    low = high = at
    for _ in range(levels - 1):
        low, high = low - 3, high + 3  # the merging block's two convolutions and the one after enlarging
        low, high = low // 2, high // 2
    low, high = low - 2, high + 2
    for _ in range(levels - 1):
        low, high = 2 * low - 2, 2 * high + 1 + 2
    return max(low, 0), min(high, size - 1)


@pytest.mark.parametrize(("levels", "size", "at"), [(1, 16, 7), (2, 40, 20), (2, 40, 21), (3, 96, 45)])
def test_receptive_field(levels, size, at):
    torch.manual_seed(0)
    network = UNet(1, 1, filters=3, levels=levels).eval()
    touched = torch.zeros(size, size, dtype=torch.bool)
    for _ in range(12):  # a maximum passes one sample at a time, so several images together touch all
        image = torch.rand(1, 1, size, size, requires_grad=True)
        network(image)[0, 0, at, at].backward()
        assert image.grad is not None
        touched |= image.grad[0, 0] != 0
    low, high = seen(levels, at, size)
    rows, columns = (np.flatnonzero(touched.any(axis).numpy()) for axis in (1, 0))
    assert (rows[0], rows[-1], columns[0], columns[-1]) == (low, high, low, high)


@pytest.mark.parametrize(("attention", "stem", "shift"), [(False, 1, 4), (True, 1, 4), (False, 2, 8)])
def test_output_moves_with_the_input(attention, stem, shift):
    """By multiples of what the deepest level's pixel spans; away from the borders, beyond what a pixel sees."""
    torch.manual_seed(0)
    network = UNet(2, 1, filters=4, levels=3, attention=attention, stem=stem).eval()
    size, border = 96 * stem, 30 * stem
    image = torch.rand(1, 2, size, size)
    moved = torch.roll(image, (shift, -shift), (-2, -1))
    inside = np.s_[..., border:-border, border:-border]
    with torch.no_grad():
        once, then = torch.roll(network(image), (shift, -shift), (-2, -1)), network(moved)
        other = network(torch.roll(image, (shift, -shift + 1), (-2, -1)))
    torch.testing.assert_close(then[inside], once[inside], atol=1e-5, rtol=0)  # float32 sums of 100 terms
    assert float((other - once)[inside].abs().max()) > 1e-3


def test_weights_are_drawn_by_xaviers_rule():
    torch.manual_seed(0)
    network = UNet(24, 4, filters=64, levels=3, attention=True)
    checked = 0
    for module in network.modules():
        if isinstance(module, nn.Conv2d):
            taps = module.kernel_size[0] * module.kernel_size[1]
            limit = (6 / (taps * (module.in_channels + module.out_channels))) ** 0.5  # Glorot and Bengio, equation 16
            weight = module.weight.detach()
            assert float(weight.abs().max()) <= limit
            if weight.numel() > 20_000:
                checked += 1
                # Uniform: limit / sqrt(3); of 20 000 draws within 0.4 % at one sigma
                assert float(weight.std()) == pytest.approx(limit / 3**0.5, rel=0.02)
            assert module.bias is None or not module.bias.detach().any()
    assert checked >= 8


def test_number_of_parameters_of_the_thesis_size():
    """64 to 1024 channels in 5 blocks; counted layer by layer."""
    widths, inputs, outputs = [64, 128, 256, 512, 1024], 24, 4

    def block(a, b):
        return 9 * a * b + 2 * b + 9 * b * b + 2 * b  # two convolutions without bias, two normalisations

    down = sum(block(a, b) for a, b in zip([inputs, *widths[:-1]], widths, strict=True))
    up = sum(9 * b * a + a + block(2 * a, a) for a, b in pairwise(widths))
    gates = sum(4 * a * (a // 2) + (b + 1) * (a // 2) + (a // 2 + 1) + (a + 1) * a + 2 * a for a, b in pairwise(widths))
    head = (widths[0] + 1) * outputs
    for attention, wanted in ((False, down + up + head), (True, down + up + head + gates)):
        with torch.device("meta"):
            network = UNet(inputs, outputs, filters=64, levels=5, attention=attention)
        assert sum(parameter.numel() for parameter in network.parameters()) == wanted


def test_channels_last_gives_the_same():
    torch.manual_seed(0)
    network, image = UNet(3, 2, filters=8, levels=3, attention=True).eval(), torch.rand(2, 3, 24, 24)
    with torch.no_grad():
        plain = network(image)
        other = network.to(memory_format=torch.channels_last)(image.to(memory_format=torch.channels_last))
    torch.testing.assert_close(other, plain, atol=1e-5, rtol=1e-4)  # another order of float32 sums


def test_bfloat16_autocast_trains():
    torch.manual_seed(0)
    network, image = UNet(3, 2, filters=8, levels=3, attention=True), torch.rand(2, 3, 24, 24)
    with torch.no_grad():
        plain = network.eval()(image)
        with torch.autocast("cpu", torch.bfloat16):
            mixed = network(image)
    assert mixed.dtype == torch.bfloat16
    assert float((mixed - plain).abs().mean() / plain.abs().mean()) < 0.05  # 8 bits of mantissa through 20 layers
    network.train()
    with torch.autocast("cpu", torch.bfloat16):
        network(image).float().square().mean().backward()
    gradients = [parameter.grad for parameter in network.parameters()]
    assert all(g is not None and g.dtype == torch.float32 and bool(torch.isfinite(g).all()) for g in gradients)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_attention_weighs_every_place_of_the_skip(dimensions):
    """With the mixing taken away the gate is a factor between 0 and 1, one for all channels, that both inputs decide."""
    torch.manual_seed(0)
    gate = GridAttention(6, 10, dimensions).eval()
    gate.mix = nn.Identity()
    size = (8,) * dimensions
    skip, coarse = torch.rand(2, 6, *size) + 0.1, torch.rand(2, 10, *(4,) * dimensions)
    with torch.no_grad():
        factor = gate(skip, coarse) / skip
        elsewhere = gate(skip, coarse + 1) / skip
    torch.testing.assert_close(factor, factor[:, :1].expand_as(factor))
    assert 0 < float(factor.min()) < float(factor.max()) < 1
    assert float((elsewhere - factor).abs().max()) > 1e-3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [({"filters": 0}, "^filters: "), ({"levels": 0}, "^levels: "), ({"dimensions": 4}, "^dimensions: "),
     ({"dimensions": 3, "stem": 2}, "^dimensions: ")],
)  # fmt: skip
def test_refuses(arguments, message):
    with pytest.raises(InputError, match=message):
        UNet(3, 2, **arguments)
