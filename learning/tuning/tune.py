"""The parameters with the best score on validation scenes, for each noise level by itself."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Protocol

import torch
from torch import Tensor

from learning.estimate import Estimate
from learning.tuning.book import TuningBook
from learning.tuning.score import Errors, Score
from learning.tuning.search import Axis, Found, Parameters, coordinate_search
from learning.tuning.summary import in_words
from simulator.errors import InputError

_BATCH = 4  # scenes that are inverted at once
_MOST_BYTES = 2 << 30  # of volumes that are kept


class VolumeMethod(Protocol):
    """A method in two steps, so that the first, which is the costly one, is done once where only the second changes."""

    def volume(self, measurement: Tensor) -> Tensor:
        """Return the volume ``(B, K, C, h, w)`` of measurements ``(B, C, H, W)``."""
        ...

    def estimate(self, volume: Tensor) -> Estimate:
        """Return picture and depth of a volume."""
        ...


@dataclass(frozen=True)
class Tunable:
    """A method and its search space.

    Attributes:
        name: of the method.
        build: makes it of its parameters.
        defaults: all parameters; where the search begins.
        space: those that are searched, in this order.
        volume_parameters: those on which the volume depends.
    """

    name: str
    build: Callable[[Parameters], VolumeMethod]
    defaults: Parameters
    space: Mapping[str, Axis]
    volume_parameters: frozenset[str]

    def __post_init__(self) -> None:
        unknown = [name for name in self.space if name not in self.defaults]
        if unknown:
            msg = f"search.{self.name}: got {unknown[0]!r}, expected one of {', '.join(self.defaults)}"
            raise InputError(msg)


class _Trials:
    """Tries parameters of one method at one level; volumes are kept for later trials, the best one's longest."""

    def __init__(
        self,
        tunable: Tunable,
        noise_db: float,
        measurements: Tensor,
        score: Score,
        book: TuningBook,
        progress: Callable[[str, int, int], None],
    ) -> None:
        self._tunable, self._noise_db, self._measurements = tunable, noise_db, measurements
        self._score, self._book, self._progress = score, book, progress
        self._best = math.inf
        self._volumes: dict[tuple[Any, ...], list[Tensor]] = {}
        self._best_key: tuple[Any, ...] = ()
        self._asked: set[tuple[Any, ...]] = set()
        self._expected = 1 + sum(len(axis.values) + 1 for axis in tunable.space.values())

    def __call__(self, parameters: Parameters) -> float:
        """Return the score of parameters, tried now or by an earlier run."""
        trial = self._book.trial(self._tunable.name, self._noise_db, parameters)
        if trial is None:
            trial = self._try(parameters)
            self._book.add_trial(trial)
        score = float(trial["score"])
        self._asked.add(tuple(parameters.values()))
        key = self._key(parameters)
        if score < self._best:
            self._best, self._best_key = score, key
        self._forget(key)
        self._expected = max(self._expected, len(self._asked) + 1)
        self._progress(f"{self._tunable.name} {self._noise_db:g} dB", len(self._asked), self._expected)
        return score

    def _key(self, parameters: Parameters) -> tuple[Any, ...]:
        return tuple(v for name, v in parameters.items() if name in self._tunable.volume_parameters)

    def _forget(self, key: tuple[Any, ...]) -> None:
        """Drop the oldest volumes where all of them are too many, but not those of a key and of the best trial."""
        for old in [k for k in self._volumes if k not in (key, self._best_key)]:
            size = sum(part.nbytes for volumes in self._volumes.values() for part in volumes)
            if size <= _MOST_BYTES:
                break
            del self._volumes[old]

    def _try(self, parameters: Parameters) -> dict[str, Any]:
        method = self._tunable.build(parameters)
        key = self._key(parameters)
        reused = key in self._volumes
        start = time.perf_counter()
        with torch.no_grad():
            if not reused:
                self._volumes[key] = [method.volume(part) for part in self._measurements.split(_BATCH)]
            half = time.perf_counter()
            errors = Errors(math.nan, math.nan)  # of parameters with which the iteration diverges
            if all(bool(torch.isfinite(volume).all()) for volume in self._volumes[key]):
                errors = self._score.errors([method.estimate(volume) for volume in self._volumes[key]])
        seconds = {"volume_s": half - start, "estimate_s": time.perf_counter() - half}
        known = {name: value if math.isfinite(value) else None for name, value in asdict(errors).items()}
        return {
            "method": self._tunable.name,
            "noise_db": self._noise_db,
            "parameters": dict(parameters),
            "score": self._score(errors),
            **known,
            "volume_reused": reused,
            **{name: round(value, 4) for name, value in seconds.items()},
        }


def tune(
    tunables: Sequence[Tunable],
    measurements: Mapping[float, Tensor],
    score: Score,
    book: TuningBook,
    *,
    progress: Callable[[str, int, int], None] = lambda *_: None,
    say: Callable[[str], None] = lambda _: None,
) -> None:
    """Tune methods at noise levels and write everything to the book.

    Levels go from the least noise to the most. The first begins at the defaults and tries all candidates; each further one
    begins at the better of the defaults and the parameters of the level before, and goes from neighbour to neighbour.

    Args:
        tunables: the methods.
        measurements: ``(N, C, H, W)`` of the same scenes by noise level, decibels, on the device to compute on.
        score: of these scenes.
        book: where trials and results go; what it knows is not tried again.
        progress: called with a stage, trials done and about how many there will be.
        say: called with a line for each result.

    Raises:
        InputError: a method whose defaults give no finite score, or a search space without its defaults.
        StorageError: the book cannot be written.
    """
    for tunable in tunables:
        before: list[Parameters] = []
        for noise_db in sorted(measurements, reverse=True):
            trials = _Trials(tunable, noise_db, measurements[noise_db], score, book, progress)
            try:
                found = coordinate_search(
                    tunable.space, [tunable.defaults, *before], trials, sweep=not before, least_gain=1e-3
                )
            except InputError as error:
                msg = f"{tunable.name} at {noise_db:g} dB: {error}"
                raise InputError(msg) from error
            result = _result(tunable, noise_db, found, book, score)
            book.add_result(result)
            say(in_words(result, asdict(score.constant)))
            before = [found.parameters]


def _result(tunable: Tunable, noise_db: float, found: Found, book: TuningBook, score: Score) -> dict[str, Any]:
    best = book.trial(tunable.name, noise_db, found.parameters)
    assert best is not None
    space = {
        name: {"values": list(axis.values), "low": axis.low, "high": axis.high} for name, axis in tunable.space.items()
    }
    trials = [t for t in book.trials if t["method"] == tunable.name and t["noise_db"] == noise_db]
    return {
        **{name: best[name] for name in ("method", "noise_db", "parameters", "score", "psnr_db", "depth_rmse_cm")},
        "space": space,
        "rounds": found.rounds,
        "converged": found.converged,
        "at_limit": list(found.at_limit),
        "no_better_than_constant": list(score.beaten_by_constant(_errors(best))),
        "trials": len(trials),
        "trials_with_reused_volumes": sum(t["volume_reused"] for t in trials),
        "seconds": round(sum(t["volume_s"] + t["estimate_s"] for t in trials), 3),
    }


def _errors(trial: Mapping[str, Any]) -> Errors:
    known = {name: math.nan if trial[name] is None else float(trial[name]) for name in ("psnr_db", "depth_rmse_cm")}
    return Errors(**known)
