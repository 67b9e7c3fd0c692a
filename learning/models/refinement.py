"""A further look at a measurement: what an estimate leaves unexplained of it, inverted and enhanced again.

An unrolled step of data consistency, as in Adler and Oektem, Learned Primal-Dual Reconstruction, TMI 2018, and Aggarwal et
al., MoDL, TMI 2019, for a scene of one surface per pixel, which is not negative and ends where the field ends. A division in
the Fourier domain knows none of this, nor where the sensor ends.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.layers.choice import PlaneChoice
from learning.layers.inversion import RegularisedInversion
from learning.layers.naf import NafNet
from learning.method import linear_to_srgb, srgb_to_linear

BRIGHTEST = 4.0
"""What a surface radiates at most, in white: noise in an inversion is no light."""


class Surface(NamedTuple):
    """A scene of one surface per pixel.

    Attributes:
        image: ``(B, 3, h, w)`` sRGB codes.
        disparity: ``(B, 1, h, w)``.
        odds: ``(B, K, h, w)``, logarithms of the odds that the surface lies in each plane.
    """

    image: Tensor
    disparity: Tensor
    odds: Tensor


class Refinement(nn.Module):
    """One further look, with lambda, P and NAF blocks of its own."""

    def __init__(
        self, capture: CaptureModel, planes: Sequence[int], inversion: dict[str, Any], noise_aware: bool, **sizes: Any
    ) -> None:
        """Build it; ``inversion`` are options of `RegularisedInversion`, ``sizes`` of `NafNet`."""
        super().__init__()
        self.inversion = RegularisedInversion(capture, planes, **inversion)
        self.choice = PlaneChoice(capture, planes)
        # Per plane the channels and the plane's weight; then what belongs to no plane
        inputs = len(planes) * (len(capture.stack.channels) + 1) + 4 + noise_aware
        self.enhancement = NafNet(inputs, 4 + len(planes), **sizes)
        nn.init.zeros_(self.enhancement.head.weight)  # at first, nothing is added to what is left

    def forward(self, before: Surface, light: Tensor, noise: Tensor | None, level: Tensor | None) -> Surface:
        """Return a surface that explains more.

        Args:
            before: the estimate so far.
            light: ``(B, C, H, W)``, the measurement without its offset.
            noise: ratio of noise to signal ``(B, C)``, for lambda.
            level: the noise's level as an image ``(B, 1, h, w)``.
        """
        with torch.autocast(light.device.type, enabled=False):
            image, disparity, odds = (each.to(light) for each in before)
            weights = odds.softmax(dim=1)
            linear = srgb_to_linear(image, 1.0, clip=False).clamp(0, BRIGHTEST)
            left = light - self.inversion.seen(self.choice.volume(linear, weights))
            volume = self.inversion.volume(left, noise)
        per_plane = torch.cat([volume, weights[:, :, None]], dim=2).flatten(1, 2)
        known = [per_plane, image, disparity] + ([] if level is None else [level])
        added = self.enhancement(torch.cat(known, dim=1))
        with torch.autocast(light.device.type, enabled=False):
            added = added.to(light)
            odds = odds + added[:, 4:]
            chosen = odds.softmax(dim=1)
            brighter = (linear + self.choice.light(volume, chosen)).clamp(0, BRIGHTEST)
            change = linear_to_srgb(brighter, 1.0, clip=False) - linear_to_srgb(linear, 1.0, clip=False)
            disparity = disparity + self.choice.disparity(chosen - weights) + added[:, 3:4]
            return Surface(image + change + added[:, :3], disparity, odds)
