"""What tuning minimises: the error of picture and depth, each as a multiple of the constant guess's."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import torch

from learning.capture import CaptureModel
from learning.data import Example
from learning.display import encode
from learning.estimate import Estimate
from learning.metrics import depth_scores, psnr

Objective = Literal["both", "picture", "depth"]
FORMULAS = {
    "both": "picture + depth",
    "picture": "10^((PSNR of the constant colour - PSNR) / 20), mean PSNR over scenes: a ratio of picture RMSEs",
    "depth": "depth RMSE / depth RMSE of the constant depth, mean RMSE over scenes, centimetres, where something was seen",
}


@dataclass(frozen=True)
class Errors:
    """Means over scenes, of the estimate within its ranges.

    Attributes:
        psnr_db: of sRGB codes, peak 1, of all pixels.
        depth_rmse_cm: of valid pixels, as in evaluations; a scene without any does not count.
    """

    psnr_db: float
    depth_rmse_cm: float


class Score:
    """One number for a reconstruction of some scenes: 1 (or 2, for both) is what a constant guess would get, 0 is perfect.

    Picture and depth weigh the same when each is counted in units of what can be had without looking at the measurement;
    no unit of length and no range of depths decides between them.

    Attributes:
        objective: ``both``, ``picture`` or ``depth``.
        constant: the errors of the mean colour and of the mean depth of these scenes.
    """

    def __init__(self, objective: Objective, truth: Example, capture: CaptureModel) -> None:
        """Look at the truth.

        Args:
            objective: what counts.
            truth: all scenes, stacked; B at least 1.
            capture: the camera; its white and its range of depths.
        """
        self.objective, self._capture = objective, capture
        self._truth, self._pictures = truth, encode(truth.radiance, capture.white)
        self._seen = truth.valid.flatten(1).any(dim=1)
        constant_colour = self._pictures.mean(dim=(0, 2, 3), keepdim=True).expand_as(self._pictures)
        mean_m = truth.depth_m[truth.valid].double().mean().float()
        constant_depth = torch.as_tensor(capture.disparity(mean_m.expand_as(truth.depth_m)))
        self.constant = self.errors([Estimate(constant_colour, constant_depth)])

    def errors(self, estimates: list[Estimate]) -> Errors:
        """Return the errors of estimates that follow each other as the scenes do; NaN where one holds NaN."""
        together = Estimate(*(torch.cat([values.cpu() for values in each]) for each in zip(*estimates, strict=True)))
        estimate = together.clamped()
        depth = depth_scores(estimate, self._truth, self._capture, self._truth.valid).depth_rmse_cm
        return Errors(float(psnr(estimate.picture, self._pictures).mean()), float(depth[self._seen].mean()))

    def __call__(self, errors: Errors) -> float:
        """Return the number to minimise; infinite where something is NaN."""
        picture = 10 ** ((self.constant.psnr_db - errors.psnr_db) / 20)
        depth = errors.depth_rmse_cm / self.constant.depth_rmse_cm
        number = {"both": picture + depth, "picture": picture, "depth": depth}[self.objective]
        return math.inf if math.isnan(number) else number

    def beaten_by_constant(self, errors: Errors) -> tuple[str, ...]:
        """Return what of picture and depth, as far as the objective counts it, is no better than the constant guess."""
        worse = {
            "picture": not errors.psnr_db > self.constant.psnr_db,
            "depth": not errors.depth_rmse_cm < self.constant.depth_rmse_cm,
        }
        return tuple(name for name, is_worse in worse.items() if is_worse and self.objective in ("both", name))
