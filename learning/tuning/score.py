"""What tuning minimises: the error of picture and depth, each as a multiple of the constant guess's."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from learning.capture import CaptureModel
from learning.data import Example
from learning.display import encode
from learning.estimate import Estimate

Objective = Literal["both", "picture", "depth"]
FORMULAS = {
    "both": "picture + depth",
    "picture": "10^((PSNR of the constant colour - PSNR) / 20), mean PSNR over scenes: a ratio of picture RMSEs",
    "depth": "depth RMSE / depth RMSE of the constant depth, mean RMSE over scenes, centimetres",
}


@dataclass(frozen=True)
class Errors:
    """Means over scenes, of the estimate within its ranges.

    Attributes:
        psnr_db: of sRGB codes, peak 1.
        depth_rmse_cm: of all pixels.
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
        self._pictures = encode(truth.radiance, capture.white)
        self._depth_cm = truth.depth_m * 100
        constant_colour = self._pictures.mean(dim=(0, 2, 3), keepdim=True).expand_as(self._pictures)
        mean_m = self._depth_cm.mean() / 100
        constant_depth = capture.disparity(mean_m.expand_as(self._depth_cm))
        self.constant = self.errors([Estimate(constant_colour, constant_depth)])

    def errors(self, estimates: list[Estimate]) -> Errors:
        """Return the errors of estimates that follow each other as the scenes do; NaN where one holds NaN."""
        pictures = torch.cat([estimate.clamped().picture.cpu() for estimate in estimates])
        depths_cm = torch.cat([estimate.depth_m(self._capture).cpu() for estimate in estimates]) * 100
        mse = _per_scene(pictures, self._pictures)
        rmse_cm = _per_scene(depths_cm, self._depth_cm).sqrt()
        return Errors(float((-10 * torch.log10(mse)).mean()), float(rmse_cm.mean()))

    def __call__(self, errors: Errors) -> float:
        """Return the number to minimise; infinite where something is NaN."""
        picture = 10 ** ((self.constant.psnr_db - errors.psnr_db) / 20)
        depth = errors.depth_rmse_cm / self.constant.depth_rmse_cm
        number = {"both": picture + depth, "picture": picture, "depth": depth}[self.objective]
        return math.inf if math.isnan(number) else number


def _per_scene(values: Tensor, truth: Tensor) -> Tensor:
    """Return the mean square difference of each scene, ``(B,)``."""
    return (values.double() - truth.double()).square().mean(dim=(1, 2, 3))
