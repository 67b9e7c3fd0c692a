"""Random weights, and the scales that make their features worth comparing.

A randomly weighted network serves as perceptual loss if its features are normalised: Liu et al., Generic Perceptual Loss for
Modeling Structured Output Dependencies, CVPR 2021, arXiv 2103.10571. Weights are drawn as by He et al., arXiv 1502.01852, and
each channel of the compared features is divided by its spread over random pictures, so that two unlike pictures are about 1
apart whatever the seed; means drop out of differences. Fixed spreads, not those of the pictures at hand, let contrast count
and leave no picture to divide by nothing. Normalising after every convolution was tried and made the features chaotic: noise
of 0.01 gave 8 % of the distance of unlike pictures, noise of 0.3 2600 %; here 1 % and 450 %.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn
from torch.nn.functional import interpolate

_PICTURES, _PIXELS = 16, 64

_LEAST_SPREAD = 0.1  # of the median: channels that hardly ever leave zero must not outweigh the others when they do


def draw_weights(features: nn.Sequential, generator: torch.Generator) -> None:
    """Draw all weights of the convolutions as He et al. do for ReLUs, from this generator only; biases become zero."""
    for layer in features:
        if isinstance(layer, nn.Conv2d):
            nn.init.kaiming_normal_(layer.weight, nonlinearity="relu", generator=generator)
            nn.init.zeros_(layer.bias)  # pyright: ignore[reportArgumentType]


@torch.no_grad()
def calibrate(
    features: nn.Sequential,
    compared: Sequence[int],
    generator: torch.Generator,
    standardise: Callable[[Tensor], Tensor],
) -> None:
    """Give each channel of the compared features unit variance, by scaling the weights of the convolution before.

    Args:
        features: convolutions without bias, ReLUs and pools.
        compared: indices of the ReLUs whose output is compared.
        generator: draws the pictures over which that holds.
        standardise: what pictures of sRGB codes go through first.
    """
    values = standardise(natural_pictures(generator, _PICTURES, _PIXELS))
    for index, layer in enumerate(features):
        values = layer(values)
        if index in compared:
            spread = values.std(dim=(0, 2, 3), correction=0)
            spread = spread.clamp_min(_LEAST_SPREAD * spread.median())[:, None, None]
            convolution = features[index - 1]
            convolution.weight /= spread[..., None]  # ReLU(x) / s = ReLU(x / s)
            values = values / spread


def natural_pictures(generator: torch.Generator, count: int, pixels: int) -> Tensor:
    """Return random pictures ``(count, 3, pixels, pixels)``, 0..1: noise of all scales with the same contrast in each.

    That every octave has the same variance is the 1 / f^2 power spectrum of natural pictures: Field, Relations between the
    statistics of natural images and the response properties of cortical cells, JOSA A 4, 1987. Half of it is grey.
    """
    total = torch.zeros(count, 3, pixels, pixels)
    size = 1
    while size <= pixels:
        grey = torch.randn(count, 1, size, size, generator=generator)
        colour = torch.randn(count, 3, size, size, generator=generator)
        total += interpolate(grey + colour, (pixels, pixels), mode="bilinear")
        size *= 2
    return torch.sigmoid(total / total.std())
