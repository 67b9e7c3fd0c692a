"""`flatlight confidence`: calibrate the confidence of a method's depths on validation scenes, and check it on test scenes.

Noise is drawn anew at several levels, because its level is one of the things that confidence follows from.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import default_collate

from learning.confidence.calibration import TOLERANCE, UNKNOWN, DepthConfidence, calibrate, features, is_right
from learning.confidence.files import SUFFIX, ConfidenceFile, method_identity
from learning.data import Example, ExampleSet
from learning.method import Clock, Method, Progress, aligned, choose_device, threads_for
from learning.reconstruct.choice import choose_method
from learning.reconstruct.inputs import Request, load_measurement
from learning.validation import true_estimate
from simulator.dataset.reader import open_dataset
from simulator.errors import InputError
from simulator.io.files import write_atomic
from simulator.plots import drawing
from simulator.plots.psf import GRID, style

BINS = 10
_BATCH = 8
_LEAST_SCENES = 16
_SHOWN = 1e-3  # share of the pixels below which a bin says nothing


@dataclass(frozen=True, kw_only=True)
class Options(Request):
    """What the command was given; see its help."""

    dataset: Path
    output: Path | None = None
    scenes: int | None = None
    levels: tuple[float, ...] = (20.0, 30.0, 40.0, 50.0)
    device: str = "auto"


@dataclass(frozen=True)
class Reliability:
    """How right confidences were at one level of noise, over all pixels where something was seen.

    Attributes:
        noise_db: PSNR of the measurements.
        right: share of depths that are right.
        unknown: share of depths with a confidence below `UNKNOWN`.
        error: expected calibration error: mean over pixels of |confidence - share that is right| of their bin.
        disparity_rmse, known_rmse: of all depths, and of those that are not unknown; None where there are none.
        confidence, share_right, pixels, rmse: by bin of confidence, `BINS` even ones; None where a bin is empty.
    """

    noise_db: float
    right: float
    unknown: float
    error: float
    disparity_rmse: float
    known_rmse: float | None
    confidence: list[float | None] = field(repr=False)
    share_right: list[float | None] = field(repr=False)
    pixels: list[int] = field(repr=False)
    rmse: list[float | None] = field(repr=False)


@dataclass(frozen=True)
class _Pixels:
    """Of the pixels of some scenes where something was seen: `features`, confidence, error of disparity, whether right."""

    features: NDArray[np.float32]
    confidence: NDArray[np.float32]
    error: NDArray[np.float32]
    right: NDArray[np.bool_]


def confidence_file(options: Options, *, progress: Progress = lambda *_: None) -> str:
    """Calibrate, check, write the file and its picture, and return some lines about it.

    Raises:
        InputError: a data set without validation or test scenes, or without several depths; a method that does not fit.
        StorageError: the result cannot be written.
    """
    device = choose_device(options.device)
    splits = {name: open_dataset(options.dataset, name) for name in ("validation", "test")}
    for name, dataset in splits.items():
        if len(dataset) < _LEAST_SCENES:
            cure = f"generate more: set dataset.{name}"
            raise InputError(
                dataset.root, f"split {name!r} has {len(dataset)} scenes, expected {_LEAST_SCENES}; {cure}"
            )
    validation = splits["validation"]
    setup = choose_method(load_measurement(str(validation.folder(0))), options)
    method = setup.method.to(device)
    if len(method.capture.stack.depths_m) < 2:
        raise InputError("--stack", f"{method.name} knows one depth here; take PSFs of several")
    name = setup.name if options.checkpoint is None and "checkpoint" not in setup.record else None
    beside = Path(setup.record["checkpoint"]).with_suffix(SUFFIX) if name is None else Path(f"{name}{SUFFIX}")
    place = options.output or beside
    many = {key: min(len(each), options.scenes or len(each)) for key, each in splits.items()}
    with threads_for(4 * int(np.prod(method.capture.sensor_shape)) * len(method.capture.stack.channels)):

        def pixels(split: str, level: float, confidence: DepthConfidence | None, stage: str) -> _Pixels:
            examples = ExampleSet(splits[split][: many[split]], noise_db=(level, level))
            return _pixels(method, examples, confidence, device, f"{stage} at {level:g} dB", progress)

        known = [pixels("validation", level, None, "calibration") for level in options.levels]
        levels = ", ".join(f"{level:g}" for level in options.levels)
        origin = f"{validation.info.name}, {many['validation']} validation scenes, {levels} dB"
        found = calibrate([(each.features, each.right) for each in known], origin)
        checked = [_reliability(level, pixels("test", level, found, "check")) for level in options.levels]
    of_levels = {f"{each.noise_db:g} dB": asdict(each) for each in checked}
    ConfidenceFile(found, method_identity(setup.record), of_levels).write(place)
    write_atomic(place.with_suffix(".png"), reliability_png(checked))
    return _report(place, method, found, checked)


def _pixels(
    method: Method,
    examples: ExampleSet,
    confidence: DepthConfidence | None,
    device: torch.device,
    stage: str,
    progress: Progress,
) -> _Pixels:
    parts: list[list[NDArray[np.generic]]] = [[], [], [], []]
    clock = Clock(device)
    for first in range(0, len(examples), _BATCH):
        progress(stage, first, len(examples))
        together = [examples[k] for k in range(first, min(first + _BATCH, len(examples)))]
        example = Example(*(values.to(device) for values in default_collate(together)))
        estimate = method.reconstruct(example.measurement, clock).clamped()
        truth = true_estimate(example, method.capture).disparity
        sure = torch.zeros_like(truth)
        if confidence is not None:
            sure = confidence.of(estimate, example.measurement, method.capture)
        values = (
            features(estimate, example.measurement, method.capture),
            sure,
            estimate.disparity - truth,
            is_right(estimate, truth),
        )
        for part, each in zip(parts, values, strict=True):
            part.append(each[example.valid].cpu().numpy())
    progress(stage, len(examples), len(examples))
    return _Pixels(*(np.concatenate(part) for part in parts))  # pyright: ignore[reportArgumentType]


def _reliability(noise_db: float, pixels: _Pixels) -> Reliability:
    sure, right = pixels.confidence.astype(np.float64), pixels.right
    squares = pixels.error.astype(np.float64) ** 2
    place = np.minimum((sure * BINS).astype(int), BINS - 1)
    count = np.bincount(place, minlength=BINS)

    def mean(values: NDArray[np.generic]) -> list[float | None]:
        total = np.bincount(place, values.astype(np.float64), minlength=BINS)
        return [float(s / n) if n else None for s, n in zip(total, count, strict=True)]

    confidence, shares = mean(sure), mean(right)
    apart = sum(
        n * abs(c - s) for n, c, s in zip(count, confidence, shares, strict=True) if c is not None and s is not None
    )
    known = sure >= UNKNOWN
    return Reliability(
        noise_db=noise_db,
        right=float(right.mean()),
        unknown=float(1 - known.mean()),
        error=float(apart / len(sure)),
        disparity_rmse=float(np.sqrt(squares.mean())),
        known_rmse=float(np.sqrt(squares[known].mean())) if known.any() else None,
        confidence=confidence,
        share_right=shares,
        pixels=count.tolist(),
        rmse=[None if square is None else float(np.sqrt(square)) for square in mean(squares)],
    )


def _report(place: Path, method: Method, found: DepthConfidence, checked: list[Reliability]) -> str:
    head = ["noise", "right", "calibration error", "unknown", "disparity RMSE", "of the known"]
    rows = [
        [
            f"{each.noise_db:g} dB",
            f"{each.right:.1%}",
            f"{each.error:.3f}",
            f"{each.unknown:.1%}",
            f"{each.disparity_rmse:.3f}",
            "none" if each.known_rmse is None else f"{each.known_rmse:.3f}",
        ]
        for each in checked
    ]
    about = (
        f"{method.name}: a depth is right within {TOLERANCE:.0%} of the range of disparity, unknown below a confidence of "
        f"{UNKNOWN:g}; calibrated on {found.origin}, checked on test scenes"
    )
    return "\n".join([about, *aligned([head, *rows]), f"wrote {place}; look at {place.with_suffix('.png')}"])


def reliability_png(checked: Sequence[Reliability]) -> bytes:
    """Return the share of right depths and the error of disparity against confidence, a line per level of noise."""
    figure = drawing.new_figure((9, 4), 110)
    left, right = figure.subplots(1, 2)
    left.plot([0, 1], [0, 1], color=GRID, lw=3, label="calibrated")
    for each in checked:
        often = [k for k, pixels in enumerate(each.pixels) if pixels >= _SHOWN * sum(each.pixels)]
        x = [each.confidence[k] for k in often]
        for axes, values in ((left, each.share_right), (right, each.rmse)):
            axes.plot(x, [values[k] for k in often], marker="o", ms=4, lw=1.6, label=f"{each.noise_db:g} dB")
    style(left, "confidence", "share of depths that are right")
    style(right, "confidence", "RMSE of disparity, of its range")
    left.legend(frameon=False)
    for axes in (left, right):
        axes.set_xlim(0, 1)
        axes.grid(color=GRID)
    left.set_ylim(0, 1)
    right.set_ylim(bottom=0)
    return drawing.figure_png(figure)
