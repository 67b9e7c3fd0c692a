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
DEPTH_SCORES = ("depth_rmse_cm", "lit_depth_rmse_cm")
DISPARITY_SCORES = ("disparity_rmse", "disparity_rmse_per_m")


@dataclass(eq=False)
class Constant:
    """A method that gives the same answer to everything; see `learning.method.Method`.

    Attributes:
        name: in tables.
        capture: for the range of depths.
        picture: ``(3, h, w)`` sRGB codes.
        disparity: ``(1, h, w)``.
        scores: those that it is an answer to.
        best_in: in what no other answer of its kind is better.
    """

    name: str
    capture: CaptureModel
    picture: Tensor
    disparity: Tensor
    scores: tuple[str, ...]
    best_in: str

    def reconstruct(self, measurement: Tensor, clock: Clock | None = None) -> Estimate:
        """Return the answer, as often as there are measurements."""
        many = (len(measurement), 1, 1, 1)
        device = measurement.device
        return Estimate(self.picture.to(device).repeat(many), self.disparity.to(device).repeat(many))


def trivial_methods(examples: ExampleSet, capture: CaptureModel, batch: int) -> list[Constant]:
    """Return the best constant depth, the best constant disparity, the mean picture, and black, all of these scenes.

    Over all that was seen, no constant has a smaller root mean square error in cm than the mean depth, and none in disparity
    than the mean disparity, which is another depth.
    """
    depth_m, disparity = (torch.zeros((), dtype=torch.float64) for _ in range(2))
    picture = torch.zeros(1, dtype=torch.float64)
    seen = 0
    for _, example in batches(examples, batch, torch.device("cpu")):
        seen_m = example.depth_m[example.valid].double()
        depth_m, seen = depth_m + seen_m.sum(), seen + len(seen_m)
        disparity = disparity + capture.disparity(seen_m).sum()
        picture = picture + encode(example.radiance, capture.white).double().sum(dim=0)
    mean_picture = (picture / len(examples)).float()
    black, far = torch.zeros_like(mean_picture), torch.zeros_like(mean_picture[:1])
    mean_m, mean_disparity = depth_m / max(seen, 1), disparity / max(seen, 1)
    of_depth = torch.as_tensor(capture.disparity(mean_m), dtype=torch.float32).expand_as(far)
    of_disparity = mean_disparity.float().expand_as(far)
    nearer_cm = 100 * float(capture.depth_m(mean_disparity))
    return [
        Constant(
            f"constant depth ({100 * mean_m.item():.2f} cm)",
            capture,
            black,
            of_depth,
            DEPTH_SCORES,
            "no constant has a smaller depth RMSE in cm, pooled over all pixels of these scenes",
        ),
        Constant(
            f"constant disparity ({nearer_cm:.2f} cm)",
            capture,
            black,
            of_disparity,
            DISPARITY_SCORES,
            "no constant has a smaller RMSE of disparity and of 1/z, pooled over all pixels of these scenes",
        ),
        Constant(
            "mean picture",
            capture,
            mean_picture,
            far,
            PICTURE_SCORES,
            "no one picture has a smaller mean square error of sRGB codes over these scenes",
        ),
        Constant(
            "black", capture, black, far, PICTURE_SCORES, "best in nothing: what a method that sees nothing gives"
        ),
    ]
