"""The tables of an evaluation: Markdown for the report, CSV for programs, plain columns for the terminal."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

from learning.evaluate.outcome import SCORES, Outcome
from learning.evaluate.paired import COMPARED, Difference
from learning.evaluate.scoring import Times
from learning.method import aligned

# Of the thesis's table 5.2, FLIP, which needs no weights, and what there is of clips
MAIN = ("psnr", "moving_psnr", "ssim", "lpips", "flip", "cvvdp", "depth_rmse_cm")
_VERDICTS = {"reference": "▲", "other": "▼", None: "○"}
_ARROWS = {True: " ↑", False: " ↓", None: ""}
_PLAIN = str.maketrans("▲▼○–−", "+-.--")  # for terminals
TUNED_ELSEWHERE = "†"
"""Behind what was found with parameters of another level of noise."""


def markdown(titles: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of text, its first column at the left, the others at the right."""
    lines = [titles, ["---", *["---:"] * (len(titles) - 1)], *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", r"\|") for cell in line) + " |" for line in lines)


def constant_cm(outcomes: Iterable[Outcome]) -> float | None:
    """Return the pooled depth RMSE of the best constant depth, None where it is not among outcomes."""
    pooled = (one.pooled_depth_rmse_cm for one in outcomes if one.kind == "naive")
    return next((each for each in pooled if each is not None), None)


def markdown_table(outcomes: Sequence[Outcome], times: Mapping[str, Times]) -> str:
    """Return the table: mean, spread over scenes, and over seeds in brackets where there are several; best in bold.

    Below a method stands each of its seeds. ``times`` are by method.
    """
    names, whole_cm = _measured(MAIN, outcomes), constant_cm(outcomes)
    rows = []
    for one, cells in _with_any(names, outcomes):
        seconds = [f"{times[one.method].total:.3g}" if one.method in times and not one.seed else "–"] if times else []
        share = [_share(one, whole_cm) or "–"] if whole_cm else []
        rows.append([_name(one), *cells, *share, *seconds])
    head = ["method", *_titles(names), *(["of constant"] if whole_cm else [])]
    return markdown([*head, *(["s per scene ↓"] if times else [])], rows)


def markdown_further(outcomes: Sequence[Outcome]) -> str:
    """Return the scores that are not in the table, and the depth RMSE over all pixels of all scenes together."""
    names = _measured([name for name in SCORES if name not in MAIN], outcomes)
    best, every = _best(names, outcomes), list(_with_seeds(outcomes))
    pooled = ["pooled depth RMSE cm ↓"] if any(one.pooled_depth_rmse_cm is not None for one in every) else []
    return markdown(
        ["method", *_titles(names), *pooled],
        (
            [_name(one), *_cells(one, names, best), *(_or_dash(one.pooled_depth_rmse_cm, ".2f") for _ in pooled)]
            for one in every
        ),
    )


def markdown_matrix(score: str, columns: Mapping[str, Sequence[Outcome]]) -> str:
    """Return one score of every method and seed (rows) in several cases, such as levels of noise (columns, by title).

    The last row is the best naive baseline; depths have their share of the best constant's.
    """
    names: dict[str, str] = {}
    cells: dict[tuple[str, str], str] = {}
    for title, outcomes in columns.items():
        scored = [one for one in outcomes if score in one.scores]
        naive = sorted((one for one in scored if one.kind == "naive"), key=lambda one: _rank(one, score))[:1]
        judged = [*(one for one in scored if one.kind != "naive"), *naive]
        best, whole_cm = _best([score], judged), constant_cm(naive)
        for one in _with_seeds(judged):
            row = (
                one.label.partition(" (")[0] if one.kind == "naive" else one.label
            )  # its depth may be that of the column
            names[row] = f"*{row}*" if one.kind == "naive" else _name(one)
            share = _share(one, whole_cm) if score == "depth_rmse_cm" else ""
            words = [*_cells(one, [score], best), *([f"· {share}"] if share else [])]
            cells[row, title] = " ".join([*words, *([TUNED_ELSEWHERE] if one.tuned_elsewhere else [])])
    rows = ([name, *(cells.get((row, title), "–") for title in columns)] for row, name in names.items())
    return markdown([*_titles([score]), *columns], rows)


def markdown_differences(score: str, columns: Mapping[str, Sequence[Difference]]) -> str:
    """Return the paired differences of one score (rows) in several cases (columns), with their intervals and verdicts."""
    number = f"+.{SCORES[score][1]}f"

    def cell(found: list[Difference]) -> str:
        if not found:
            return "–"
        (one,) = found
        interval = "" if one.interval is None else f" [{one.interval[0]:{number}}, {one.interval[1]:{number}}]"
        return f"{one.mean:{number}}{interval} {_VERDICTS[one.favours]}"

    of_it = {title: [one for one in found if one.score == score] for title, found in columns.items()}
    return markdown(*_by_pair(_titles([score])[0], of_it, cell))


def markdown_verdicts(columns: Mapping[str, Sequence[Difference]]) -> str:
    """Return for every pair and case one sign for each of the scores that are compared."""
    return markdown(*_verdicts(columns))


def markdown_times(times: Sequence[Times]) -> str:
    """Return seconds per stage, and how many times slower each method is than the fastest one."""
    stages = list(dict.fromkeys(stage for one in times for stage in one.stages))
    least = min(one.total for one in times)
    rows = []
    for one in times:
        cells = [_or_dash(one.stages.get(stage), ".3g") for stage in stages]
        rows.append([one.method, *cells, f"{one.total:.3g}", f"{one.total / least:.3g}"])
    return markdown(["method", *(f"{stage} s" for stage in stages), "all s", "times the fastest"], rows)


def markdown_bins(outcomes: Sequence[Outcome], edges_cm: Sequence[float]) -> str:
    """Return the depth RMSE in cm by bin of true depth."""
    names = [f"{a:.3g}–{b:.3g} cm" for a, b in pairwise(edges_cm)]
    rows = ([one.method, *(_or_dash(value, ".2f") for value in one.bins_cm)] for one in outcomes if one.bins_cm)
    return markdown(["depth RMSE cm", *names], rows)


def csv_table(sets: Mapping[str, tuple[Sequence[Outcome], Mapping[str, Times]]]) -> str:
    """Return the outcomes of all data sets, with the times by method, one line each, in full precision.

    A spread that does not exist is empty; lines with a number in ``seed`` are of that seed alone.
    """
    about = ["method", "kind", "seed", "stack", "noise_db", "tuned_db", "scenes"]
    spreads = ("mean", "over_scenes", "over_seeds", "left_out")
    measured = _measured(SCORES, [one for outcomes, _ in sets.values() for one in outcomes])
    columns = [(name, spread) for name in measured for spread in spreads]
    head = [f"{name}_{spread}" for name, spread in columns]
    lines: list[list[Any]] = [["set", *about, "seeds", *head, "pooled_depth_rmse_cm", "seconds_per_scene"]]
    for name, (outcomes, times) in sets.items():
        for one in _with_seeds(outcomes):
            own = [_stored(one.noise_db) if key == "noise_db" else getattr(one, key) for key in about]
            numbers = [getattr(one.scores.get(score), spread, None) for score, spread in columns]
            seeds = len(next(iter(one.scores.values())).seeds)
            seconds = times[one.method].total if one.method in times else None
            lines.append([name, *own, seeds, *numbers, one.pooled_depth_rmse_cm, seconds])
    return _csv(lines)


def csv_differences(sets: Mapping[str, Iterable[Difference]]) -> str:
    """Return all paired differences by data set, one line each, in full precision."""
    head = ["set", "reference", "other", "noise_db", "score", "scenes", "mean", "low", "high", "favours"]
    lines: list[list[Any]] = [head]
    for name, differences in sets.items():
        for one in differences:
            about = [name, one.reference, one.other, _stored(one.noise_db), one.score, one.scenes]
            lines.append([*about, one.mean, *(one.interval or (None, None)), one.favours])
    return _csv(lines)


def _stored(noise_db: float | None) -> float | str:
    return "stored" if noise_db is None else noise_db


def terminal_table(outcomes: Sequence[Outcome], times: Mapping[str, Times]) -> str:
    """Return the table in plain columns: mean ± spread over scenes (over seeds)."""
    names = _measured(MAIN, outcomes)
    rows = [["method", *(SCORES[name][0] for name in names), "s per scene"]]
    for one, _ in _with_any(names, outcomes):
        seconds = f"{times[one.method].total:.3g}" if one.method in times and not one.seed else "-"
        name = f"  seed {one.seed}" if one.seed else one.method
        rows.append([name, *(_cell(one, score).translate(_PLAIN) for score in names), seconds])
    return "\n".join(aligned(rows))


def terminal_verdicts(columns: Mapping[str, Sequence[Difference]]) -> str:
    """Return `markdown_verdicts` in plain columns."""
    titles, rows = _verdicts(columns)
    return "\n".join(aligned([[cell.translate(_PLAIN) for cell in row] for row in [titles, *rows]]))


def _verdicts(columns: Mapping[str, Sequence[Difference]]) -> tuple[list[str], list[list[str]]]:
    measured = [score for score in COMPARED if any(one.score == score for found in columns.values() for one in found)]
    head = ", ".join(SCORES[score][0].rpartition(" ")[0] or SCORES[score][0] for score in measured)
    return _by_pair(head, columns, lambda found: "".join(_VERDICTS[one.favours] for one in found) or "–")


def _by_pair(
    head: str, columns: Mapping[str, Sequence[Difference]], cell: Callable[[list[Difference]], str]
) -> tuple[list[str], list[list[str]]]:
    """Return titles and rows of a table with a row for each pair of methods or seeds."""
    pairs = dict.fromkeys((one.reference, one.other) for found in columns.values() for one in found)
    rows = []
    for pair in pairs:
        of_it = [[one for one in found if (one.reference, one.other) == pair] for found in columns.values()]
        rows.append([" − ".join(pair), *map(cell, of_it)])
    return [head, *columns], rows


def _csv(lines: Iterable[Iterable[Any]]) -> str:
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(lines)
    return stream.getvalue()


def _with_seeds(outcomes: Iterable[Outcome]) -> Iterator[Outcome]:
    """Yield each outcome, and behind it those of its seeds."""
    for one in outcomes:
        yield from (one, *one.singly)


def _measured(names: Iterable[str], outcomes: Sequence[Outcome]) -> list[str]:
    return [name for name in names if any(name in one.scores for one in outcomes)]


def _with_any(names: Sequence[str], outcomes: Sequence[Outcome]) -> list[tuple[Outcome, list[str]]]:
    """Return those that have one of the scores, with their cells: a row of dashes says nothing."""
    best, some = _best(names, outcomes), [one for one in outcomes if any(name in one.scores for name in names)]
    return [(one, _cells(one, names, best)) for one in _with_seeds(some)]


def _titles(names: Sequence[str]) -> list[str]:
    return [SCORES[name][0] + _ARROWS[SCORES[name][2]] for name in names]


def _name(one: Outcome) -> str:
    if one.seed is not None:
        return f"↳ seed {one.seed}"
    return f"*{one.method}*" if one.kind in ("naive", "oracle") else one.method


def _share(one: Outcome, whole_cm: float | None) -> str:
    """Return the pooled depth RMSE as a share of the best constant's; empty without one of them."""
    pooled = one.pooled_depth_rmse_cm
    return "" if pooled is None or not whole_cm else f"{100 * pooled / whole_cm:.0f} %"


def _rank(one: Outcome, score: str) -> float:
    """Return a number that is smaller for a better mean."""
    mean = one.scores[score].mean
    return -mean if SCORES[score][2] else mean


def _best(names: Sequence[str], outcomes: Sequence[Outcome]) -> dict[str, float]:
    """Return the best mean of each score of which there is one; an oracle is no rival."""
    ranked = [name for name in names if SCORES[name][2] is not None]
    rivals = [one for one in outcomes if one.kind != "oracle"]
    means = {name: [one.scores[name].mean for one in rivals if name in one.scores] for name in ranked}
    return {name: (max if SCORES[name][2] else min)(values) for name, values in means.items() if values}


def _cells(one: Outcome, names: Sequence[str], best: Mapping[str, float]) -> list[str]:
    known = {name for name in best if name in one.scores and not one.seed}
    bold = {name for name in known if one.scores[name].mean == best[name]}
    return [f"**{_cell(one, name)}**" if name in bold else _cell(one, name) for name in names]


def _cell(one: Outcome, name: str) -> str:
    if name not in one.scores:
        return "–"
    summary, digits = one.scores[name], SCORES[name][1]
    text = f"{summary.mean:.{digits}f}"
    if summary.over_scenes is not None:
        text += f" ± {summary.over_scenes:.{digits}f}"
    return text if summary.over_seeds is None else f"{text} ({summary.over_seeds:.{digits}f})"


def _or_dash(value: float | None, digits: str) -> str:
    return "–" if value is None else format(value, digits)
