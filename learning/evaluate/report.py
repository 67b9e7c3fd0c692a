"""All that an evaluation found, and its files: results.json, table.csv, report.md, and the table for the terminal."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from learning.camera import CaptureModel
from learning.config import EvaluateConfig
from learning.evaluate.figures import (
    PANELS,
    Shown,
    depth_png,
    method_colours,
    montage_png,
    noise_png,
    stacks_png,
    times_png,
)
from learning.evaluate.outcome import Outcome
from learning.evaluate.scoring import Times
from learning.method import aligned
from learning.metrics import DEFINITIONS, SSIM_DEFINITION
from learning.provenance import is_own_folder, read_description, versions
from simulator.dataset.reader import Dataset
from simulator.errors import InputError
from simulator.io.files import storage_errors, write_atomic
from simulator.io.json import readable_json
from simulator.plots.drawing import depth_range

DESCRIPTION = "evaluation.json"
"""Says that the folder is an evaluation's, and its name; written first."""
RESULTS, TABLE, REPORT = "results.json", "table.csv", "report.md"
MONTAGE, NOISE, DEPTH, STACKS, TIMES = "montage.png", "noise.png", "depth.png", "stacks.png", "times.png"
_OWN = (REPORT, TABLE, RESULTS, MONTAGE, NOISE, DEPTH, STACKS, TIMES)
_FORMAT = "flatlight evaluation"
_PACKAGES = ("torch", "numpy", "scikit-image", "flip-evaluator", "lpips", "ortools")
_WHISKERS = "Whiskers are the standard deviation over seeds."


def claim_folder(folder: Path, name: str) -> None:
    """See that a folder is new, empty, or of the evaluation of this name; make it and say whose it is."""
    path = folder / DESCRIPTION
    if is_own_folder(folder, DESCRIPTION, "evaluation"):
        content = read_description(path, "evaluation")
        known = content.get("name")
        if content.get("format") != _FORMAT or not isinstance(known, str):
            raise InputError(path, "not a description of an evaluation; choose another output folder")
        if known != name:
            found = f"{folder} holds the evaluation {known!r}, not {name!r}"
            raise InputError("output", f"{found}; choose another folder, or keep its name")
        return
    with storage_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    write_atomic(path, readable_json({"format": _FORMAT, "name": name}))


@dataclass(frozen=True, eq=False)
class Findings:
    """What came out.

    Attributes:
        camera: what the first method was told.
        stored_db: PSNR of the measurements as stored.
        edges_cm: of the bins of depth.
        perceptual: which perceptual metric was measured, or why none.
        methods: what is known of each method and seed.
        outcomes: of all methods, PSFs and levels.
        naive: of the answers that look at nothing; ``naive_part`` on the scenes of noise levels and of compared PSFs.
        times: seconds per scene; empty where none were taken.
        montage: for each scene shown the truth and every method, in the order of ``columns``.
    """

    config: EvaluateConfig
    test: Dataset
    camera: CaptureModel
    stored_db: float
    edges_cm: tuple[float, ...]
    perceptual: str
    device: str
    methods: Sequence[Mapping[str, Any]]
    outcomes: Sequence[Outcome]
    naive: Sequence[Outcome]
    naive_part: Sequence[Outcome]
    times: Sequence[Times]
    montage: Sequence[Sequence[Shown]]
    columns: Sequence[str]

    @property
    def part(self) -> int:
        """How many scenes the noise levels and the comparison of PSFs have."""
        return min(self.config.ablation_scenes or len(self.test), len(self.test))

    @property
    def main(self) -> list[Outcome]:
        """The rows of the table: every method with its usual PSFs, on the measurements as stored."""
        usual, whole = self.config.data.stack, len(self.test)
        return [one for one in self.outcomes if (one.stack, one.noise_db, one.scenes) == (usual, None, whole)]

    @property
    def ablation(self) -> list[Outcome]:
        """Every method with its usual PSFs at the further levels of noise."""
        return [one for one in self.outcomes if one.stack == self.config.data.stack and one.noise_db is not None]

    @property
    def compared(self) -> list[Outcome]:
        """Every method with each of the PSFs that are compared, on the measurements as stored."""
        stored = [one for one in self.outcomes if one.noise_db is None and one.scenes == self.part]
        return [one for one in stored if one.stack in self.config.data.compare_stacks]

    @property
    def unknown(self) -> list[str]:
        """A line for each method of which nobody knows whether it has seen these scenes."""
        only = (
            "its files are of an earlier version and do not say which scenes it has seen; only data sets were compared"
        )
        return [f"{method['name']}: {only}" for method in self.methods if not method["scenes_on_record"]]

    @property
    def constant_cm(self) -> float | None:
        """Pooled depth RMSE of the best constant depth."""
        return next((one.pooled_depth_rmse_cm for one in self.naive if one.pooled_depth_rmse_cm is not None), None)

    def plain(self) -> dict[str, Any]:
        """Return all of it but the images, for JSON."""
        return {
            "name": self.config.name,
            "config": self.config.dump(),
            "data": {
                "fingerprint": self.test.fingerprint,
                "split": self.test.split,
                "scenes": len(self.test),
                "psf": self.test.info.config["psf"],
                "stored_psnr_db": self.stored_db,
            },
            "white": self.camera.white,
            "depth_range_m": [self.camera.near_m, self.camera.far_m],
            "depth_bins_cm": list(self.edges_cm),
            "perceptual": self.perceptual,
            "definitions": DEFINITIONS,
            "device": self.device,
            "versions": versions(*_PACKAGES),
            "methods": list(self.methods),
            "outcomes": [one.plain() for one in self.outcomes],
            "naive": [one.plain() for one in self.naive],
            "times": [one.plain() for one in self.times],
        }


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
# Of the thesis's table 5.2, and FLIP, which needs no weights.
MAIN = ("psnr", "ssim", "lpips", "flip", "depth_rmse_cm")


def markdown(titles: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of text, its first column at the left, the others at the right."""
    lines = [titles, ["---", *["---:"] * (len(titles) - 1)], *rows]
    return "\n".join("| " + " | ".join(cell.replace("|", r"\|") for cell in line) + " |" for line in lines)


def markdown_table(outcomes: Sequence[Outcome], times: Mapping[str, Times], constant_cm: float | None) -> str:
    """Return the table: mean, spread over scenes, and over seeds in brackets where there are several; best in bold.

    ``times`` are by method; ``constant_cm`` is the pooled depth RMSE of the best constant depth, None without one.
    """
    names = _measured(MAIN, outcomes)
    rows = []
    for one, cells in _with_any(names, outcomes):
        pooled = one.pooled_depth_rmse_cm
        share = "–" if pooled is None or not constant_cm else f"{100 * pooled / constant_cm:.0f} %"
        seconds = [f"{times[one.method].total:.3g}" if one.method in times else "–"] if times else []
        rows.append([_name(one), *cells, share, *seconds])
    return markdown(["method", *_titles(names), "of constant", *(["s per scene ↓"] if times else [])], rows)


def markdown_further(outcomes: Sequence[Outcome]) -> str:
    """Return the scores that are not in the table, and the depth RMSE over all pixels of all scenes together."""
    names = _measured([name for name in SCORES if name not in MAIN], outcomes)
    best, pooled = _best(names, outcomes), "pooled depth RMSE cm ↓"
    return markdown(
        ["method", *_titles(names), pooled],
        ([_name(one), *_cells(one, names, best), _or_dash(one.pooled_depth_rmse_cm, ".2f")] for one in outcomes),
    )


def markdown_matrix(outcomes: Sequence[Outcome], score: str, columns: Sequence[Any], pick: str, unit: str) -> str:
    """Return one score of every method (rows) at several levels or with several stacks (columns).

    ``columns`` are values of the attribute ``pick``, ``noise_db`` or ``stack``; ``unit`` stands behind them in the head.
    """
    shown = [f"{column:g}" if isinstance(column, float) else column for column in columns]
    rows = []
    for method in dict.fromkeys(one.method for one in outcomes):
        found = {getattr(one, pick): one for one in outcomes if one.method == method}
        rows.append([method, *(_cell(found[column], score) if column in found else "–" for column in columns)])
    return markdown([SCORES[score][0], *(f"{column}{unit}" for column in shown)], rows)


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


def csv_table(outcomes: Sequence[Outcome], times: Mapping[str, Times]) -> str:
    """Return all outcomes, one line each, in full precision; a spread that does not exist is empty."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    about = ["method", "kind", "stack", "noise_db", "tuned_db", "scenes"]
    spreads = ("mean", "over_scenes", "over_seeds", "left_out")
    columns = [(name, spread) for name in _measured(SCORES, outcomes) for spread in spreads]
    head = [f"{name}_{spread}" for name, spread in columns]
    writer.writerow([*about, "seeds", *head, "pooled_depth_rmse_cm", "seconds_per_scene"])
    for one in outcomes:
        own = replace(one, noise_db="stored" if one.noise_db is None else one.noise_db)  # pyright: ignore[reportArgumentType]
        numbers = [getattr(one.scores.get(name), spread, None) for name, spread in columns]
        seeds = len(next(iter(one.scores.values())).seeds)
        seconds = times[one.method].total if one.method in times else None
        writer.writerow([*(getattr(own, name) for name in about), seeds, *numbers, one.pooled_depth_rmse_cm, seconds])
    return stream.getvalue()


def terminal_table(outcomes: Sequence[Outcome], times: Mapping[str, Times]) -> str:
    """Return the table in plain columns: mean ± spread over scenes (over seeds)."""
    names = _measured(MAIN, outcomes)
    rows = [["method", *(SCORES[name][0] for name in names), "s per scene"]]
    for one, _ in _with_any(names, outcomes):
        cells = [_cell(one, name).replace("–", "-") for name in names]
        rows.append([one.method, *cells, f"{times[one.method].total:.3g}" if one.method in times else "-"])
    return "\n".join(aligned(rows))


def _measured(names: Iterable[str], outcomes: Sequence[Outcome]) -> list[str]:
    return [name for name in names if any(name in one.scores for one in outcomes)]


def _with_any(names: Sequence[str], outcomes: Sequence[Outcome]) -> list[tuple[Outcome, list[str]]]:
    """Return those that have one of the scores, with their cells: a row of dashes says nothing."""
    best = _best(names, outcomes)
    return [(one, _cells(one, names, best)) for one in outcomes if any(name in one.scores for name in names)]


def _titles(names: Sequence[str]) -> list[str]:
    return [f"{SCORES[name][0]} {'↑' if SCORES[name][2] else '↓'}" for name in names]


def _name(one: Outcome) -> str:
    return f"*{one.method}*" if one.kind == "naive" else one.method


def _best(names: Sequence[str], outcomes: Sequence[Outcome]) -> dict[str, float]:
    """Return the best mean of each score."""
    means = {name: [one.scores[name].mean for one in outcomes if name in one.scores] for name in names}
    return {name: (max if SCORES[name][2] else min)(values) for name, values in means.items()}


def _cells(one: Outcome, names: Sequence[str], best: Mapping[str, float]) -> list[str]:
    bold = {name for name in names if name in one.scores and one.scores[name].mean == best[name]}
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


PUBLISHED = """## Published, on other data

| thesis, table 5.2 | PSNR dB ↑ | SSIM ↑ | LPIPS ↓ | depth RMSE cm ↓ | s per scene ↓ |
| --- | ---: | ---: | ---: | ---: | ---: |
| CLS + graph cut | 16.24 | 0.56 | 0.51 | 4.87 | 1.21 |
| ADMM + graph cut | 15.94 | 0.63 | 0.32 | 5.26 | 10.26 |
| FlatNet2D | 19.86 | 0.65 | 0.30 | 1.92 | 0.011 |
| FlatNet3D | 21.91 | 0.79 | 0.14 | 1.42 | 0.013 |

These are of the thesis's own scenes, camera and computer, and cannot be compared with the above number by number. The best
constant has 4.73 cm on depths that are uniform in the thesis's range, 3.6 to 20 cm."""


def conditions(findings: Findings) -> str:
    """Return on which scenes the methods were judged, and what they were told of the camera."""
    psf = findings.test.info.config["psf"]
    count = len(psf["depths_cm"]) if psf.get("depths_cm") else psf.get("depths")
    planes = f", PSFs {psf['model']} at {count} depths" if psf.get("model") and count else ""
    stack = findings.config.data.stack
    assumed = "their own PSFs" if stack == "own" else f"the PSFs {stack}"
    ranges: dict[str, list[str]] = {}
    for method in findings.methods:
        near_cm, far_cm = (100 * depth_m for depth_m in method["depth_range_m"])
        text = f"{method['planes']} planes, depths from {near_cm:.3g} to {far_cm:.3g} cm"
        ranges.setdefault(text, []).append(method["name"])
    told = "; ".join(text if len(ranges) == 1 else f"{', '.join(names)}: {text}" for text, names in ranges.items())
    return (
        f"{len(findings.test)} scenes, split {findings.test.split} of a data set with fingerprint "
        f"`{findings.test.fingerprint[:12]}`{planes}; measurements as stored have {findings.stored_db:.1f} dB. The methods "
        f"assume {assumed}: {told}."
    )


def how(findings: Findings) -> str:
    """Return how the table is to be read."""
    seeds = [len(next(iter(one.scores.values())).seeds) for one in findings.main if one.kind == "learned"]
    brackets = f", in brackets over {max(seeds)} seeds" if seeds and max(seeds) > 1 else ""
    depth = "Every method's depths are clamped to its range, and count where there is a surface."
    return (
        f"Mean ± standard deviation over scenes{brackets}; the best of each column is bold; answers in italics look at no "
        f"measurement. {depth} Pooled: over all pixels of all scenes; beside it as a share of the best constant depth's. "
        f"SSIM: {SSIM_DEFINITION}. {findings.perceptual[0].upper()}{findings.perceptual[1:]}."
    )


def left_out(outcomes: Sequence[Outcome]) -> str:
    """Return which scores do not have all scenes, because a scene has none; empty where all have all."""
    found: dict[tuple[str, int, int], list[str]] = {}
    for one in outcomes:
        for name, summary in one.scores.items():
            if summary.left_out:
                found.setdefault((SCORES[name][0], summary.left_out, one.scenes), []).append(one.method)
    return "\n".join(
        f"- {score}: {count} of {scenes} scenes have none and are left out ({', '.join(methods)})"
        for (score, count, scenes), methods in found.items()
    )


def write_results(folder: Path, findings: Findings) -> list[Path]:
    """Write everything, and delete what an earlier run left; returns the files, the report first."""
    times = {one.method: one for one in findings.times}
    table = csv_table([*findings.outcomes, *findings.naive], times)
    files = {REPORT: _report(findings, times).encode(), TABLE: table.encode(), RESULTS: readable_json(findings.plain())}
    files |= _figures(findings)
    for name, content in files.items():
        write_atomic(folder / name, content)
    remove_stale(folder, files)
    return [folder / name for name in files]


def remove_stale(folder: Path, written: Iterable[str]) -> None:
    """Delete the files of an earlier run that this one did not write: they show other scenes or settings."""
    for name in set(_OWN) - set(written):
        with storage_errors(folder / name):
            (folder / name).unlink(missing_ok=True)


def _figures(findings: Findings) -> dict[str, bytes]:
    colours = method_colours([method.name for method in findings.config.methods])
    part, stacks = findings.naive_part, findings.config.data.compare_stacks
    figures = {DEPTH: depth_png(findings.main, colours, findings.naive, findings.edges_cm)}
    if findings.montage:
        camera = findings.camera
        line = f"white = radiance {camera.white:.3g}; depth z {depth_range(camera.near_m, camera.far_m)}"
        depths_m = (camera.near_m, camera.far_m)
        figures[MONTAGE] = montage_png(findings.columns, findings.montage, findings.config.name, line, *depths_m)
    if findings.ablation:
        figures[NOISE] = noise_png(findings.ablation, colours, part)
    if findings.compared:
        figures[STACKS] = stacks_png(findings.compared, colours, stacks, part)
    if findings.times:
        figures[TIMES] = times_png(findings.times, colours, findings.device)
    return figures


def _report(findings: Findings, times: Mapping[str, Times]) -> str:
    rows = [*findings.main, *findings.naive]
    ablation, compared, whole = findings.ablation, findings.compared, len(findings.test)
    on_part = f"Of {'all' if findings.part == whole else 'the first'} {findings.part} of {whole} scenes."
    parts = [
        f"# {findings.config.name}",
        conditions(findings),
        markdown_table(rows, times, findings.constant_cm),
        how(findings),
        "\n".join(
            [*(f"- {one.method}: {one.note}" for one in rows if one.note), *(f"- {n}" for n in findings.unknown)]
        ),
        left_out(rows),
        "## Further scores",
        markdown_further(rows),
        "## Scenes\n\n![truth and estimates](montage.png)" if findings.montage else "",
    ]
    if ablation:
        levels = sorted({one.noise_db for one in ablation if one.noise_db is not None})
        notes = [f"- {one.method} at {one.noise_db:g} dB: {one.note}" for one in ablation if one.kind == "classical"]
        tables = [markdown_matrix(ablation, score, levels, "noise_db", " dB") for score, _ in PANELS]
        parts += ["## Noise", on_part, *tables, "\n".join(notes), _WHISKERS, "![scores against noise](noise.png)"]
    parts += ["## Depth error against depth", markdown_bins(rows, findings.edges_cm), "![depth error](depth.png)"]
    if compared:
        stacks = findings.config.data.compare_stacks
        tables = [markdown_matrix(compared, score, stacks, "stack", " PSFs") for score, _ in PANELS]
        parts += ["## Which PSFs are assumed", on_part, *tables, _WHISKERS, "![scores by PSFs](stacks.png)"]
    if findings.times:
        words = (
            f"{findings.device}; one scene at a time, the methods by turns, median of {findings.config.time.repeats} after "
            "one that does not count. The seconds of learned methods are those of their first seed."
        )
        parts += ["## Time", words, markdown_times(findings.times), "![seconds per stage](times.png)"]
    parts += [
        PUBLISHED,
        "## Made with",
        ", ".join(f"{name} {version}" for name, version in versions(*_PACKAGES).items()),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"
