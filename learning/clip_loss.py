"""What networks for clips are trained to minimise: global measurements, frames, their differences, features, depth."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.config import ClipLossConfig, FrameLossConfig, Video3DLossConfig
from learning.losses import depth_errors, multiscale
from learning.method import Estimate
from learning.models.videonet import Film
from learning.perceptual import PerceptualLoss


class ClipLoss(nn.Module):
    """Weighted sum of its terms; thesis equations 4.2 to 4.6.

    - ``measurement``: mean squared error of MeasNet's global measurements, DN / 2^bits; absent without MeasNet;
    - ``intensity``: mean squared or mean absolute difference of the frames' sRGB codes;
    - ``change``: mean absolute error of the differences between neighbouring frames; absent of a single one;
    - ``multiscale``: see `learning.losses.ReconstructionLoss`;
    - ``perceptual``: of VGG-16, see `learning.perceptual.PerceptualLoss`; absent with ``none``.
    """

    def __init__(self, settings: FrameLossConfig) -> None:
        """Build the loss; an InputError says that there is no weight file."""
        super().__init__()
        names = ("intensity", "change", "multiscale")
        self.weights = {name: getattr(settings, f"{name}_weight") for name in names}
        if isinstance(settings, ClipLossConfig):
            self.weights["measurement"] = settings.measurement_weight
        self.perceptual: PerceptualLoss | None = None
        if settings.perceptual != "none":
            self.weights["perceptual"] = settings.perceptual_weight
            self.perceptual = PerceptualLoss(settings.perceptual, "vgg16", seed=settings.perceptual_seed)
        self.intensity = settings.intensity

    def forward(self, film: Film, image: Tensor, measured: Tensor) -> dict[str, Tensor]:
        """Return scalars: ``total``, each term under its name, and each weighted as ``intensity_weighted`` and so on.

        ``film`` is as the network gave it; ``image`` ``(B, N, 3, h, w)`` holds the true sRGB codes, ``measured``
        ``(B, N, C, H, W)`` the true global measurements less the offset, empty where the network has no MeasNet.
        """
        found, difference = film.image, film.image - image
        terms = {"intensity": (difference.square() if self.intensity == "mse" else difference.abs()).mean()}
        if film.measured.numel():
            terms["measurement"] = (film.measured - measured).square().mean()
        if self.weights["change"] and difference.shape[1] > 1:
            terms["change"] = difference.diff(dim=1).abs().mean()
        pair = (found.flatten(0, 1), image.flatten(0, 1))
        if self.weights["multiscale"]:
            terms["multiscale"] = multiscale(*pair)
        if self.perceptual is not None:
            terms["perceptual"] = self.perceptual(*pair)
        weighted = {f"{name}_weighted": self.weights[name] * value for name, value in terms.items()}
        return {"total": torch.stack(list(weighted.values())).sum(), **terms, **weighted}

    def record(self) -> dict[str, Any]:
        """Return what a checkpoint and a table of results must say of this loss."""
        perceptual = {"perceptual": "none"} if self.perceptual is None else self.perceptual.record()
        return {"intensity": self.intensity, **perceptual} | {
            f"{name}_weight": weight for name, weight in self.weights.items()
        }


class ClipDepthLoss(nn.Module):
    """The terms of `ClipLoss`, and ``depth`` and ``depth_cm`` of `learning.losses.ReconstructionLoss` over all frames."""

    def __init__(self, settings: Video3DLossConfig, capture: CaptureModel) -> None:
        """Build the loss; ``capture`` says what depth a disparity is. An InputError says that there is no weight file."""
        super().__init__()
        self._of_images, self._capture = ClipLoss(settings), capture
        self.weights = {"depth": settings.depth_weight, "depth_cm": settings.depth_cm_weight}

    def forward(self, film: Estimate, image: Tensor, disparity: Tensor, valid: Tensor) -> dict[str, Tensor]:
        """Return scalars as `ClipLoss` does; the true ``disparity`` ``(B, N, 1, h, w)`` counts where it is ``valid``."""
        nothing = image.new_zeros(0)
        terms = self._of_images(Film(film.image, nothing), image, nothing)
        found, true, counted = (each.flatten(0, 1) for each in (film.disparity, disparity, valid))
        of_depth = depth_errors(found, true, counted, self._capture)
        weighted = {f"{name}_weighted": weight * of_depth[name] for name, weight in self.weights.items()}
        return terms | of_depth | weighted | {"total": terms["total"] + torch.stack(list(weighted.values())).sum()}

    def record(self) -> dict[str, Any]:
        """Return what a checkpoint and a table of results must say of this loss."""
        return self._of_images.record() | {f"{name}_weight": weight for name, weight in self.weights.items()}
