"""How right a classifier is, and how sure it may be of that: top-k accuracy, confusion, calibration, intervals.

All from the probabilities that each seed gives each class for each capture. One interval covers the choice of captures,
another one, where there are several seeds, what trainings with other seeds would have given.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from learning.evaluate.paired import mean_interval

TOP = (1, 2, 5)
"""Of how many guesses one must be right; as in the thesis, table 5.1."""
BINS = 10
"""Of equal width, over the confidence, in the reliability diagram."""


@dataclass(frozen=True, eq=False)
class Predictions:
    """What a classifier says of the captures of a test.

    Attributes:
        name: in tables and figures.
        classes: what it tells apart.
        truth: ``(n,)``, the number of each capture's class.
        probabilities: ``(seeds, n, classes)``.
        noise_db: level at which noise was drawn anew; None for measurements as stored.
        clips: what each capture shows, by name: see `learning.provenance.clips_of`.
        slivers: how many frames it tells apart in a capture; None of what looks at no capture.
        kind: what it is but for seed and number of slivers: rows of one kind are compared by these.
        note: the network in words.
        checkpoints: of each seed, plain: its file, what was learned with which seed in how many steps.
        test_fingerprint: of the data with the captures.
        bootstrap_seed: of the intervals.
    """

    name: str
    classes: tuple[str, ...]
    truth: NDArray[np.int64]
    probabilities: NDArray[np.float64]
    noise_db: float | None = None
    clips: tuple[str, ...] = ()
    slivers: int | None = None
    kind: str = ""
    note: str = ""
    checkpoints: Sequence[Mapping[str, Any]] = ()
    test_fingerprint: str = ""
    bootstrap_seed: int = 0

    @cached_property
    def guesses(self) -> NDArray[np.int64]:
        """The most likely class of each seed and capture, ``(seeds, n)``; the first of several.

        Where the true one is among several, `ranks` counts the answer as wrong: nothing was told apart.
        """
        return self.probabilities.argmax(axis=-1)

    @cached_property
    def ranks(self) -> NDArray[np.int64]:
        """How many classes are at least as likely as the true one, itself not counted, ``(seeds, n)``."""
        own = np.take_along_axis(self.probabilities, self.truth[None, :, None], axis=-1)
        return (self.probabilities >= own).sum(axis=-1) - 1

    def right(self, top: int = 1) -> NDArray[np.float64]:
        """Return in which share of the seeds the true class is among the ``top`` guesses, of each capture ``(n,)``."""
        return (self.ranks < top).mean(axis=0)

    def accuracy(self, top: int = 1) -> float:
        """Return the share of the captures whose class is among the ``top`` guesses, 0 to 1, mean over seeds."""
        return float(self.right(top).mean())

    def over_seeds(self, top: int = 1) -> float | None:
        """Return half the width of the 95 % interval (Student's t) of the mean accuracy over seeds; None of one."""
        each = (self.ranks < top).mean(axis=1)
        return float(stats.t.ppf(0.975, len(each) - 1) * stats.sem(each)) if len(each) > 1 else None

    @cached_property
    def intervals(self) -> dict[int, tuple[float, float] | None]:
        """The 95 % interval of the accuracy over captures, for each of `TOP`; None of a single capture.

        See `learning.evaluate.paired.mean_interval`; where all captures are right equally often, `wilson`'s,
        because all resamples are then alike.
        """
        return {top: self._interval(top) for top in TOP}

    def _interval(self, top: int) -> tuple[float, float] | None:
        right = self.right(top)
        if len(right) > 1 and np.ptp(right) == 0:
            return wilson(round(right.sum()), len(right))
        return mean_interval(right, self.bootstrap_seed)

    def confusion(self) -> NDArray[np.float64]:
        """Return which share of each class's captures (rows) is taken for which class (columns), mean over seeds.

        Rows of classes of which there are no captures are NaN.
        """
        counts = np.zeros((len(self.classes),) * 2)
        for guesses in self.guesses:
            np.add.at(counts, (self.truth, guesses), 1)
        return _shares(counts)

    def reliability(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
        """Return mean confidence, accuracy and number of predictions of each bin, ``(BINS,)``; NaN where a bin is empty.

        The confidence is the probability of the most likely class (Guo et al., On Calibration of Modern Neural Networks, ICML
        2017); the predictions are those of all seeds.
        """
        counts, *sums = np.sum([self._bins(seed) for seed in range(len(self.probabilities))], axis=0)
        with np.errstate(invalid="ignore"):
            confidence, right = (total / counts for total in sums)
        return confidence, right, counts.astype(int)

    def calibration_error(self) -> float:
        """Return the mean difference of confidence and accuracy over the bins, weighted by their predictions (ECE).

        The mean of the seeds' own: of two, one may be as much too sure as the other is too unsure.
        """
        every = [self._bins(seed) for seed in range(len(self.probabilities))]
        return float(np.mean([np.abs(confidence - right).sum() / counts.sum() for counts, confidence, right in every]))

    def _bins(self, seed: int) -> list[NDArray[np.float64]]:
        """Return how many predictions of a seed are in each bin, the sum of their confidences, and how many are right."""
        confidence, right = self.probabilities[seed].max(axis=-1), self.guesses[seed] == self.truth
        bins = np.minimum((confidence * BINS).astype(int), BINS - 1)
        every = (np.ones_like(confidence), confidence, right)
        return [np.bincount(bins, values, BINS).astype(float) for values in every]

    def log_loss(self) -> float:
        """Return the mean cross entropy, nats; a probability of zero counts as the smallest of float32."""
        own = np.take_along_axis(self.probabilities, self.truth[None, :, None], axis=-1)
        return float(-np.log(np.maximum(own, np.finfo(np.float32).tiny)).mean())

    def plain(self) -> dict[str, Any]:
        """Return all of it for JSON."""
        return {
            "name": self.name,
            "noise_db": self.noise_db,
            "slivers": self.slivers,
            "captures": len(self.truth),
            "seeds": len(self.probabilities),
            "note": self.note,
            "checkpoints": list(self.checkpoints),
            "test_fingerprint": self.test_fingerprint,
            **{
                f"top_{top}": {
                    "mean": self.accuracy(top),
                    "interval": self.intervals[top],
                    "half_interval_over_seeds": self.over_seeds(top),
                }
                for top in TOP
            },
            "calibration_error": self.calibration_error(),
            "log_loss": self.log_loss(),
            "confusion": without_nan(self.confusion()),
        }


@dataclass(frozen=True)
class Difference:
    """By how much the reference's top-1 accuracy exceeds another's, and the 95 % interval of that over captures.

    The interval is that of the differences capture by capture, ``paired``; where the two have seen other clips, or all
    differences are alike, that of independent means.
    """

    other: str
    mean: float
    interval: tuple[float, float] | None
    paired: bool


def difference(reference: Predictions, other: Predictions) -> Difference:
    """Return by how much one classifier is ahead of another; captures are paired where they show the same clips in order."""
    one, two = reference.right(), other.right()
    mean, paired = float(one.mean() - two.mean()), reference.clips == other.clips
    if paired and np.ptp(one - two) > 0:
        return Difference(other.name, mean, mean_interval(one - two, reference.bootstrap_seed), paired=True)
    ends = reference.intervals[1], other.intervals[1]
    if ends[0] is None or ends[1] is None:
        return Difference(other.name, mean, None, paired)
    # Newcombe's hybrid (Statistics in Medicine 17, 1998, method 10): distances to the ends add up in squares.
    below = math.hypot(one.mean() - ends[0][0], ends[1][1] - two.mean())
    above = math.hypot(ends[0][1] - one.mean(), two.mean() - ends[1][0])
    return Difference(other.name, mean, (mean - below, mean + above), paired)


def chance(classes: Sequence[str], top: int = 1) -> float:
    """Return the accuracy of guesses that look at nothing, all classes being equally likely."""
    return min(top / len(classes), 1.0)


def majority(truth: NDArray[np.int64], top: int = 1) -> float:
    """Return the accuracy of always naming the classes that are most frequent in the test: the best constant answer."""
    counts = np.sort(np.bincount(truth))[::-1]
    return float(counts[:top].sum() / len(truth))


def confusion_after_reversal(forwards: Predictions, backwards: Predictions) -> NDArray[np.float64]:
    """Return the shares of a class's correctly classified captures (rows) that are assigned to each class after reversal.

    ``(classes, classes)``, over all seeds; rows of classes without any are NaN.
    """
    counts = np.zeros((len(forwards.classes),) * 2)
    for before, after in zip(forwards.guesses, backwards.guesses, strict=True):
        right = before == forwards.truth
        np.add.at(counts, (forwards.truth[right], after[right]), 1)
    return _shares(counts)


def wilson(right: int, of: int) -> tuple[float, float]:
    """Return the 95 % interval of a share (Wilson, JASA 22, 1927), which has a width even where none or all are right."""
    known = stats.binomtest(right, of).proportion_ci(0.95, "wilson")
    return float(known.low), float(known.high)


def without_nan(shares: NDArray[np.float64]) -> list[list[float | None]]:
    """Return a table for JSON, which knows no NaN: None in its place."""
    return [[None if math.isnan(share) else share for share in row] for row in shares.tolist()]


def _shares(counts: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return each row's shares; NaN in rows of zeros."""
    with np.errstate(invalid="ignore"):
        return counts / counts.sum(axis=1, keepdims=True)
