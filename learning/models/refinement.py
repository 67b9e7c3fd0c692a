"""A refinement step: the residual of the measurement given an estimate, inverted and enhanced.

An unrolled data-consistency step, as in Adler and Oektem, Learned Primal-Dual Reconstruction, TMI 2018, and Aggarwal et
al., MoDL, TMI 2019, for a non-negative scene with one surface per pixel that ends at the field's border. A division in the
Fourier domain can use none of this, nor the extent of the sensor.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.layers.inversion import RegularisedInversion
from learning.layers.naf import NafNet
from learning.method import linear_to_srgb, srgb_to_linear

MOST_RADIANCE = 4.0
"""Upper limit of a surface's radiance, 1 for white: an inversion also amplifies noise."""


class Surface(NamedTuple):
    """A scene of one surface per pixel.

    Attributes:
        image: ``(B, 3, h, w)`` sRGB codes.
        disparity: ``(B, 1, h, w)``, nominally 0 (far) to 1 (near).
        logits: ``(B, K, h, w)``, of which softmax makes the weights of the planes.
    """

    image: Tensor
    disparity: Tensor
    logits: Tensor


class PlaneChoice(nn.Module):
    """A choice among a camera's planes, pixel by pixel, with softmax weights: from a volume to a surface and back.

    Light is in linear sRGB, 1 for white; the volume is in the camera's channels.
    """

    to_srgb: Tensor
    to_camera: Tensor
    disparities: Tensor

    def __init__(self, capture: CaptureModel, planes: Sequence[int]) -> None:
        """Keep the camera's colours and the disparities of ``planes``."""
        super().__init__()
        colours = np.asarray(capture.scene_to_camera)
        of_planes = capture.plane_disparities()[list(planes)]
        numbers = {"to_srgb": np.linalg.pinv(colours), "to_camera": colours, "disparities": of_planes}
        for name, values in numbers.items():
            self.register_buffer(name, torch.from_numpy(values).to(torch.get_default_dtype()), persistent=False)

    def light(self, volume: Tensor, weights: Tensor) -> Tensor:
        """Return the light ``(B, 3, h, w)`` of volumes ``(B, K, C, h, w)``, as much of each plane as it weighs."""
        return torch.einsum("ac,bkchw,bkhw->bahw", self.to_srgb, volume, weights)

    def disparity(self, weights: Tensor) -> Tensor:
        """Return the mean disparity ``(B, 1, h, w)`` of weights ``(B, K, h, w)``."""
        return torch.einsum("k,bkhw->bhw", self.disparities, weights)[:, None]

    def volume(self, light: Tensor, weights: Tensor) -> Tensor:
        """Return the volume ``(B, K, C, h, w)`` of light ``(B, 3, h, w)`` that lies on the planes as they weigh."""
        return weights[:, :, None] * torch.einsum("ca,bahw->bchw", self.to_camera, light).relu()[:, None]


class Refinement(nn.Module):
    """One refinement step, with lambda, P and NAF blocks of its own."""

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
        nn.init.zeros_(self.enhancement.head.weight)  # at first, nothing is added to what the residual says

    def forward(self, before: Surface, light: Tensor, noise: Tensor | None, level: Tensor | None) -> Surface:
        """Return a surface that explains more.

        Args:
            before: the estimate so far.
            light: ``(B, C, H, W)``, the measurement without its offset.
            noise: ratio of noise to signal ``(B, C)``, for lambda.
            level: the noise's level as an image ``(B, 1, h, w)``.
        """
        with torch.autocast(light.device.type, enabled=False):
            image, disparity, logits = (each.to(light) for each in before)
            weights = logits.softmax(dim=1)
            linear = srgb_to_linear(image, 1.0, clip=False).clamp(0, MOST_RADIANCE)
            residual = light - self.inversion.reproject(self.choice.volume(linear, weights))
            volume = self.inversion.volume(self.inversion.spectrum(residual), noise)
        per_plane = torch.cat([volume, weights[:, :, None]], dim=2).flatten(1, 2)
        known = [per_plane, image, disparity] + ([] if level is None else [level])
        added = self.enhancement(torch.cat(known, dim=1))
        with torch.autocast(light.device.type, enabled=False):
            added = added.to(light)
            logits = logits + added[:, 4:]
            chosen = logits.softmax(dim=1)
            brighter = (linear + self.choice.light(volume, chosen)).clamp(0, MOST_RADIANCE)
            change = linear_to_srgb(brighter, 1.0, clip=False) - linear_to_srgb(linear, 1.0, clip=False)
            disparity = disparity + self.choice.disparity(chosen - weights) + added[:, 3:4]
            return Surface(image + change + added[:, :3], disparity, logits)
