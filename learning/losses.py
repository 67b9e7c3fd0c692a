"""What networks for still scenes are trained to minimise: image, features of the image, disparity."""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as nnf
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.config import LossConfig
from learning.method import Estimate, linear_to_srgb, srgb_to_linear
from learning.perceptual import PerceptualLoss
from simulator.errors import InputError


class ReconstructionLoss(nn.Module):
    """Weighted sum of its terms; the thesis's is VGG-19 features plus ``alpha`` times the L1 norm of disparity.

    - ``intensity``: mean squared or mean absolute difference of sRGB codes;
    - ``multiscale``: mean absolute difference of the sRGB codes of linear light averaged over 2 x 2, 4 x 4 and 8 x 8 pixels,
      the mean of the three: what an eye sees at a distance, as FLIP models it (Andersson et al. 2020, section 4.1). The error
      of single pixels says little about it: averages of codes are not codes of averages;
    - ``perceptual``: see `learning.perceptual.PerceptualLoss`; absent with ``none``;
    - ``depth``: mean absolute difference of disparity on the scale 0 (far) to 1 (near);
    - ``depth_cm``: Huber loss of the depth error in centimetres, the unit of the evaluation: quadratic up to 1 cm, linear
      beyond. Disparity alone gives errors at far depths too little weight.

    Each is the mean over scenes of the scene's mean, so that processes with equal parts of a batch average to the whole. What
    a weight means depends on the term's unit and scale (so it is with the thesis's alpha of 0.001 to 0.002): log both.
    """

    def __init__(self, settings: LossConfig, capture: CaptureModel) -> None:
        """Build the loss; ``capture`` says what depth a disparity is. An InputError says that there is no weight file."""
        super().__init__()
        self._capture = capture
        self.weights = {
            "intensity": settings.intensity_weight,
            "multiscale": settings.multiscale_weight,
            "depth": settings.depth_weight,
            "depth_cm": settings.depth_cm_weight,
        }
        self.perceptual: PerceptualLoss | None = None
        if settings.perceptual != "none":
            self.weights["perceptual"] = settings.perceptual_weight
            self.perceptual = PerceptualLoss(settings.perceptual, "vgg19", seed=settings.perceptual_seed)
        self.intensity, self.invalid_depth = settings.intensity, settings.invalid_depth

    def forward(self, estimate: Estimate, image: Tensor, disparity: Tensor, valid: Tensor) -> dict[str, Tensor]:
        """Return scalars: ``total``, each term under its name, and each weighted as ``intensity_weighted`` and so on.

        ``estimate`` is as the network gave it, not clamped; ``image`` ``(B, 3, h, w)`` holds the true sRGB codes,
        ``disparity`` ``(B, 1, h, w)`` the true disparity 0..1, ``valid`` says where there is a depth. Shapes must agree.
        """
        of_estimate = (("image", estimate.image, image), ("disparity", estimate.disparity, disparity))
        for name, found, wanted in (*of_estimate, ("valid", disparity, valid)):
            if found.shape != wanted.shape:
                raise InputError(name, f"got shape {tuple(wanted.shape)}, expected {tuple(found.shape)} as estimated")
        difference = estimate.image - image
        terms = {"intensity": (difference.square() if self.intensity == "mse" else difference.abs()).mean()}
        if self.weights["multiscale"]:
            terms["multiscale"] = multiscale(estimate.image, image)
        if self.perceptual is not None:
            terms["perceptual"] = self.perceptual(estimate.image, image)
        counted = torch.ones_like(valid) if self.invalid_depth else valid
        of_depth = depth_errors(estimate.disparity, disparity, counted, self._capture)
        terms |= {name: value for name, value in of_depth.items() if name == "depth" or self.weights[name]}
        weighted = {f"{name}_weighted": self.weights[name] * value for name, value in terms.items()}
        return {"total": torch.stack(list(weighted.values())).sum(), **terms, **weighted}

    def record(self) -> dict[str, Any]:
        """Return what a checkpoint and a table of results must say of this loss."""
        perceptual = {"perceptual": "none"} if self.perceptual is None else self.perceptual.record()
        depth = "all pixels" if self.invalid_depth else "valid pixels"
        terms = {"depth": f"l1 of disparity 0..1, {depth}", "depth_cm": f"Huber of cm beyond 1 cm, {depth}"}
        return {"intensity": self.intensity, **terms, **perceptual} | {
            f"{name}_weight": weight for name, weight in self.weights.items()
        }


def depth_errors(found: Tensor, true: Tensor, counted: Tensor, capture: CaptureModel) -> dict[str, Tensor]:
    """Return ``depth`` and ``depth_cm``, see `ReconstructionLoss`, of disparities ``(B, 1, h, w)`` at pixels that count."""
    found_cm, true_cm = (100 * capture.depth_m(each) for each in (found, true))
    return {
        "depth": _mean_over((found - true).abs(), counted),
        "depth_cm": _mean_over(nnf.huber_loss(found_cm, true_cm, reduction="none"), counted),
    }


def multiscale(found: Tensor, true: Tensor) -> Tensor:
    """Return the mean absolute difference of the codes of averaged light, over three sizes of square."""
    lights, differences = [srgb_to_linear(codes, 1.0, clip=False) for codes in (found, true)], []
    for _ in range(3):
        lights = [nnf.avg_pool2d(light, 2, ceil_mode=True) for light in lights]
        one, other = (linear_to_srgb(light, 1.0, clip=False) for light in lights)
        differences.append((one - other).abs().mean())
    return torch.stack(differences).mean()


def _mean_over(values: Tensor, counted: Tensor) -> Tensor:
    """Return the mean over scenes of each one's mean over the pixels that count; 0 of a scene where none does."""
    count = counted.sum(dim=(1, 2, 3))
    return (torch.where(counted, values, 0).sum(dim=(1, 2, 3)) / count.clamp_min(1)).mean()
