"""Answers that look at no measurement: who does not beat them has learned nothing. Computed from the test set at hand."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from learning.capture import CaptureModel
from learning.data import ExampleSet
from learning.display import encode
from learning.estimate import Estimate
from learning.evaluation.scoring import batches
from learning.method import Clock

PICTURE_SCORES = ("psnr", "ssim", "lpips", "flip", "linear_psnr")
DEPTH_SCORES = ("depth_rmse_cm", "disparity_rmse", "disparity_rmse_per_m", "lit_depth_rmse_cm")


@dataclass(eq=False)
class Constant:
    """A method that gives the same answer to everything; see `learning.method.Method`.

    Attributes:
        name: in tables.
        capture: for the range of depths.
        picture: ``(3, h, w)`` sRGB codes.
        disparity: ``(1, h, w)``.
        scores: those that it is an answer to.
    """

    name: str
    capture: CaptureModel
    picture: Tensor
    disparity: Tensor
    scores: tuple[str, ...]

    def reconstruct(self, measurement: Tensor, clock: Clock | None = None) -> Estimate:
        """Return the answer, as often as there are measurements."""
        many = (len(measurement), 1, 1, 1)
        device = measurement.device
        return Estimate(self.picture.to(device).repeat(many), self.disparity.to(device).repeat(many))


def trivial_methods(examples: ExampleSet, capture: CaptureModel, batch: int) -> list[Constant]:
    """Return the best constant depth, the mean picture, and black, all of these scenes.

    No constant has a smaller root mean square error in cm, over all that was seen, than its mean depth.
    """
    depth_m, picture = torch.zeros((), dtype=torch.float64), torch.zeros(1, dtype=torch.float64)
    seen = 0
    for _, example in batches(examples, batch, torch.device("cpu")):
        depth_m = depth_m + example.depth_m[example.valid].double().sum()
        seen += int(example.valid.sum())
        picture = picture + encode(example.radiance, capture.white).double().sum(dim=0)
    mean_picture = (picture / len(examples)).float()
    black = torch.zeros_like(mean_picture)
    far = torch.zeros_like(mean_picture[:1])
    mean_m = (depth_m / max(seen, 1)).float()
    constant = torch.as_tensor(capture.disparity(mean_m.reshape(1, 1, 1)), dtype=torch.float32).expand_as(far)
    return [
        Constant(f"constant depth ({100 * mean_m.item():.2f} cm)", capture, black, constant, DEPTH_SCORES),
        Constant("mean picture", capture, mean_picture, far, PICTURE_SCORES),
        Constant("black", capture, black, far, PICTURE_SCORES),
    ]
