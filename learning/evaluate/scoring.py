"""One method on all test scenes: scores, squared depth errors by bin of true depth, seconds per stage; what to beat."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import default_collate

from learning.camera import CaptureModel
from learning.data import Example, ExampleSet
from learning.evaluate.motion import sliver_motion, warping_error
from learning.evaluate.outcome import Kind
from learning.method import Clock, Estimate, Method, linear_to_srgb
from learning.metrics import dark_mask, depth_scores, measure, measure_over_time
from learning.perceptual import LpipsDistance
from learning.video_quality import VideoQuality
from simulator.errors import InputError

ScenesDone = Callable[[int], None]


@dataclass(frozen=True)
class Criteria:
    """By what methods are judged: the edges of the bins of true depth, what counts as too dark, LPIPS, ColorVideoVDP.

    Pixels darker than ``dark_share`` of white's luminance do not count in ``lit_depth_rmse_cm``; None leaves that score out.
    """

    edges_cm: tuple[float, ...]
    dark_share: float | None = None
    lpips: LpipsDistance | None = None
    cvvdp: VideoQuality | None = None

    def record(self) -> dict[str, Any]:
        """Return what tells results by one set of criteria from those by another."""
        packages = {"lpips": self.lpips and self.lpips.record(), "cvvdp": self.cvvdp and self.cvvdp.record()}
        return {"edges_cm": self.edges_cm, "dark_share": self.dark_share, **packages}


@dataclass(eq=False)
class Baseline(ABC):
    """An answer to all scenes that looks at no measurement.

    Attributes:
        name: in tables.
        capture: the camera whose white and depths count.
        kind: naive, or an oracle, which knows the truth.
        scores: those that it is an answer to.
        best_in: in what no other answer of its kind is better.
    """

    name: str
    capture: CaptureModel
    kind: Kind
    scores: tuple[str, ...]
    best_in: str

    @abstractmethod
    def answer(self, example: Example) -> Estimate:
        """Return the answer to a batch of scenes, on its device."""


def score(
    method: Method | Baseline,
    examples: ExampleSet,
    criteria: Criteria,
    *,
    device: torch.device,
    batch: int,
    begun: Mapping[str, list[Any]] | None = None,
    progress: ScenesDone = lambda _: None,
    keep: Callable[[dict[str, list[Any]]], object] = lambda _: None,
) -> dict[str, list[Any]]:
    """Judge a method or a baseline on all scenes; depth counts where something was seen.

    ``keep`` gets after each batch what was found so far, from which another call goes on as ``begun``; ``progress`` gets the
    number of scenes that were done.

    Returns ``scores`` of each scene, see `learning.metrics.measure` (and of clips whose data set records it,
    `learning.evaluate.motion`), and of clips ``over_time``, see `learning.metrics.measure_over_time`; of cameras that tell
    depths apart also ``pixels``, at how many of it depth counts, and for each scene and bin ``squares_cm2``, the sum of
    squared depth errors, and ``counts``, the number of pixels.
    """
    names = ("scores", "over_time", "pixels", "squares_cm2", "counts")
    found: dict[str, list[Any]] = {name: [] for name in names} | dict(begun or {})
    if found["scores"]:
        progress(len(found["scores"]))
    for first, example in batches(examples, batch, device, len(found["scores"])):
        if isinstance(method, Baseline):
            estimate = method.answer(example)
        else:
            estimate = checked(method, method.reconstruct(example.measurement), examples, first)
        how: Any = {"lpips": criteria.lpips, "cvvdp": criteria.cvvdp, "pixels": example.valid}
        scenes = measure(estimate, example, method.capture, **how)
        if examples.timing is not None:
            found["over_time"] += measure_over_time(estimate, example, method.capture, example.valid)
            for at, scene in enumerate(scenes):
                motion = sliver_motion(examples.dataset.stored(first + at), examples.timing.frames)
                if motion is not None:
                    truth = linear_to_srgb(example.radiance[at], method.capture.white)
                    scene["warping_error"] = warping_error(estimate.image[at], motion)
                    scene["true_warping_error"] = warping_error(truth, motion)
        if len(method.capture.stack.depths_m) > 1:
            if criteria.dark_share is not None:
                lit = example.valid & ~dark_mask(example, method.capture, criteria.dark_share)
                errors = depth_scores(estimate, example, method.capture, lit).depth_rmse_cm.tolist()
                scenes = [scene | {"lit_depth_rmse_cm": error} for scene, error in zip(scenes, errors, strict=True)]
            error_cm2 = (100 * (method.capture.depth_m(estimate.disparity.double()) - example.depth_m)).square()
            by_scene = [
                _binned(errors[valid], depth_cm[valid], criteria.edges_cm)
                for errors, depth_cm, valid in zip(error_cm2, example.depth_m * 100, example.valid, strict=True)
            ]
            found["pixels"] += example.valid.flatten(1).sum(dim=1).tolist()
            for name, values in zip(("squares_cm2", "counts"), zip(*by_scene, strict=True), strict=True):
                found[name] += values
        found["scores"] += scenes
        progress(len(scenes))
        keep(found)
    return found


def batches(examples: ExampleSet, batch: int, device: torch.device, begin: int = 0) -> Iterator[tuple[int, Example]]:
    """Yield the position of each batch's first scene, and the batch on the device, in order, from position ``begin`` on."""
    for first in range(begin, len(examples), batch):
        together = [examples[position] for position in range(first, min(first + batch, len(examples)))]
        yield first, Example(*(values.to(device) for values in default_collate(together)))


def checked(method: Method, estimate: Estimate, examples: ExampleSet, first: int) -> Estimate:
    """Return an estimate within the ranges, as metrics see it."""
    for what, values in zip(Estimate._fields, estimate, strict=True):
        good = values.isfinite().flatten(1).all(dim=1)
        if not bool(good.all()):
            scene = examples.dataset.ids[first + int((~good).nonzero()[0])]
            what_of = f"its {what} of sample {scene} is NaN or infinite"
            raise InputError(method.name, f"{what_of}; check its checkpoint or parameters")
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


IMAGE_SCORES = (
    "psnr",
    "moving_psnr",
    "ssim",
    "lpips",
    "flip",
    "cvvdp",
    "linear_psnr",
    "warping_error",
    "true_warping_error",
)
DEPTH_SCORES = ("depth_rmse_cm", "lit_depth_rmse_cm")
DISPARITY_SCORES = ("disparity_rmse", "disparity_rmse_per_m")


@dataclass(eq=False)
class Constant(Baseline):
    """Always the same: ``image`` has sRGB codes ``(3, h, w)``, ``disparity`` ``(1, h, w)``; of clips with a leading N."""

    image: Tensor
    disparity: Tensor

    def answer(self, example: Example) -> Estimate:
        """Return it as often as there are scenes."""
        many, device = len(example.measurement), example.measurement.device
        every = (each.to(device)[None].repeat(many, *[1] * each.ndim) for each in (self.image, self.disparity))
        return Estimate(*every)


@dataclass(eq=False)
class StillFilm(Baseline):
    """Each clip's true frames, averaged over the capture: a film that stands still.

    Attributes:
        of_light: average the light, as a perfect long exposure does, rather than sRGB codes.
    """

    of_light: bool

    def answer(self, example: Example) -> Estimate:
        """Return the mean of the true frames for every frame."""
        white, light = self.capture.white, example.radiance
        if self.of_light:
            mean = linear_to_srgb(light.mean(dim=1, keepdim=True), white)
        else:
            mean = linear_to_srgb(light, white).mean(dim=1, keepdim=True)
        image = mean.expand_as(light)
        return Estimate(image, torch.zeros_like(image[:, :, :1]))


def baselines(examples: ExampleSet, capture: CaptureModel, batch: int) -> list[Baseline]:
    """Return the best constant depth, the best constant disparity, the mean image, and black, all of these scenes.

    Over all that was seen, no constant has a smaller root mean square error in cm than the mean depth, and none in disparity
    than the mean disparity, which is another depth. Where the camera knows one depth, there is none to guess; of clips the
    mean and black are films, and there are two oracles: a perfect long exposure, and the still film of the best PSNR. A
    method with a better PSNR of moving pixels than the latter tells when things were where.
    """
    depth_m, disparity, image = (torch.zeros(1, dtype=torch.float64) for _ in range(3))
    seen = 0
    for _, example in batches(examples, batch, torch.device("cpu")):
        seen_m = example.depth_m[example.valid].double()
        depth_m, seen = depth_m + seen_m.sum(), seen + len(seen_m)
        disparity = disparity + capture.disparity(seen_m).sum()
        image = image + linear_to_srgb(example.radiance, capture.white).double().sum(dim=0)
    mean_image = (image / len(examples)).float()
    black, far = torch.zeros_like(mean_image), torch.zeros_like(mean_image[..., :1, :, :])
    mean_m, mean_disparity = depth_m / max(seen, 1), disparity / max(seen, 1)
    of_depth = torch.as_tensor(capture.disparity(mean_m), dtype=torch.float32).expand_as(far)
    of_disparity = mean_disparity.float().expand_as(far)
    nearer_cm = 100 * float(capture.depth_m(mean_disparity))
    pooled = "pooled over all pixels of these scenes"
    of_cm = f"no constant has a smaller depth RMSE in cm, {pooled}"
    of_inverse = f"no constant has a smaller RMSE of disparity and of 1/z, {pooled}"
    of_codes = "no one image has a smaller mean square error of sRGB codes over these scenes"
    nothing = "best in nothing: the answer of a method that detects no light"
    what = "image" if examples.timing is None else "film"

    def constant(name: str, scores: tuple[str, ...], best_in: str, image: Tensor, disparity: Tensor) -> Constant:
        return Constant(name, capture, "naive", scores, best_in, image, disparity)

    def still(name: str, best: str, *, of_light: bool) -> StillFilm:
        best_in = f"no film that stands still has {best}"
        return StillFilm(name, capture, "oracle", IMAGE_SCORES, best_in, of_light=of_light)

    found: list[Baseline] = [
        constant(f"mean {what}", IMAGE_SCORES, of_codes.replace("image", what), mean_image, far),
        constant("black", IMAGE_SCORES, nothing, black, far),
    ]
    if examples.timing is not None:
        found = [
            still("perfect long exposure", "a smaller mean square error of linear light", of_light=True),
            still("best still film", "a better PSNR, of all or of moving pixels", of_light=False),
            *found,
        ]
    if len(capture.stack.depths_m) < 2:
        return found
    return [
        constant(f"constant depth ({100 * mean_m.item():.2f} cm)", DEPTH_SCORES, of_cm, black, of_depth),
        constant(f"constant disparity ({nearer_cm:.2f} cm)", DISPARITY_SCORES, of_inverse, black, of_disparity),
        *found,
    ]


@dataclass(frozen=True)
class Times:
    """Seconds per scene of one method: medians over the repeats, by stage and of all stages together; the least total."""

    method: str
    stages: dict[str, float]
    total: float
    fastest: float

    def plain(self) -> dict[str, Any]:
        """Return the same for JSON."""
        return {"method": self.method, "stages_s": self.stages, "total_s": self.total, "fastest_s": self.fastest}


def take_times(
    methods: Sequence[Method],
    measurements: Tensor,
    repeats: int,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Times]:
    """Time methods on the device of measurements ``(N, C, H, W)``, of which each turn takes the next one.

    ``repeats`` turns count, after one that does not; ``progress`` is called with turns done and in all.
    """
    found: list[list[dict[str, float]]] = [[] for _ in methods]
    for turn in range(repeats + 1):
        scene = measurements[turn % len(measurements)][None]
        for which, method in enumerate(methods):
            clock = Clock(scene.device)
            method.reconstruct(scene, clock)
            if turn:
                found[which].append(clock.seconds)
        progress(turn + 1, repeats + 1)
    times = []
    for method, turns in zip(methods, found, strict=True):
        totals = [sum(seconds.values()) for seconds in turns]
        stages = {stage: median(seconds[stage] for seconds in turns) for stage in turns[0]}
        times.append(Times(method.name, stages, median(totals), min(totals)))
    return times
