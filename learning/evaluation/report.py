"""The table in three forms: Markdown for people, CSV for programs, plain lines for the terminal."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from typing import Any

from learning.evaluation.outcome import Outcome
from learning.evaluation.summary import Summary
from learning.evaluation.timing import Times

# Title, digits and whether more is better; in this order, as far as they were measured.
SCORES: dict[str, tuple[str, int, bool]] = {
    "psnr": ("PSNR dB", 2, True),
    "ssim": ("SSIM", 3, True),
    "lpips": ("LPIPS", 3, False),
    "flip": ("FLIP", 3, False),
    "linear_psnr": ("linear PSNR dB", 2, True),
    "depth_rmse_cm": ("depth RMSE cm", 2, False),
    "disparity_rmse": ("disparity RMSE", 3, False),
    "disparity_rmse_per_m": ("1/z RMSE 1/m", 2, False),
    "lit_depth_rmse_cm": ("lit depth RMSE cm", 2, False),
}


MAIN = ("psnr", "ssim", "lpips", "flip", "depth_rmse_cm")
"""The scores of the thesis's table 5.2, and FLIP, which needs no weights."""


def markdown_table(outcomes: Sequence[Outcome], times: Mapping[str, Times], constant_cm: float | None) -> str:
    """Return the table: mean, spread over scenes, and over seeds in brackets where there are several; best in bold.

    Args:
        outcomes: its rows.
        times: by method.
        constant_cm: pooled depth RMSE of the best constant depth; None where there is none.
    """
    names = _measured(MAIN, outcomes)
    head = [*_titles(names), "of constant", *(["s per scene ↓"] if times else [])]
    best = _best(names, outcomes)
    lines = _head(["method", *head])
    for one in _with_any(names, outcomes):
        pooled = one.pooled_depth_rmse_cm
        share = "–" if pooled is None or not constant_cm else f"{100 * pooled / constant_cm:.0f} %"
        cells = [_name(one), *_cells(one, names, best), share]
        if times:
            cells.append(f"{times[one.method].total:.3g}" if one.method in times else "–")
        lines.append(_line(cells))
    return "\n".join(lines)


def markdown_further(outcomes: Sequence[Outcome]) -> str:
    """Return the scores that are not in the table, and the depth RMSE over all pixels of all scenes together."""
    names = _measured([name for name in SCORES if name not in MAIN], outcomes)
    best = _best(names, outcomes)
    lines = _head(["method", *_titles(names), "pooled depth RMSE cm ↓"])
    for one in outcomes:
        pooled = "–" if one.pooled_depth_rmse_cm is None else f"{one.pooled_depth_rmse_cm:.2f}"
        lines.append(_line([_name(one), *_cells(one, names, best), pooled]))
    return "\n".join(lines)


def markdown_matrix(outcomes: Sequence[Outcome], score: str, columns: Sequence[Any], pick: str, unit: str) -> str:
    """Return one score of every method (rows) at several levels or with several stacks (columns).

    Args:
        outcomes: of all of them.
        score: its name.
        columns: values of the attribute ``pick``.
        pick: ``noise_db`` or ``stack``.
        unit: behind the numbers of the head.
    """
    digits = SCORES[score][1]
    shown = [f"{column:g}" if isinstance(column, float) else column for column in columns]
    lines = _head([SCORES[score][0], *(f"{column}{unit}" for column in shown)])
    for method in dict.fromkeys(one.method for one in outcomes):
        found = {getattr(one, pick): one for one in outcomes if one.method == method and score in one.scores}
        cells = [_cell(found[column].scores[score], digits) if column in found else "–" for column in columns]
        lines.append(_line([method, *cells]))
    return "\n".join(lines)


def markdown_times(times: Sequence[Times]) -> str:
    """Return seconds per stage, and how many times slower each method is than the fastest one."""
    stages = list(dict.fromkeys(stage for one in times for stage in one.stages))
    least = min(one.total for one in times)
    lines = _head(["method", *(f"{stage} s" for stage in stages), "all s", "times the fastest"])
    for one in times:
        cells = [f"{one.stages[stage]:.3g}" if stage in one.stages else "–" for stage in stages]
        lines.append(_line([one.method, *cells, f"{one.total:.3g}", f"{one.total / least:.3g}"]))
    return "\n".join(lines)


def markdown_bins(outcomes: Sequence[Outcome], edges_cm: Sequence[float]) -> str:
    """Return the depth RMSE in cm by bin of true depth."""
    names = [f"{a:.3g}–{b:.3g} cm" for a, b in pairwise(edges_cm)]
    lines = _head(["depth RMSE cm", *names])
    for one in outcomes:
        if one.bins_cm:
            lines.append(_line([one.method, *("–" if value is None else f"{value:.2f}" for value in one.bins_cm)]))
    return "\n".join(lines)


def csv_table(outcomes: Sequence[Outcome], times: Mapping[str, Times]) -> str:
    """Return all outcomes, one line each, in full precision; a spread that does not exist is empty."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    names = _measured(SCORES, outcomes)
    spreads = ("mean", "over_scenes", "over_seeds", "left_out")
    head = [f"{name}_{spread}" for name in names for spread in spreads]
    writer.writerow(
        [
            "method",
            "kind",
            "stack",
            "noise_db",
            "tuned_db",
            "scenes",
            "seeds",
            *head,
            "pooled_depth_rmse_cm",
            "seconds_per_scene",
        ]
    )
    for one in outcomes:
        numbers = [
            getattr(one.scores[name], spread) if name in one.scores else None for name in names for spread in spreads
        ]
        seeds = len(next(iter(one.scores.values())).seeds)
        seconds = times[one.method].total if one.method in times else None
        level = "stored" if one.noise_db is None else one.noise_db
        about = [one.method, one.kind, one.stack, level, one.tuned_db, one.scenes, seeds]
        writer.writerow([*about, *numbers, one.pooled_depth_rmse_cm, seconds])
    return stream.getvalue()


def terminal_table(outcomes: Sequence[Outcome], times: Mapping[str, Times]) -> str:
    """Return the table in plain columns: mean ± spread over scenes (over seeds)."""
    names = _measured(MAIN, outcomes)
    rows = [["method", *(SCORES[name][0] for name in names), "s per scene"]]
    for one in _with_any(names, outcomes):
        cells = [_cell(one.scores[name], SCORES[name][1]) if name in one.scores else "-" for name in names]
        rows.append([one.method, *cells, f"{times[one.method].total:.3g}" if one.method in times else "-"])
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return "\n".join(
        "  ".join([row[0].ljust(widths[0]), *(text.rjust(n) for text, n in zip(row[1:], widths[1:], strict=True))])
        for row in rows
    )


def _measured(names: Iterable[str], outcomes: Sequence[Outcome]) -> list[str]:
    return [name for name in names if any(name in one.scores for one in outcomes)]


def _with_any(names: Sequence[str], outcomes: Sequence[Outcome]) -> list[Outcome]:
    """Return those that have one of the scores: a row of dashes says nothing."""
    return [one for one in outcomes if any(name in one.scores for name in names)]


def _titles(names: Sequence[str]) -> list[str]:
    return [f"{SCORES[name][0]} {'↑' if SCORES[name][2] else '↓'}" for name in names]


def _name(one: Outcome) -> str:
    return f"*{one.method}*" if one.kind == "trivial" else one.method


def _best(names: Sequence[str], outcomes: Sequence[Outcome]) -> dict[str, float]:
    """Return the best mean of each score."""
    return {
        name: (max if SCORES[name][2] else min)(one.scores[name].mean for one in outcomes if name in one.scores)
        for name in names
    }


def _cells(one: Outcome, names: Sequence[str], best: Mapping[str, float]) -> list[str]:
    cells = []
    for name in names:
        text = _cell(one.scores[name], SCORES[name][1]) if name in one.scores else "–"
        cells.append(f"**{text}**" if name in one.scores and one.scores[name].mean == best[name] else text)
    return cells


def _cell(summary: Summary, digits: int) -> str:
    text = f"{summary.mean:.{digits}f}"
    if summary.over_scenes is not None:
        text += f" ± {summary.over_scenes:.{digits}f}"
    if summary.over_seeds is not None:
        text += f" ({summary.over_seeds:.{digits}f})"
    return text


def _head(titles: Sequence[str]) -> list[str]:
    return [_line(titles), _line(["---", *["---:"] * (len(titles) - 1)])]


def _line(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cell.replace("|", r"\|") for cell in cells) + " |"
