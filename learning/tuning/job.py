"""`flatlight tune`: from its file to scenes, camera and search spaces."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch.utils.data import default_collate

from learning.baselines.method import DEFAULTS, SEARCH, VOLUME_PARAMETERS, build_classical
from learning.capture import CaptureModel, capture_model
from learning.code_fingerprint import code_fingerprint
from learning.config.tune import FEWEST_SCENES, TuneConfig
from learning.data import Example, ExampleSet, check_dataset
from learning.devices import choose_device
from learning.display import measure_white
from learning.tuning import Tunable, VolumeMethod, tune
from learning.tuning.book import TuningBook
from learning.tuning.score import FORMULAS, Score
from learning.tuning.search import Axis, Parameters
from simulator import __version__
from simulator.dataset.manifest import load_manifest
from simulator.dataset.reader import Dataset, open_dataset
from simulator.errors import InputError
from simulator.io.files import sha256_bytes, storage_errors
from simulator.io.json import canonical_json

# With all that they import, what makes a score of parameters and scenes.
_DECIDING = ("learning.baselines.method", "learning.data", "learning.display", "learning.tuning.score")


def tune_file(
    config: TuneConfig,
    *,
    tunables: Callable[[CaptureModel], list[Tunable]] | None = None,
    progress: Callable[[str, int, int], None] = lambda *_: None,
    say: Callable[[str], None] = lambda _: None,
) -> Path:
    """Tune as a file says, or go on where an earlier run stopped, and return the file of the result.

    Args:
        config: the file.
        tunables: the methods for a camera; None takes ``config.methods``.
        progress: called with a stage, trials done and about how many there will be.
        say: called with a line for each result.

    Raises:
        InputError: data without enough scenes, without depth, or that are not for stills; a stack that does not fit; an
            unknown parameter; a book of other data or settings.
        StorageError: the result cannot be written.
    """
    output = config.resolve_path(config.output)
    with storage_errors(output):
        output.parent.mkdir(parents=True, exist_ok=True)
    device = choose_device(config.device)
    dataset = _scenes(config)
    check_dataset(dataset)
    train = open_dataset(config.resolve_path(config.data.train or config.data.validation), "train")
    stack = config.data.stack
    named = stack if stack in ("nominal", "captured") else config.resolve_path(stack)
    capture = capture_model(dataset, named, white=measure_white(train))
    methods = tunables(capture) if tunables else [classical(capture, name, config, device) for name in config.methods]
    truth = _load(dataset, None, config.seed)
    score = Score(config.objective, truth, capture)
    book = TuningBook(output, _identity(config, dataset, capture), _about(config, score))
    measurements = {
        level: _load(dataset, level, config.seed).measurement.to(device) for level in dict.fromkeys(config.noise_db)
    }
    tune(methods, measurements, score, book, progress=progress, say=say)
    return output


def classical(capture: CaptureModel, name: str, config: TuneConfig, device: torch.device) -> Tunable:
    """Return a classical method with its own search space, changed as the file says."""
    changes = config.search.get(name, {})
    axes: dict[str, Axis] = {}
    for parameter in [*SEARCH[name], *(extra for extra in changes if extra not in SEARCH[name])]:
        change = changes.get(parameter)
        own = SEARCH[name].get(parameter)
        values = own if change is None or change.values is None else change.values
        if values is None:
            msg = (
                f"search.{name}.{parameter}: no values; expected candidates for it, or one of {', '.join(SEARCH[name])}"
            )
            raise InputError(msg)
        low, high = limits(parameter, capture)
        if change is not None:
            low, high = low if change.low is None else change.low, high if change.high is None else change.high
        try:
            axes[parameter] = Axis(tuple(values), low, high)
        except InputError as error:
            msg = f"search.{name}.{parameter}: {error}"
            raise InputError(msg) from error

    def build(parameters: Parameters) -> VolumeMethod:
        return build_classical(capture, name, parameters).to(device)

    return Tunable(name, build, dict(DEFAULTS[name]), axes, frozenset(VOLUME_PARAMETERS[name]))


def limits(parameter: str, capture: CaptureModel) -> tuple[float, float]:
    """Return the least and the greatest value of a parameter that still mean something; a file may ask for others."""
    # Half the scene: a wider window averages everything.
    widest_px = max(capture.scene_shape) / 2 if parameter == "window_px" else math.inf
    low, high = _LIMITS.get(parameter, (0.0, math.inf))
    return low, min(high, widest_px)


_LIMITS: dict[str, tuple[float, float]] = {
    # Of the PSF's mean spectral power: less is below the rounding of float32, more leaves nothing but the mean brightness.
    "strength": (1e-7, 100.0),
    # The Laplacian's greatest response is 8: far more is Tikhonov's regularisation, far less the Laplacian alone.
    "floor": (1e-4, 1000.0),
    # White is 1: a weight of 10 on every step or value leaves a grey plane, or nothing.
    "tv": (1e-6, 10.0),
    "sparsity": (1e-6, 10.0),
    # More is for the file to ask: nobody would wait for it.
    "iterations": (1, 1000),
    # Costs are alike for all planes below, and those of a single plane above.
    "contrast": (0.01, 1000.0),
    # A window of a quarter of a pixel is that pixel.
    "window_px": (0.25, math.inf),
    # Of the cost between a pixel's best and worst label: a map of noise below, of one depth above.
    "pairwise": (1e-3, 1000.0),
    # 32 labels between two planes are finer than any capture tells.
    "steps_between_planes": (1, 32),
}


def _scenes(config: TuneConfig) -> Dataset:
    data = config.data
    dataset = open_dataset(config.resolve_path(data.validation), data.split)
    if len(dataset) < data.scenes:
        cure = "generate more of them"
        if len(dataset) < FEWEST_SCENES or data.allow_few_scenes:
            cure += ", or set data.scenes (and allow_few_scenes: true below 32)"
        msg = f"data.scenes: got {data.scenes}, but split {data.split!r} of {dataset.root} has {len(dataset)} samples; {cure}"
        raise InputError(msg)
    return dataset[: data.scenes]


def _load(dataset: Dataset, noise_db: float | None, seed: int) -> Example:
    examples = ExampleSet(dataset, noise_db=None if noise_db is None else (noise_db, noise_db), seed=seed)
    return Example(*default_collate([tuple(examples[position]) for position in range(len(dataset))]))


def _identity(config: TuneConfig, dataset: Dataset, capture: CaptureModel) -> dict[str, Any]:
    """Return all that decides the score of given parameters."""
    kept = load_manifest(dataset.root).entries
    digests = [kept[dataset.split, sample].digest for sample in dataset.ids]
    return {
        "data": dataset.fingerprint,
        "split": dataset.split,
        "samples": list(dataset.ids),
        "digests": sha256_bytes(canonical_json(digests)),
        "stack": capture.stack.fingerprint,
        "white": capture.white,
        "objective": config.objective,
        "seed": config.seed,
        "version": __version__,
        "code": code_fingerprint(*_DECIDING),
    }


def _about(config: TuneConfig, score: Score) -> dict[str, Any]:
    return {
        "config": config.dump(),
        "scenes": config.data.scenes,
        "fewer_scenes_than_advised": config.data.scenes < FEWEST_SCENES,
        "objective": FORMULAS[config.objective],
        "constant_guess": {"psnr_db": score.constant.psnr_db, "depth_rmse_cm": score.constant.depth_rmse_cm},
        "device": config.device,
        "torch": torch.__version__,
    }
