"""All that an evaluation found, and its files: results.json, table.csv, report.md, and the table for the terminal."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

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
from learning.evaluate.outcome import Outcome, Summary
from learning.evaluate.scoring import Times
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
    """See that a folder is new, empty, or of the evaluation of this name; make it and say whose it is.

    Raises:
        InputError: a file, a data set, a training, anything else, or an evaluation of another name.
        StorageError: the folder cannot be written to.
    """
    path = folder / DESCRIPTION
    if is_own_folder(folder, DESCRIPTION, "evaluation"):
        content = read_description(path, "evaluation")
        known = content.get("name")
        if content.get("format") != _FORMAT or not isinstance(known, str):
            msg = f"{path} is not a description of an evaluation; choose another output folder"
            raise InputError(msg)
        if known != name:
            msg = f"output: {folder} holds the evaluation {known!r}, not {name!r}; choose another folder, or keep its name"
            raise InputError(msg)
        return
    with storage_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    write_atomic(path, readable_json({"format": _FORMAT, "name": name}))


@dataclass(frozen=True, eq=False)
class Findings:
    """What came out.

    Attributes:
        config: the file.
        test: the split that decided.
        camera: what the first method was told of the camera.
        stored_db: PSNR of the measurements as stored.
        edges_cm: of the bins of depth.
        perceptual: which perceptual metric was measured, or why none.
        device: in words.
        methods: what is known of each method and seed.
        outcomes: of all methods, PSFs and levels.
        naive: of the answers that look at nothing.
        naive_part: of the same answers, on the scenes of the noise levels and of the PSFs that are compared.
        times: seconds per scene; empty where none were taken.
        montage: for each scene shown the truth and every method, in the order of ``columns``.
        columns: of the montage.
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
        named = self.config.data.compare_stacks
        stored = [one for one in self.outcomes if one.noise_db is None and one.scenes == self.part]
        return [one for one in stored if one.stack in named]

    @property
    def constant_cm(self) -> float | None:
        """Pooled depth RMSE of the best constant depth."""
        return next((one.pooled_depth_rmse_cm for one in self.naive if one.pooled_depth_rmse_cm is not None), None)

    @property
    def method_names(self) -> list[str]:
        """All methods in their order."""
        return [method.name for method in self.config.methods]

    def plain(self) -> dict[str, Any]:
        """Return all of it but the images, for JSON."""
        info = self.test.info
        return {
            "name": self.config.name,
            "config": self.config.dump(),
            "data": {
                "fingerprint": self.test.fingerprint,
                "split": self.test.split,
                "scenes": len(self.test),
                "psf": info.config["psf"],
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


def default_edges_cm(camera: CaptureModel, bins: int) -> tuple[float, ...]:
    """Return edges from the nearest to the farthest depth, even in disparity: what a mask resolves."""
    edges_m = camera.depth_m(np.linspace(1, 0, bins + 1))
    return tuple((100 * edges_m).tolist())


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
    return f"*{one.method}*" if one.kind == "naive" else one.method


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
    return (
        f"{len(findings.test)} scenes, split {findings.test.split} of a data set with fingerprint "
        f"`{findings.test.fingerprint[:12]}`{planes}; measurements as stored have {findings.stored_db:.1f} dB. The methods "
        f"assume {assumed}: {_planes(findings)}."
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


def on_part(findings: Findings) -> str:
    """Return how many scenes the noise levels and the comparison of PSFs have."""
    whole = len(findings.test)
    return f"Of {'all' if findings.part == whole else 'the first'} {findings.part} of {whole} scenes."


def _planes(findings: Findings) -> str:
    """Return planes and range, of each method where they differ."""
    words: dict[str, list[str]] = {}
    for method in findings.methods:
        near_cm, far_cm = (100 * depth_m for depth_m in method["depth_range_m"])
        text = f"{method['planes']} planes, depths from {near_cm:.3g} to {far_cm:.3g} cm"
        words.setdefault(text, []).append(method["name"])
    if len(words) == 1:
        return next(iter(words))
    return "; ".join(f"{', '.join(names)}: {text}" for text, names in words.items())


def write_results(folder: Path, findings: Findings) -> list[Path]:
    """Write everything, and delete what an earlier run left; returns the files, the report first.

    Raises:
        StorageError: the folder cannot be written to.
    """
    times = {one.method: one for one in findings.times}
    images = _figures(findings)
    files: dict[str, bytes] = {
        REPORT: _report(findings, list(images)).encode(),
        TABLE: csv_table([*findings.outcomes, *findings.naive], times).encode(),
        RESULTS: readable_json(findings.plain()),
        **images,
    }
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
    colours = method_colours(findings.method_names)
    figures: dict[str, bytes] = {}
    if findings.montage:
        camera = findings.camera
        line = f"white = radiance {camera.white:.3g}; depth z {depth_range(camera.near_m, camera.far_m)}"
        depths_m = (camera.near_m, camera.far_m)
        figures[MONTAGE] = montage_png(findings.columns, findings.montage, findings.config.name, line, *depths_m)
    if findings.ablation:
        figures[NOISE] = noise_png(findings.ablation, colours, findings.naive_part)
    figures[DEPTH] = depth_png(findings.main, colours, findings.naive, findings.edges_cm)
    if findings.compared:
        figures[STACKS] = stacks_png(
            findings.compared, colours, findings.config.data.compare_stacks, findings.naive_part
        )
    if findings.times:
        figures[TIMES] = times_png(findings.times, colours, findings.device)
    return figures


def _report(findings: Findings, images: Sequence[str]) -> str:
    times = {one.method: one for one in findings.times}
    rows = [*findings.main, *findings.naive]
    parts = [
        f"# {findings.config.name}",
        conditions(findings),
        markdown_table(rows, times, findings.constant_cm),
        how(findings),
        "\n".join(f"- {one.method}: {one.note}" for one in rows if one.note),
        left_out(rows),
        "## Further scores",
        markdown_further(rows),
    ]
    if MONTAGE in images:
        parts.append("## Scenes\n\n![truth and estimates](montage.png)")
    if findings.ablation:
        levels = sorted({one.noise_db for one in findings.ablation if one.noise_db is not None})
        tables = [markdown_matrix(findings.ablation, score, levels, "noise_db", " dB") for score, _ in PANELS]
        notes = [
            f"- {one.method} at {one.noise_db:g} dB: {one.note}" for one in findings.ablation if one.kind == "classical"
        ]
        parts += [
            "## Noise",
            on_part(findings),
            *tables,
            "\n".join(notes),
            f"{_WHISKERS}\n\n![scores against noise](noise.png)",
        ]
    parts += ["## Depth error against depth", markdown_bins(rows, findings.edges_cm), "![depth error](depth.png)"]
    if findings.compared:
        stacks = findings.config.data.compare_stacks
        tables = [markdown_matrix(findings.compared, score, stacks, "stack", " PSFs") for score, _ in PANELS]
        parts += [
            "## Which PSFs are assumed",
            on_part(findings),
            *tables,
            f"{_WHISKERS}\n\n![scores by PSFs](stacks.png)",
        ]
    if findings.times:
        words = (
            f"{findings.device}; one scene at a time, the methods by turns, median of {findings.config.time.repeats} after "
            "one that does not count. The seconds of learned methods are those of their first seed."
        )
        parts += ["## Time", words, markdown_times(findings.times), "![seconds per stage](times.png)"]
    parts.append(PUBLISHED)
    parts.append("## Made with\n\n" + ", ".join(f"{name} {version}" for name, version in versions(*_PACKAGES).items()))
    return "\n\n".join(part for part in parts if part) + "\n"
