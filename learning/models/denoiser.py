"""A small denoiser for pictures in linear light that is told how noisy they are: the prior of plug-and-play methods.

Sources: Zhang et al., Plug-and-Play Image Restoration with Deep Denoiser Prior (DRUNet), TPAMI 2021 (noise level as an input,
no batch normalisation); Karras et al., Elucidating the Design Space of Diffusion-Based Generative Models, NeurIPS 2022,
equation 7 (what is scaled by the noise level before and after the network).
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from learning.layers.naf import NafNet

NOISE_RANGE = (0.002, 0.5)
"""Least and greatest standard deviation that it is trained for, 1 for white."""
TRAINED_PEAK = 4.0
"""Peak of pictures, 1 for white, up to which it is used as trained."""
_SPREAD = 0.25  # about the root mean square of clean pictures and planes


class Denoiser(nn.Module):
    """The MMSE estimate of an image with white Gaussian noise: the mean of the clean images that it may come from.

    Linear light, not sRGB codes: there the noise of a least-squares step has one standard deviation for all brightnesses, and
    values below zero are as good as others. The network sees the picture at a spread of 1 whatever the noise, and gives what
    the noise is to be replaced by: little noise leaves the picture as it is, exactly, and nothing depends on biases there.
    """

    def __init__(self, *, filters: int, blocks: int, levels: int) -> None:
        """Build the denoiser; see `NafNet` for its size."""
        super().__init__()
        self.body = NafNet(4, 3, filters=filters, blocks=blocks, levels=levels)

    def forward(self, picture: Tensor, noise: Tensor) -> Tensor:
        """Return pictures ``(B, 3, h, w)``, 1 for white, of noisy ones whose noise has standard deviations ``(B,)``."""
        noise = noise[:, None, None, None]
        both = (noise.square() + _SPREAD**2).sqrt()
        level = (noise.log() / 4).expand_as(picture[:, :1])
        found = self.body(torch.cat([picture / both, level], dim=1))
        return (_SPREAD / both) ** 2 * picture + noise * _SPREAD / both * found

    def planes(self, volume: Tensor, noise: Tensor) -> Tensor:
        """Return volumes ``(B, K, C, h, w)``, each plane by itself; other than three channels as grey pictures, one each.

        Images brighter than any that it was trained on are scaled down, and with them the noise, of standard deviations
        ``(B,)``; noise levels outside the training range are clamped to it.
        """
        pictures = volume.flatten(0, 1)
        if grey := volume.shape[2] != 3:
            pictures = pictures.flatten(0, 1)[:, None].expand(-1, 3, -1, -1)
        times = (pictures.amax(dim=(1, 2, 3)) / TRAINED_PEAK).clamp_min(1)
        level = (noise.repeat_interleave(len(times) // len(noise)) / times).clamp(*NOISE_RANGE)
        found = self(pictures / times[:, None, None, None], level) * times[:, None, None, None]
        return (found.mean(dim=1) if grey else found).reshape(volume.shape)


class DenoisingLoss(nn.Module):
    """Squared error in units of what a perfect guess of the network would have to give: all noise levels weigh alike."""

    def forward(self, found: Tensor, clean: Tensor, noise: Tensor) -> dict[str, Tensor]:
        """Return ``total`` for pictures ``(B, 3, h, w)`` and standard deviations ``(B,)``."""
        weight = 1 / noise.square() + 1 / _SPREAD**2
        return {"total": ((found - clean).square().mean(dim=(1, 2, 3)) * weight).mean()}

    def record(self) -> dict[str, Any]:
        """Return what a checkpoint says of this loss."""
        return {"total": f"squared error x (1 / noise^2 + 1 / {_SPREAD:g}^2)"}
