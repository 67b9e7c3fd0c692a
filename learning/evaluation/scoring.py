"""One method on all test scenes: scores of each scene, and squared depth errors by bin of true depth."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import default_collate

from learning.data import Example, ExampleSet
from learning.estimate import Estimate
from learning.method import Method
from learning.metrics import dark_mask, depth_scores, measure
from learning.perceptual import LpipsDistance
from simulator.errors import InputError

Progress = Callable[[int], None]


@dataclass(frozen=True)
class Criteria:
    """By what methods are judged.

    Attributes:
        edges_cm: of the bins of true depth, increasing.
        dark_share: pixels darker than this share of white's luminance do not count in ``lit_depth_rmse_cm``; None leaves that
            score out.
        lpips: None where it is not measured.
    """

    edges_cm: tuple[float, ...]
    dark_share: float | None = None
    lpips: LpipsDistance | None = None


def score(
    method: Method,
    examples: ExampleSet,
    criteria: Criteria,
    *,
    device: torch.device,
    batch: int,
    progress: Progress = lambda _: None,
) -> dict[str, Any]:
    """Run a method over all scenes; depth counts where something was seen.

    Args:
        method: ready on the device.
        examples: the scenes, at one level of noise.
        criteria: by what it is judged.
        device: where it runs.
        batch: scenes at a time.
        progress: called with the number of scenes after each batch.

    Returns:
        ``scores``: for each scene, see `learning.metrics.measure`; ``squares_cm2`` and ``counts``: for each scene and bin,
        the sum of squared depth errors and the number of pixels.

    Raises:
        InputError: an estimate with NaN or infinite numbers; method and sample are named.
    """
    scores: list[dict[str, float]] = []
    squares: list[list[float]] = []
    counts: list[list[int]] = []
    for first, example in batches(examples, batch, device):
        estimate = checked(method, method.reconstruct(example.measurement), examples, first)
        scenes = measure(estimate, example, method.capture, lpips=criteria.lpips, pixels=example.valid)
        if criteria.dark_share is not None:
            lit = example.valid & ~dark_mask(example, method.capture, criteria.dark_share)
            errors = depth_scores(estimate, example, method.capture, lit).depth_rmse_cm.tolist()
            scenes = [scene | {"lit_depth_rmse_cm": error} for scene, error in zip(scenes, errors, strict=True)]
        error_cm2 = (100 * (method.capture.depth_m(estimate.disparity.double()) - example.depth_m)).square()
        by_scene = [
            _binned(errors[valid], depth_cm[valid], criteria.edges_cm)
            for errors, depth_cm, valid in zip(error_cm2, example.depth_m * 100, example.valid, strict=True)
        ]
        scores += scenes
        squares += [sums for sums, _ in by_scene]
        counts += [pixels for _, pixels in by_scene]
        progress(len(scenes))
    return {"scores": scores, "squares_cm2": squares, "counts": counts}


def batches(examples: ExampleSet, batch: int, device: torch.device) -> Iterator[tuple[int, Example]]:
    """Yield the position of each batch's first scene, and the batch on the device, in order."""
    for first in range(0, len(examples), batch):
        together = [examples[position] for position in range(first, min(first + batch, len(examples)))]
        yield first, Example(*(values.to(device) for values in default_collate(together)))


def checked(method: Method, estimate: Estimate, examples: ExampleSet, first: int) -> Estimate:
    """Return an estimate within the ranges, as metrics see it.

    Raises:
        InputError: it holds NaN or infinite numbers; method and sample are named.
    """
    for what, values in zip(Estimate._fields, estimate, strict=True):
        good = values.isfinite().flatten(1).all(dim=1)
        if not bool(good.all()):
            scene = examples.dataset.ids[first + int((~good).nonzero()[0])]
            msg = f"{method.name}: its {what} of sample {scene} is NaN or infinite; check its checkpoint or parameters"
            raise InputError(msg)
    return estimate.clamped()


def _binned(error_cm2: Tensor, depth_cm: Tensor, edges_cm: Sequence[float]) -> tuple[list[float], list[int]]:
    """Return sums and counts by bin of one scene; a bin holds its lower edge, the last one its upper edge too."""
    bins = len(edges_cm) - 1
    # Depths are stored in float32: the range's own ends must not fall out by their rounding.
    edges = torch.tensor(edges_cm, dtype=torch.float64) * (1 + 1e-6 * torch.tensor([-1.0] * bins + [1.0]))
    place = torch.bucketize(depth_cm.double().cpu(), edges, right=True) - 1
    inside = (place >= 0) & (place < bins)
    sums = torch.bincount(place[inside], error_cm2.cpu()[inside], minlength=bins)
    return sums.tolist(), torch.bincount(place[inside], minlength=bins).tolist()
