"""Is one method better than another? Their differences scene by scene, with an interval from resampling the scenes.

Scenes differ more than methods do: two means with their spreads do not tell, the differences on the same scenes do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from learning.evaluate.outcome import SCORES, Outcome

COMPARED = ("psnr", "moving_psnr", "ssim", "flip", "cvvdp", "depth_rmse_cm")
"""The scores that are compared."""
CONFIDENCE, RESAMPLES = 0.95, 10_000
_TOGETHER = 1000  # resamples in memory
EXPLAINED = (
    "The first one's score minus the second one's on the same scene, averaged over scenes (with several seeds, over these "
    f"first), and its 95 % bootstrap confidence interval: percentiles of {RESAMPLES} means of scenes resampled with "
    "replacement. For few scenes it is too narrow, by 6 % for 30, by 22 % for 8. It covers the choice of scenes, not that of "
    "seeds, which have rows of their own. ▲ the first is better and the interval excludes zero, ▼ the second is, ○ neither."
)
"""How a table of differences is read."""


@dataclass(frozen=True)
class Difference:
    """A score of the reference minus that of another method, the mean over scenes, and its interval.

    Attributes:
        reference: label of the one, see `Outcome.label`.
        other: of the other one; where both have several seeds, one of the two labels may be that of a single one.
        noise_db: see `Outcome`.
        score: which one.
        mean: over the scenes that have it; of several seeds the mean of each scene is taken first.
        interval: percentiles of the means of scenes that are drawn anew with replacement; None for a single scene.
        scenes: how many.
    """

    reference: str
    other: str
    noise_db: float | None
    score: str
    mean: float
    interval: tuple[float, float] | None
    scenes: int

    @property
    def favours(self) -> Literal["reference", "other"] | None:
        """The better one of the two; None where the interval holds zero."""
        if self.interval is None or self.interval[0] <= 0 <= self.interval[1]:
            return None
        return "reference" if (self.mean > 0) == SCORES[self.score][2] else "other"

    def plain(self) -> dict[str, Any]:
        """Return the same for JSON."""
        return asdict(self) | {"favours": self.favours}


def compare(reference: str, outcomes: Sequence[Outcome], seed: int) -> list[Difference]:
    """Return the differences of a method, by its name, from every other one, on the same scenes at the same noise.

    Those of all seeds together come first, then those of each seed of the reference from the other's mean over seeds, then
    those of the reference's mean from each seed of the other.
    """
    found: list[Difference] = []
    first = next(one for one in outcomes if one.method == reference)
    for other in (one for one in outcomes if one is not first):
        pairs = [(first, other), *((one, other) for one in first.singly), *((first, one) for one in other.singly)]
        for one, another in pairs:
            for score in (name for name in COMPARED if name in one.values and name in another.values):
                with np.errstate(invalid="ignore"):  # of two perfect images, whose PSNR is infinite
                    values = one.values[score].mean(axis=0) - another.values[score].mean(axis=0)
                values = values[np.isfinite(values)]
                if len(values):
                    mean, interval = float(values.mean()), mean_interval(values, seed)
                    about = (one.label, another.label, one.noise_db, score)
                    found.append(Difference(*about, mean, interval, len(values)))
    return found


def mean_interval(values: NDArray[np.float64], seed: int) -> tuple[float, float] | None:
    """Return the interval that holds the mean of what ``values`` ``(n,)`` are a sample of, with 95 % confidence.

    Percentiles of the bootstrap (Efron and Tibshirani 1993, chapter 13), 10 000 resamples; None of a single value.
    """
    if len(values) < 2:
        return None
    rng, count = np.random.default_rng(seed), len(values)
    drawn = (values[rng.integers(0, count, (_TOGETHER, count))] for _ in range(RESAMPLES // _TOGETHER))
    means = np.concatenate([resamples.mean(axis=1) for resamples in drawn])
    low, high = np.percentile(means, [50 * (1 - CONFIDENCE), 50 * (1 + CONFIDENCE)])
    return float(low), float(high)
