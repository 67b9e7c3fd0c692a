"""Means of scores, and how far they spread over scenes and over seeds."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike


@dataclass(frozen=True)
class Summary:
    """One score of one method.

    Attributes:
        mean: over all scenes and seeds.
        over_scenes: standard deviation (n - 1) over scenes of the seeds' mean; None for one scene, or without finite values.
        over_seeds: standard deviation (n - 1) over seeds of the scenes' mean; None for one seed.
        seeds: the scenes' mean of each seed.
        left_out: scenes that have no such score.
    """

    mean: float
    over_scenes: float | None
    over_seeds: float | None
    seeds: tuple[float, ...]
    left_out: int = 0

    def plain(self) -> dict[str, Any]:
        """Return the same for JSON."""
        return asdict(self)


def summarise(values: ArrayLike) -> Summary:
    """Return mean and spreads of scores ``(seeds, scenes)``; scenes with NaN have no such score and are left out.

    Example:
        >>> summary = summarise([[1.0, 2.0], [3.0, 4.0]])
        >>> summary.mean, round(summary.over_scenes, 3), round(summary.over_seeds, 3), summary.seeds
        (2.5, 0.707, 1.414, (1.5, 3.5))
    """
    table = np.asarray(values, np.float64)
    known = ~np.isnan(table).any(axis=0)
    table = table[:, known]
    seeds = table.mean(axis=1)
    left_out = int((~known).sum())
    return Summary(float(seeds.mean()), _spread(table.mean(axis=0)), _spread(seeds), tuple(seeds.tolist()), left_out)


def pooled_rms(squares: ArrayLike, counts: ArrayLike) -> tuple[float | None, ...]:
    """Return the root mean square error of each bin over all scenes and seeds; None where a bin has no pixel.

    Args:
        squares: ``(..., bins)``, sums of squared errors.
        counts: ``(..., bins)``, pixels.

    Example:
        >>> pooled_rms([[4.0, 0.0], [14.0, 0.0]], [[1, 0], [1, 0]])
        (3.0, None)
    """
    bins = np.shape(counts)[-1]
    total = np.asarray(squares, np.float64).reshape(-1, bins).sum(axis=0)
    pixels = np.asarray(counts, np.float64).reshape(-1, bins).sum(axis=0)
    return tuple(math.sqrt(s / n) if n else None for s, n in zip(total.tolist(), pixels.tolist(), strict=True))


def _spread(values: np.ndarray) -> float | None:
    if len(values) < 2 or not np.all(np.isfinite(values)):
        return None
    return float(values.std(ddof=1))
