"""What networks for still scenes are trained to minimise: image, features of the image, disparity."""

from __future__ import annotations

import math
from typing import Any, Literal

import torch
import torch.nn.functional as nnf
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.method import Estimate, check_choices, linear_to_srgb, srgb_to_linear
from learning.perceptual import PerceptualLoss
from simulator.errors import InputError


class ReconstructionLoss(nn.Module):
    """Weighted sum of its terms; the thesis's is VGG-19 features plus ``alpha`` times the L1 norm of disparity.

    - ``intensity``: mean squared or mean absolute difference of sRGB codes;
    - ``multiscale``: mean absolute difference of the sRGB codes of linear light averaged over 2 x 2, 4 x 4 and 8 x 8 pixels,
      the mean of the three: what an eye at a distance sees, and FLIP with it (Andersson et al. 2020, section 4.1). The error
      of single pixels says little of it: averages of codes are not codes of averages;
    - ``perceptual``: see `learning.perceptual.PerceptualLoss`; absent with ``none``;
    - ``depth``: mean absolute difference of disparity on the scale 0 (far) to 1 (near);
    - ``depth_cm``: Huber's loss of the depth's error in centimetres, in which it is judged: squares up to 1 cm, from there on
      absolute values. Disparity alone weighs errors far away too little.

    Each is the mean over scenes of the scene's mean, so that processes with equal parts of a batch average to the whole. What
    a weight means depends on the term's unit and scale (so it is with the thesis's alpha of 0.001 to 0.002): log both.
    """

    def __init__(
        self,
        intensity: Literal["mse", "l1"] = "mse",
        perceptual: Literal["none", "vgg", "random_vgg"] = "none",
        *,
        intensity_weight: float = 1.0,
        multiscale_weight: float = 0.0,
        perceptual_weight: float = 0.1,
        depth_weight: float = 0.1,
        depth_cm_weight: float = 0.0,
        invalid_depth: bool = False,
        seed: int = 0,
        capture: CaptureModel,
    ) -> None:
        """Build the loss; the arguments are those of `learning.config.LossConfig`, ``seed`` is that of ``random_vgg``.

        ``capture`` says what depth a disparity is.

        Raises:
            InputError: an unknown name, weights that are negative or all zero, centimetres of depths up to infinity, or no
                weight file.
        """
        super().__init__()
        check_choices(
            ("intensity", intensity, ("mse", "l1")), ("perceptual", perceptual, ("none", "vgg", "random_vgg"))
        )
        self._capture = capture
        self.weights = {
            "intensity": intensity_weight,
            "multiscale": multiscale_weight,
            "depth": depth_weight,
            "depth_cm": depth_cm_weight,
        }
        if perceptual != "none":
            self.weights["perceptual"] = perceptual_weight
        for name, weight in self.weights.items():
            if not (math.isfinite(weight) and weight >= 0):
                raise InputError(f"{name}_weight", f"got {weight!r}, expected a number of at least 0")
        if not any(self.weights.values()):
            raise InputError(", ".join(f"{name}_weight" for name in self.weights), "all are 0: nothing to learn")
        if depth_cm_weight and not math.isfinite(capture.far_m):
            got = f"got {depth_cm_weight:g} with PSFs up to a depth of {capture.far_m:g}"
            reason = "an error there has no length in centimetres; take 0 and depth_weight, or a finite psf.far_cm"
            raise InputError("depth_cm_weight", f"{got}: {reason}")
        self.intensity, self.invalid_depth = intensity, invalid_depth
        self.perceptual = None if perceptual == "none" else PerceptualLoss(perceptual, "vgg19", seed=seed)

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
            terms["multiscale"] = _multiscale(estimate.image, image)
        if self.perceptual is not None:
            terms["perceptual"] = self.perceptual(estimate.image, image)
        counted = torch.ones_like(valid) if self.invalid_depth else valid
        terms["depth"] = _mean_over((estimate.disparity - disparity).abs(), counted)
        if self.weights["depth_cm"]:
            found, true = (100 * self._capture.depth_m(each) for each in (estimate.disparity, disparity))
            terms["depth_cm"] = _mean_over(nnf.huber_loss(found, true, reduction="none"), counted)
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


def _multiscale(found: Tensor, true: Tensor) -> Tensor:
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
