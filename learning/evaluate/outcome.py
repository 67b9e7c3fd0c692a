"""What came out for one method, with one set of PSFs, at one level of noise: all seeds together."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

SCORES: dict[str, tuple[str, int, bool | None]] = {
    "psnr": ("PSNR dB", 2, True),
    "moving_psnr": ("moving PSNR dB", 2, True),
    "ssim": ("SSIM", 3, True),
    "lpips": ("LPIPS", 3, False),
    "flip": ("FLIP", 3, False),
    "cvvdp": ("ColorVideoVDP JOD", 2, True),
    "warping_error": ("warping error", 3, None),
    "true_warping_error": ("the truth's", 3, None),
    "linear_psnr": ("linear PSNR dB", 2, True),
    "depth_rmse_cm": ("depth RMSE cm", 2, False),
    "disparity_rmse": ("disparity RMSE", 3, False),
    "disparity_rmse_per_m": ("1/z RMSE 1/m", 2, False),
    "lit_depth_rmse_cm": ("lit depth RMSE cm", 2, False),
}
"""Title, digits and whether more is better (None: neither); in this order, as far as they were measured."""


@dataclass(frozen=True)
class Summary:
    """One score of one method: its mean over all scenes and seeds, and standard deviations (n - 1).

    ``over_scenes`` is that of the seeds' mean, None for one scene or without finite values; ``over_seeds`` that of the
    scenes' mean, None for one seed; ``seeds`` are the scenes' means, ``left_out`` counts the scenes that have no such score.
    """

    mean: float
    over_scenes: float | None
    over_seeds: float | None
    seeds: tuple[float, ...]
    left_out: int = 0


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
    """Return the root mean square error of each bin from sums of squares and numbers of pixels, both ``(..., bins)``.

    Example:
        >>> pooled_rms([[4.0, 0.0], [14.0, 0.0]], [[1, 0], [1, 0]])
        (3.0, None)
    """
    bins = np.shape(counts)[-1]
    total, pixels = (np.asarray(each, np.float64).reshape(-1, bins).sum(axis=0) for each in (squares, counts))
    return tuple(math.sqrt(s / n) if n else None for s, n in zip(total.tolist(), pixels.tolist(), strict=True))


def _spread(values: np.ndarray) -> float | None:
    if len(values) < 2 or not np.all(np.isfinite(values)):
        return None
    return float(values.std(ddof=1))


Kind = Literal["learned", "classical", "naive", "oracle"]
OWN = "own"


@dataclass(frozen=True)
class Outcome:
    """One line of the table: a method with all of its seeds, or with one of them.

    Attributes:
        method: its name.
        kind: learned, classical, or an answer that looks at no measurement: naive, or an oracle, which knows the truth.
        stack: how the PSFs that it assumed are named in the file; ``own`` for those that it always has.
        noise_db: level at which noise was drawn anew; None for measurements as stored.
        scores: mean and spreads by score, see `learning.metrics.measure`.
        pooled_depth_rmse_cm: over all pixels of all scenes and seeds, whatever the bins hold of them.
        bins_cm: depth RMSE by bin of true depth, over all of its pixels; None where a bin is empty.
        over_time: of clips, some of the scores of each frame: means over all scenes and seeds.
        note: what else decides it, such as tuned parameters.
        scenes: how many were used.
        tuned_db: level at which its parameters were tuned; None where none were.
        details: more for results.json.
        values: by score, what `scores` sums up: ``(seeds, scenes)``, NaN where a scene has none.
        seed: which of the method's seeds it is alone, counted from 1 as they stand in the file; None for all together.
        singly: the same of each seed alone, where there are several: the mean of three hides a bad one.
    """

    method: str
    kind: Kind
    stack: str
    noise_db: float | None
    scores: Mapping[str, Summary]
    pooled_depth_rmse_cm: float | None
    bins_cm: tuple[float | None, ...]
    over_time: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    note: str = ""
    scenes: int = 0
    tuned_db: float | None = None
    details: Mapping[str, Any] = field(default_factory=dict)
    values: Mapping[str, NDArray[np.float64]] = field(default_factory=dict, repr=False, compare=False)
    seed: int | None = None
    singly: tuple[Outcome, ...] = ()

    @property
    def label(self) -> str:
        """The method's name, with the seed where it is one alone."""
        return self.method if self.seed is None else f"{self.method}, seed {self.seed}"

    @property
    def tuned_elsewhere(self) -> bool:
        """Whether its parameters were tuned at another level of noise than its own."""
        return None not in (self.tuned_db, self.noise_db) and self.tuned_db != self.noise_db

    def plain(self) -> dict[str, Any]:
        """Return the same for JSON."""
        left_out = ("scores", "bins_cm", "details", "values", "singly")
        content = {each.name: getattr(self, each.name) for each in fields(self) if each.name not in left_out}
        content |= {"scores": {name: asdict(summary) for name, summary in self.scores.items()}, **self.details}
        return content | {"depth_rmse_cm_by_bin": self.bins_cm, "singly": [one.plain() for one in self.singly]}


def outcome(
    method: str,
    kind: Kind,
    seeds: Sequence[Mapping[str, Any]],
    *,
    stack: str = OWN,
    noise_db: float | None = None,
    note: str = "",
    tuned_db: float | None = None,
    details: Mapping[str, Any] | None = None,
    only: Sequence[str] | None = None,
) -> Outcome:
    """Return the outcome of what `learning.evaluate.scoring.score` found for each seed, on the same scenes.

    ``only`` names the scores that mean anything, None keeps all; the rest see `Outcome`.
    """
    names = [name for name in seeds[0]["scores"][0] if only is None or name in only]
    tables = {name: np.array([[scene[name] for scene in seed["scores"]] for seed in seeds]) for name in names}
    tables = {name: table for name, table in tables.items() if not np.isnan(table).any(axis=0).all()}
    pooled, bins = None, ()
    if "depth_rmse_cm" in tables:
        bins = pooled_rms(*([seed[name] for seed in seeds] for name in ("squares_cm2", "counts")))
        pixels = np.array([seed["pixels"] for seed in seeds])
        squares = np.where(pixels > 0, pixels * tables["depth_rmse_cm"] ** 2, 0)
        (pooled,) = pooled_rms(squares[..., None], pixels[..., None])
    about: Any = {"stack": stack, "noise_db": noise_db, "note": note, "tuned_db": tuned_db}
    together = Outcome(
        method,
        kind,
        scores={name: summarise(table) for name, table in tables.items()},
        pooled_depth_rmse_cm=pooled,
        bins_cm=bins,
        over_time=_over_time([clip for seed in seeds for clip in seed["over_time"]], tables),
        scenes=len(seeds[0]["scores"]),
        details=dict(details or {}),
        values=tables,
        **about,
    )
    if len(seeds) == 1:
        return together
    alone = (outcome(method, kind, [one], only=only, **about) for one in seeds)
    return replace(together, singly=tuple(replace(one, seed=number) for number, one in enumerate(alone, start=1)))


def _over_time(clips: Sequence[Mapping[str, Sequence[float]]], wanted: Collection[str]) -> dict[str, tuple[float, ...]]:
    """Return the means of each frame's scores over clips, leaving out clips whose frame has none."""
    names = [name for name in (clips[0] if clips else ()) if name in wanted]
    return {name: tuple(np.nanmean([clip[name] for clip in clips], axis=0).tolist()) for name in names}


def first_scenes(result: Mapping[str, Any], scenes: int) -> dict[str, Any]:
    """Return what `learning.evaluate.scoring.score` found, of the first so many scenes only."""
    return chosen_scenes(result, range(scenes))


def chosen_scenes(result: Mapping[str, Any], positions: Sequence[int]) -> dict[str, Any]:
    """Return what `learning.evaluate.scoring.score` found, of some scenes only."""
    return {name: [values[at] for at in positions] if values else [] for name, values in result.items()}
