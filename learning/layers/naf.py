"""A U-shaped network of NAF blocks, which know neither activations nor statistics over a batch, for images and their stacks.

Source: Chen et al., Simple Baselines for Image Restoration, ECCV 2022 (NAFNet): figure 3c, sections 3.3 and 4.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Literal

import torch
import torch.nn.functional as nnf
from torch import Tensor, nn

from learning.layers.convolution import Conv3d
from learning.layers.multiscale import MultiScaleNetwork


class ChannelNorm(nn.Module):
    """Layer normalisation (Ba et al. 2016) over the channels of each pixel; without a copy where channels lie last."""

    def __init__(self, channels: int) -> None:
        """Begin with weight 1 and bias 0."""
        super().__init__()
        self.weight = nn.Parameter(torch.ones(channels))
        self.bias = nn.Parameter(torch.zeros(channels))

    def forward(self, image: Tensor) -> Tensor:
        """Return the image ``(B, C, ...)`` with mean 0 and variance 1 over C, times weight plus bias."""
        normal = nnf.layer_norm(image.movedim(1, -1), self.weight.shape, self.weight, self.bias, 1e-6)
        return normal.movedim(-1, 1)


class NafBlock(nn.Module):
    """Two residual steps: one looks at the neighbours and at the whole image, one mixes each pixel's channels."""

    def __init__(self, channels: int, dimensions: int = 2) -> None:
        """Build the block, which at first hands its input on: both residuals are scaled by 0."""
        super().__init__()
        conv = nn.Conv2d if dimensions == 2 else Conv3d
        scale = (channels, *(1,) * dimensions)
        self.norm = ChannelNorm(channels)
        self.widen = conv(channels, 2 * channels, 1)
        self.spread = conv(2 * channels, 2 * channels, 3, padding=1, groups=2 * channels)
        self.attend = conv(channels, channels, 1)
        self.narrow = conv(channels, channels, 1)
        self.beta = nn.Parameter(torch.zeros(scale))
        self.mix_norm = ChannelNorm(channels)
        self.mix_widen = conv(channels, 2 * channels, 1)
        self.mix_narrow = conv(channels, channels, 1)
        self.gamma = nn.Parameter(torch.zeros(scale))

    def forward(self, image: Tensor) -> Tensor:
        """Return an image ``(B, C, ...)`` of the same shape."""
        seen = _gate(self.spread(self.widen(self.norm(image))))
        seen = seen * self.attend(seen.mean(tuple(range(2, seen.ndim)), keepdim=True))
        image = image + self.beta * self.narrow(seen)
        return image + self.gamma * self.mix_narrow(_gate(self.mix_widen(self.mix_norm(image))))


def _gate(image: Tensor) -> Tensor:
    one, other = image.chunk(2, dim=1)
    return one * other


class NafNet(MultiScaleNetwork):
    """An encoder that halves the image and doubles its channels at each level, a decoder back, and sums between them."""

    first_weight = "intro.weight"

    def __init__(
        self,
        inputs: int,
        outputs: int,
        *,
        filters: int = 16,
        blocks: int = 1,
        levels: int = 4,
        dimensions: Literal[2, 3] = 2,
        stem: int = 1,
        start: float = 0.0,
    ) -> None:
        """Build the network; weights are drawn by torch's own rules from its generator.

        Args:
            inputs: see `MultiScaleNetwork` for this and the other sizes.
            outputs: linear.
            filters: of the first level.
            blocks: NAF blocks on each level, each way; as many on the deepest.
            levels: how many.
            dimensions: 2 or 3.
            stem: pixels per side that become channels.
            start: about what the output begins at: Adam takes hundreds of steps from 0 to the middle of a range.

        Raises:
            InputError: for sizes that `MultiScaleNetwork` refuses.
        """
        super().__init__(
            inputs, outputs, filters=filters, levels=levels, dimensions=dimensions, stem=stem, blocks=blocks
        )
        conv = nn.Conv2d if dimensions == 2 else Conv3d
        widths = [filters * 2**level for level in range(levels)]
        self.intro = conv(inputs * stem**2, filters, 3, padding=1)
        self.down = nn.ModuleList(_blocks(width, blocks, dimensions) for width in widths)
        self.shrink = nn.ModuleList(conv(a, b, 2, stride=2) for a, b in pairwise(widths))
        self.enlarge = nn.ModuleList(_Enlarge(b, a, dimensions) for a, b in pairwise(widths))
        self.up = nn.ModuleList(_blocks(width, blocks, dimensions) for width in widths[:-1])
        self.head = conv(filters, outputs * stem**2, 3, padding=1)
        assert self.head.bias is not None
        nn.init.constant_(self.head.bias, start)

    def body(self, image: Tensor) -> Tensor:
        """Return ``(B, outputs * stem ** 2, ...)`` of ``(B, inputs * stem ** 2, ...)``, sides divisible by 2^(levels - 1)."""
        # Layer normalisation and 1 x 1 convolutions read the channels of a pixel side by side
        layout = torch.channels_last if self.dimensions == 2 else torch.channels_last_3d
        image = self.intro(image.contiguous(memory_format=layout))
        skips: list[Tensor] = []
        for blocks, shrink in zip(self.down[:-1], self.shrink, strict=True):
            skips.append(blocks(image))
            image = shrink(skips[-1])
        image = self.down[-1](image)
        for enlarge, blocks in zip(reversed(self.enlarge), reversed(self.up), strict=True):
            image = blocks(enlarge(image) + skips.pop())
        return self.head(image)


class _Enlarge(nn.Module):
    """Twice the size: in 2D each pixel's channels become 2 x 2 pixels (Shi et al. 2016), in 3D the nearest's value."""

    def __init__(self, inputs: int, outputs: int, dimensions: int) -> None:
        super().__init__()
        self.flat = dimensions == 2
        conv, many = (nn.Conv2d, 4) if self.flat else (Conv3d, 1)
        self.mix = conv(inputs, many * outputs, 1, bias=False)

    def forward(self, image: Tensor) -> Tensor:
        mixed = self.mix(image)
        return nnf.pixel_shuffle(mixed, 2) if self.flat else nnf.interpolate(mixed, scale_factor=2.0, mode="nearest")


def _blocks(channels: int, many: int, dimensions: int) -> nn.Sequential:
    return nn.Sequential(*(NafBlock(channels, dimensions) for _ in range(many)))
