"""How right a classifier is, and how sure it may be of that: top-k accuracy, confusion, calibration, intervals.

All from the probabilities that each seed gives each class for each capture. Intervals cover the choice of captures; what
another training would have given is said by the standard deviation over seeds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from learning.evaluate.paired import mean_interval

TOP = (1, 2, 5)
"""Of how many guesses one must be right; as in the thesis, table 5.1."""
BINS = 10
"""Of equal width, over the confidence, in the reliability diagram."""


@dataclass(frozen=True, eq=False)
class Answers:
    """What a classifier says of the captures of a test.

    Attributes:
        name: in tables and figures.
        classes: what it tells apart.
        truth: ``(n,)``, the number of each capture's class.
        probabilities: ``(seeds, n, classes)``.
        noise_db: level at which noise was drawn anew; None for measurements as stored.
        slivers: how many frames it tells apart in a capture; None of what looks at no capture.
        architecture: the network and its classifier, in words.
        note: what else is to be known of it.
        seed: of the intervals' resampling.
    """

    name: str
    classes: tuple[str, ...]
    truth: NDArray[np.int64]
    probabilities: NDArray[np.float64]
    noise_db: float | None = None
    slivers: int | None = None
    architecture: str = ""
    note: str = ""
    seed: int = 0

    @cached_property
    def guesses(self) -> NDArray[np.int64]:
        """The most likely class of each seed and capture, ``(seeds, n)``."""
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
        """Return the standard deviation (n - 1) of the accuracy over seeds; None of one."""
        each = (self.ranks < top).mean(axis=1)
        return float(each.std(ddof=1)) if len(each) > 1 else None

    @cached_property
    def intervals(self) -> dict[int, tuple[float, float] | None]:
        """The 95 % interval of the accuracy for each of `TOP`, see `learning.evaluate.paired.mean_interval`."""
        return {top: mean_interval(self.right(top), self.seed) for top in TOP}

    def confusion(self) -> NDArray[np.float64]:
        """Return which share of each class's captures (rows) is taken for which class (columns), mean over seeds."""
        counts = np.zeros((len(self.classes),) * 2)
        for guesses in self.guesses:
            np.add.at(counts, (self.truth, guesses), 1)
        return counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)

    def reliability(self) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
        """Return mean confidence, accuracy and number of answers of each bin, ``(BINS,)``; NaN where a bin is empty.

        The confidence is the probability of the most likely class (Guo et al., On Calibration of Modern Neural Networks, ICML
        2017).
        """
        confidence, right = self.probabilities.max(axis=-1).ravel(), (self.guesses == self.truth).ravel()
        bins = np.minimum((confidence * BINS).astype(int), BINS - 1)
        counts = np.bincount(bins, minlength=BINS)
        with np.errstate(invalid="ignore"):
            means = [np.bincount(bins, values, BINS) / counts for values in (confidence, right)]
        return means[0], means[1], counts

    def calibration_error(self) -> float:
        """Return the mean difference of confidence and accuracy over the bins, weighted by their answers (ECE)."""
        confidence, right, counts = self.reliability()
        known = counts > 0
        return float(np.abs(confidence - right)[known] @ counts[known] / counts.sum())

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
            "architecture": self.architecture,
            "note": self.note,
            **{
                f"top_{top}": {
                    "mean": self.accuracy(top),
                    "interval": self.intervals[top],
                    "over_seeds": self.over_seeds(top),
                }
                for top in TOP
            },
            "calibration_error": self.calibration_error(),
            "log_loss": self.log_loss(),
            "confusion": self.confusion().tolist(),
        }


@dataclass(frozen=True)
class Lead:
    """By how much the reference's top-1 accuracy exceeds another's, over the same captures, and the 95 % interval of that.

    The interval is that of the differences capture by capture, ``paired``, or where the two have seen other captures, of
    independent ones.
    """

    other: str
    mean: float
    interval: tuple[float, float] | None
    paired: bool


def lead(reference: Answers, other: Answers) -> Lead:
    """Return by how much one classifier is ahead of another; captures are paired where both have the same, in one order."""
    one, two = reference.right(), other.right()
    mean = float(one.mean() - two.mean())
    if len(one) == len(two) and np.array_equal(reference.truth, other.truth):
        return Lead(other.name, mean, mean_interval(one - two, reference.seed), paired=True)
    ends = [each.intervals[1] for each in (reference, other)]
    if None in ends:
        return Lead(other.name, mean, None, paired=False)
    # Of independent means, half widths add up in squares.
    half = math.hypot(*((high - low) / 2 for low, high in filter(None, ends)))
    return Lead(other.name, mean, (mean - half, mean + half), paired=False)


def chance(classes: Sequence[str], top: int = 1) -> float:
    """Return the accuracy of guesses that look at nothing, all classes being equally likely."""
    return min(top / len(classes), 1.0)


def majority(truth: NDArray[np.int64], top: int = 1) -> float:
    """Return the accuracy of always naming the classes that are most frequent in the test: the best constant answer."""
    counts = np.sort(np.bincount(truth))[::-1]
    return float(counts[:top].sum() / len(truth))


def become(forwards: Answers, backwards: Answers) -> NDArray[np.float64]:
    """Return what the captures that are named rightly become when their clips run backwards, ``(classes, classes)``.

    A row is the share of a class's right answers, over seeds, that are then taken for each class; rows without any are NaN.
    """
    counts = np.zeros((len(forwards.classes),) * 2)
    for before, after in zip(forwards.guesses, backwards.guesses, strict=True):
        right = before == forwards.truth
        np.add.at(counts, (forwards.truth[right], after[right]), 1)
    with np.errstate(invalid="ignore"):
        return counts / counts.sum(axis=1, keepdims=True)
