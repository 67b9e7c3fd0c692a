"""`flatlight tune`: the parameters with the best score on validation scenes, for each noise level by itself."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

import torch
from torch import Tensor
from torch.utils.data import default_collate

from learning.camera import CaptureModel, capture_model, check_range, measure_reference_white
from learning.checkpoint import DENOISER, find_denoiser
from learning.classical.by_name import ALL_DEFAULTS, ALL_SEARCH, ALL_VOLUME_PARAMETERS, build_method
from learning.classical.clip_depth import ClipDepth
from learning.classical.clips import ClipMethod
from learning.classical.method import ClassicalMethod
from learning.config import FEWEST_SCENES, TuneConfig
from learning.data import Example, ExampleSet, check_dataset, measured_psnr_db
from learning.method import Estimate, Progress, Say, aligned, choose_device, linear_to_srgb
from learning.metrics import depth_scores, psnr
from learning.provenance import sample_digests, scenes_of
from learning.tune.search import Axis, Parameters, coordinate_search
from learning.tune.study import Study
from simulator import __version__
from simulator.dataset.reader import Dataset, open_dataset
from simulator.errors import InputError
from simulator.io.cache import code_digest
from simulator.io.files import sha256_bytes, sha256_file, storage_errors
from simulator.io.json import canonical_json
from simulator.validation import now_called

Objective = Literal["both", "image", "depth"]

FORMULAS = {
    "both": "image + depth",
    "image": "10^((PSNR of the constant colour - PSNR) / 20), mean PSNR over scenes: a ratio of image RMSEs",
    "depth": "depth RMSE / depth RMSE of the constant depth, mean RMSE over scenes, centimetres, where something was seen",
}
_MOST_BYTES = 2 << 30  # of volumes that are kept
# With all that they import, what makes a score of parameters and scenes.
_DECIDING = ("learning.classical.by_name", "learning.data", "learning.metrics", "learning.tune.job")

_LIMITS: dict[str, tuple[float, float]] = {
    "regularisation_lambda": (1e-7, 100.0),  # below float32's rounding; nothing but the mean brightness is left
    "tikhonov": (1e-4, 1000.0),  # far from the Laplacian's greatest response, 8, on either side
    "tv": (1e-6, 10.0),  # white is 1: ten times that on every step or value leaves a grey plane, or nothing
    "sparsity": (1e-6, 10.0),
    "prior": (1e-4, 100.0),  # 1 is right for white noise and a perfect prior
    "noise_first": (0.1, 100.0),  # multiples of the measurement's noise
    "noise_last": (1e-3, 10.0),
    "iterations": (1, 240),  # more is for the file to ask: at 50 dB, ADMM with 960 scored 0.4 % better
    "contrast": (0.01, 1000.0),  # costs are alike for all planes below, and those of a single plane above
    "window_px": (0.25, math.inf),  # a window of a quarter of a pixel is that pixel
    "pairwise": (1e-3, 1000.0),  # a map of noise below, of one depth above
    "planes": (2, math.inf),  # of two, depth is told; where the stack has fewer, these are taken
    "steps_between_planes": (1, 32),  # finer than any capture tells
}
_HEADINGS: tuple[str, ...] = ("method", "noise dB", "PSNR dB", "depth RMSE cm", "score", "parameters")


def tune_file(
    config: TuneConfig,
    *,
    tunables: Callable[[CaptureModel], list[Tunable]] | None = None,
    progress: Progress = lambda *_: None,
    say: Say = lambda _: None,
) -> Path:
    """Tune as a file says, or go on where an earlier run stopped, and return the file of the result.

    ``tunables`` gives the methods for a camera, None takes ``config.methods``; ``progress`` is called with a stage, trials
    done and about how many there will be, ``say`` with a line for each result.

    Raises:
        InputError: data without enough scenes or without depth; methods of another kind than the data; a stack that does
            not fit; an unknown parameter; a study of other data or settings.
        StorageError: the result cannot be written.
    """
    output = config.resolve_path(config.output)
    with storage_errors(output):
        output.parent.mkdir(parents=True, exist_ok=True)
    device, data = choose_device(config.device), config.data
    dataset = open_dataset(config.resolve_path(data.validation), data.split)
    if len(dataset) < data.scenes:
        cure = "generate more of them"
        if len(dataset) < FEWEST_SCENES or data.allow_few_scenes:
            cure += ", or set data.scenes (and allow_few_scenes: true below 32)"
        found = f"split {data.split!r} of {dataset.root} has {len(dataset)} samples"
        raise InputError("data.scenes", f"got {data.scenes}, but {found}; {cure}")
    dataset = dataset.spread(data.scenes)
    check_dataset(dataset)
    white = measure_reference_white(open_dataset(config.resolve_path(data.train or data.validation), "train"))
    capture = capture_model(dataset, config.resolve_stack(data.stack), white=white)
    check_range(capture)
    if len(capture.stack.depths_m) < 2 and config.objective != "image":
        reason = f"got {config.objective}, but these PSFs are of one depth, which says nothing of others; take image"
        raise InputError("objective", reason)
    methods = tunables(capture) if tunables else [classical(capture, name, config, device) for name in config.methods]
    for method in methods:
        method.build(method.defaults)  # one for other data is refused before the first is tuned
    score = Score(config.objective, _load(dataset, None, config.seed), capture)
    identity = {  # all that decides the score of given parameters
        "data": dataset.fingerprint,
        "split": dataset.split,
        "samples": list(dataset.ids),
        "digests": sha256_bytes(canonical_json(sample_digests(dataset))),
        "scenes": scenes_of(dataset),
        "stack": capture.stack.fingerprint,
        "white": capture.white,
        "objective": config.objective,
        "seed": config.seed,
        "version": __version__,
        "code": code_digest(*_DECIDING),
    }
    if any(DENOISER in ALL_DEFAULTS[name] for name in config.methods):
        identity["denoiser"] = sha256_file(find_denoiser(config.denoiser, resolve=config.resolve_path))
    about = {
        "config": config.dump(),
        "scenes": data.scenes,
        "fewer_scenes_than_advised": data.scenes < FEWEST_SCENES,
        "objective": FORMULAS[config.objective],
        "constant_guess": score.constant.plain(),
        "device": config.device,
        "torch": torch.__version__,
    }
    study = Study(output, identity, about)
    # Noise as stored is known by its measured level, by which `flatlight evaluate` looks for the nearest.
    stored_db = round(measured_psnr_db(dataset), 2)
    if "stored" in config.noise_db and stored_db in config.noise_db:
        raise InputError(
            "noise_db", f"got stored, which has {stored_db:g} dB, beside {stored_db:g}; leave out one of them"
        )
    levels = {
        stored_db if level == "stored" else level: None if level == "stored" else level for level in config.noise_db
    }
    measurements = {name: _load(dataset, level, config.seed).measurement.to(device) for name, level in levels.items()}
    tune(methods, measurements, score, study, progress=progress, say=say)
    return output


def _load(dataset: Dataset, noise_db: float | None, seed: int) -> Example:
    examples = ExampleSet(dataset, noise_db=None if noise_db is None else (noise_db, noise_db), seed=seed)
    return Example(*default_collate([tuple(examples[position]) for position in range(len(dataset))]))


class VolumeMethod(Protocol):
    """A method in two steps, so that the first, which is the costly one, is done once where only the second changes."""

    def volume(self, measurement: Tensor) -> Tensor:
        """Return ``(B, K, C, h, w)`` of measurements ``(B, C, H, W)``."""
        ...

    def estimate(self, volume: Tensor) -> Estimate:
        """Return image and depth of a volume."""
        ...


@dataclass(frozen=True)
class Tunable:
    """A method and its search space.

    ``build`` makes it of its parameters; ``defaults`` are all of these, where the search begins, ``space`` those that are
    searched, in this order, and ``volume_parameters`` those on which the volume depends.
    """

    name: str
    build: Callable[[Parameters], VolumeMethod]
    defaults: Parameters
    space: Mapping[str, Axis]
    volume_parameters: frozenset[str]

    def __post_init__(self) -> None:
        for name in self.space:
            if name not in self.defaults:
                hint = now_called(name, self.defaults)
                raise InputError(f"search.{self.name}", f"got {name!r}, expected {', '.join(self.defaults)}{hint}")


def classical(capture: CaptureModel, name: str, config: TuneConfig, device: torch.device) -> Tunable:
    """Return a classical method with its own search space, changed as the file says; it takes all candidates of the file."""
    changes = config.search.get(name, {})
    defaults, files = dict(ALL_DEFAULTS[name]), {}
    if DENOISER in defaults:
        path = find_denoiser(config.denoiser, resolve=config.resolve_path)
        files = {DENOISER: str(path)}
        if config.denoiser != DENOISER:  # as it lies from the folder of the result, never a bare name
            own = os.path.relpath(path, config.resolve_path(config.output).parent)
            defaults[DENOISER] = os.path.join(os.curdir, own)

    def build(parameters: Parameters) -> ClassicalMethod | ClipMethod | ClipDepth:
        return build_method(capture, name, parameters | files)

    axes: dict[str, Axis] = {}
    for parameter in [*ALL_SEARCH[name], *(extra for extra in changes if extra not in ALL_SEARCH[name])]:
        change = changes.get(parameter)
        values = ALL_SEARCH[name].get(parameter) if change is None or change.values is None else change.values
        if values is None:
            known = f"{', '.join(ALL_SEARCH[name])}{now_called(parameter, ALL_SEARCH[name])}"
            raise InputError(f"search.{name}.{parameter}", f"no values; expected candidates for it, or one of {known}")
        low, high = limits(parameter, capture)
        if change is not None:
            low, high = low if change.low is None else change.low, high if change.high is None else change.high
        try:
            axes[parameter] = Axis(tuple(values), low, high)
            for value in values if change is not None and parameter in defaults else ():
                build(defaults | {parameter: value})
        except InputError as error:
            raise InputError(f"search.{name}.{parameter}", str(error)) from error
    return Tunable(
        name, lambda parameters: build(parameters).to(device), defaults, axes, frozenset(ALL_VOLUME_PARAMETERS[name])
    )


def limits(parameter: str, capture: CaptureModel) -> tuple[float, float]:
    """Return the least and the greatest value of a parameter that still mean something; a file may ask for others."""
    low, high = _LIMITS.get(parameter, (0.0, math.inf))
    # Half the scene: a wider window averages everything.
    return low, max(capture.scene_shape) / 2 if parameter == "window_px" else high


@dataclass(frozen=True)
class Errors:
    """Means over scenes, of the estimate within its ranges: PSNR of sRGB codes, and depth RMSE of valid pixels.

    The latter is NaN where the camera knows one depth.
    """

    psnr_db: float
    depth_rmse_cm: float

    def plain(self) -> dict[str, float | None]:
        """Return the same for JSON, None for what is not finite."""
        return {name: value if math.isfinite(value) else None for name, value in asdict(self).items()}


class Score:
    """One number for a reconstruction of some scenes: 1 (or 2, for both) is what a constant guess would get, 0 is perfect.

    Image and depth weigh the same when each is counted in units of a naive baseline's error: no unit of length and no range
    of depths decides between them. ``constant`` are the errors of the mean colour and of the
    mean depth of these scenes.
    """

    def __init__(self, objective: Objective, truth: Example, capture: CaptureModel) -> None:
        """Look at the truth of all scenes, stacked."""
        self.objective, self._capture = objective, capture
        self._truth, self._images = truth, linear_to_srgb(truth.radiance, capture.white)
        self._seen = truth.valid.flatten(1).any(dim=1)
        all_but_colours = [dim for dim in range(self._images.ndim) if dim != self._images.ndim - 3]
        constant_colour = self._images.mean(dim=all_but_colours, keepdim=True).expand_as(self._images)
        mean_m = truth.depth_m[truth.valid].double().mean().float()
        constant_depth = torch.as_tensor(capture.disparity(mean_m.expand_as(truth.depth_m)))
        self.constant = self.errors([Estimate(constant_colour, constant_depth)])

    def errors(self, estimates: list[Estimate]) -> Errors:
        """Return the errors of estimates that follow each other as the scenes do; NaN where one holds NaN."""
        together = Estimate(*(torch.cat([values.cpu() for values in each]) for each in zip(*estimates, strict=True)))
        estimate, depth_cm = together.clamped(), math.nan
        if len(self._capture.stack.depths_m) > 1:
            depth = depth_scores(estimate, self._truth, self._capture, self._truth.valid).depth_rmse_cm
            depth_cm = float(depth[self._seen].mean())
        return Errors(float(psnr(estimate.image, self._images).mean()), depth_cm)

    def __call__(self, errors: Errors) -> float:
        """Return the number to minimise; infinite where something is NaN."""
        image = 10 ** ((self.constant.psnr_db - errors.psnr_db) / 20)
        depth = errors.depth_rmse_cm / self.constant.depth_rmse_cm
        number = {"both": image + depth, "image": image, "depth": depth}[self.objective]
        return math.inf if math.isnan(number) else number

    def beaten_by_constant(self, errors: Errors) -> tuple[str, ...]:
        """Return what of image and depth, as far as the objective counts it, is not better than the constant guess."""
        worse = {
            "image": not errors.psnr_db > self.constant.psnr_db,
            "depth": not errors.depth_rmse_cm < self.constant.depth_rmse_cm,
        }
        return tuple(name for name, is_worse in worse.items() if is_worse and self.objective in ("both", name))


def tune(
    tunables: Sequence[Tunable],
    measurements: Mapping[float, Tensor],
    score: Score,
    study: Study,
    *,
    progress: Progress = lambda *_: None,
    say: Say = lambda _: None,
) -> None:
    """Tune methods at noise levels and write everything to the study; what it knows is not tried again.

    Levels go from the least noise to the most. The first begins at the defaults and tries all candidates; each further one
    begins at the better of the defaults and the parameters of the level before, and goes from neighbour to neighbour.

    ``measurements`` ``(N, C, H, W)`` are of the same scenes by noise level, decibels, on the device to compute on;
    ``progress`` and ``say`` see `tune_file`.

    Raises:
        InputError: a method whose defaults give no finite score, or a search space without its defaults.
        StorageError: the study cannot be written.
    """
    for tunable in tunables:
        before: list[Parameters] = []
        for noise_db in sorted(measurements, reverse=True):
            trials = _Trials(tunable, noise_db, measurements[noise_db], score, study, progress)
            starts = [tunable.defaults, *before]
            try:
                found = coordinate_search(tunable.space, starts, trials, sweep=not before, least_gain=1e-3)
            except InputError as error:
                raise InputError(f"{tunable.name} at {noise_db:g} dB", str(error)) from error
            best = study.trial(tunable.name, noise_db, found.parameters)
            assert best is not None
            kept = ("method", "noise_db", "parameters", "score", "psnr_db", "depth_rmse_cm")
            errors = {name: math.nan if best[name] is None else float(best[name]) for name in kept[-2:]}
            made = [t for t in study.trials if t["method"] == tunable.name and t["noise_db"] == noise_db]
            result = {
                **{name: best[name] for name in kept},
                "space": {
                    name: {"values": list(axis.values), "low": axis.low, "high": axis.high}
                    for name, axis in tunable.space.items()
                },
                "rounds": found.rounds,
                "converged": found.converged,
                "at_limit": list(found.at_limit),
                "no_better_than_constant": list(score.beaten_by_constant(Errors(**errors))),
                "trials": len(made),
                "trials_with_reused_volumes": sum(t["volume_reused"] for t in made),
                "seconds": round(sum(t["volume_s"] + t["estimate_s"] for t in made), 3),
            }
            study.add_result(result)
            say(in_words(result, score.constant.plain()))
            before = [found.parameters]


class _Trials:
    """Tries parameters of one method at one level; volumes are kept for later trials, the best one's longest."""

    def __init__(
        self, tunable: Tunable, noise_db: float, measurements: Tensor, score: Score, study: Study, progress: Progress
    ) -> None:
        self._tunable, self._noise_db, self._measurements = tunable, noise_db, measurements
        self._score, self._study, self._progress = score, study, progress
        self._best = math.inf
        self._volumes: dict[tuple[Any, ...], list[Tensor]] = {}
        self._best_key: tuple[Any, ...] = ()
        self._asked: set[tuple[Any, ...]] = set()
        self._expected = 1 + sum(len(axis.values) + 1 for axis in tunable.space.values())

    def __call__(self, parameters: Parameters) -> float:
        """Return the score of parameters, tried now or by an earlier run."""
        trial = self._study.trial(self._tunable.name, self._noise_db, parameters)
        if trial is None:
            trial = self._try(parameters)
            self._study.add_trial(trial)
        score = float(trial["score"])
        self._asked.add(tuple(parameters.values()))
        key = self._key(parameters)
        if score < self._best:
            self._best, self._best_key = score, key
        # The oldest volumes go where all of them are too many, but not those of now and of the best trial.
        for old in [k for k in self._volumes if k not in (key, self._best_key)]:
            if sum(part.nbytes for volumes in self._volumes.values() for part in volumes) <= _MOST_BYTES:
                break
            del self._volumes[old]
        self._expected = max(self._expected, len(self._asked) + 1)
        self._progress(f"{self._tunable.name} {self._noise_db:g} dB", len(self._asked), self._expected)
        return score

    def _key(self, parameters: Parameters) -> tuple[Any, ...]:
        return tuple(v for name, v in parameters.items() if name in self._tunable.volume_parameters)

    def _try(self, parameters: Parameters) -> dict[str, Any]:
        method = self._tunable.build(parameters)
        key = self._key(parameters)
        reused = key in self._volumes
        start = time.perf_counter()
        with torch.no_grad():
            if not reused:
                # Scene by scene: a GPU need not hold what lies between of all.
                self._volumes[key] = [method.volume(scene) for scene in self._measurements.split(1)]
            half = time.perf_counter()
            errors = Errors(math.nan, math.nan)  # of parameters with which the iteration diverges
            if all(bool(torch.isfinite(volume).all()) for volume in self._volumes[key]):
                errors = self._score.errors([method.estimate(volume) for volume in self._volumes[key]])
        return {
            "method": self._tunable.name,
            "noise_db": self._noise_db,
            "parameters": dict(parameters),
            "score": self._score(errors),
            **errors.plain(),
            "volume_reused": reused,
            "volume_s": round(half - start, 4),
            "estimate_s": round(time.perf_counter() - half, 4),
        }


def in_words(result: Mapping[str, Any], constant: Mapping[str, Any]) -> str:
    """Return a line about the result of a method at a level, beside the errors of the constant guess."""
    depth = ""
    if constant["depth_rmse_cm"] is not None:
        depth = f", depth RMSE {_number(result['depth_rmse_cm'])} cm ({_number(constant['depth_rmse_cm'])})"
    return (
        f"{result['method']} at {result['noise_db']:g} dB: PSNR {_number(result['psnr_db'])} dB (constant guess "
        f"{_number(constant['psnr_db'])}){depth}, score {result['score']:.4g} with {_parameters_and_remarks(result)}"
    )


def table(content: Mapping[str, Any]) -> str:
    """Return all results of a study and the constant guess, one line each."""
    constant = content["about"]["constant_guess"]
    rows = [_HEADINGS]
    for result in content["results"]:
        numbers = (_number(result["psnr_db"]), _number(result["depth_rmse_cm"]), f"{result['score']:.4g}")
        rows.append((result["method"], f"{result['noise_db']:g}", *numbers, _parameters_and_remarks(result)))
    rows.append(("constant guess", "", _number(constant["psnr_db"]), _number(constant["depth_rmse_cm"]), "", ""))
    lines = aligned([numbers for *numbers, _ in rows])
    return "\n".join(f"{line}  {words}".rstrip() for line, (*_, words) in zip(lines, rows, strict=True))


def _parameters_and_remarks(result: Mapping[str, Any]) -> str:
    parameters = (f"{k} {v}" if isinstance(v, str) else f"{k} {v:g}" for k, v in result["parameters"].items())
    words = [", ".join(parameters)]
    if worse := result["no_better_than_constant"]:
        words.append(f"{' and '.join(worse)} no better than a constant guess")
    if result["at_limit"]:
        words.append(f"at its limit: {', '.join(result['at_limit'])}")
    if not result["converged"]:
        words.append(f"still changing after {result['rounds']} rounds")
    return "; ".join(words)


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
