"""The files of an evaluation: results.json, table.csv, report.md and the figures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from learning.evaluation.figures import PANELS, depth_png, method_colours, noise_png, stacks_png, times_png
from learning.evaluation.findings import Findings, versions
from learning.evaluation.folder import DEPTH, MONTAGE, NOISE, REPORT, RESULTS, STACKS, TABLE, TIMES, remove_stale
from learning.evaluation.montage import montage_png
from learning.evaluation.report import (
    csv_table,
    markdown_bins,
    markdown_further,
    markdown_matrix,
    markdown_table,
    markdown_times,
)
from learning.evaluation.words import PUBLISHED, conditions, how, left_out, on_part
from simulator.io.files import write_atomic
from simulator.io.json import readable_json
from simulator.plots.drawing import depth_range

_WHISKERS = "Whiskers are the standard deviation over seeds."


def write_results(folder: Path, findings: Findings) -> list[Path]:
    """Write everything, and delete what an earlier run left; returns the files, the report first.

    Raises:
        StorageError: the folder cannot be written to.
    """
    times = {one.method: one for one in findings.times}
    pictures = _figures(findings)
    files: dict[str, bytes] = {
        REPORT: _report(findings, list(pictures)).encode(),
        TABLE: csv_table([*findings.outcomes, *findings.trivial], times).encode(),
        RESULTS: readable_json(findings.plain()),
        **pictures,
    }
    for name, content in files.items():
        write_atomic(folder / name, content)
    remove_stale(folder, files)
    return [folder / name for name in files]


def _figures(findings: Findings) -> dict[str, bytes]:
    colours = method_colours(findings.method_names)
    figures: dict[str, bytes] = {}
    if findings.montage:
        line = (
            f"white = radiance {findings.camera.white:.3g}; depth z "
            f"{depth_range(findings.camera.near_m, findings.camera.far_m)}"
        )
        figures[MONTAGE] = montage_png(
            findings.columns,
            findings.montage,
            findings.config.name,
            line,
            findings.camera.near_m,
            findings.camera.far_m,
        )
    if findings.ablation:
        figures[NOISE] = noise_png(findings.ablation, colours, findings.trivial_part)
    figures[DEPTH] = depth_png(findings.main, colours, findings.trivial, findings.edges_cm)
    if findings.compared:
        figures[STACKS] = stacks_png(
            findings.compared, colours, findings.config.data.compare_stacks, findings.trivial_part
        )
    if findings.times:
        figures[TIMES] = times_png(findings.times, colours, findings.device)
    return figures


def _report(findings: Findings, pictures: Sequence[str]) -> str:
    times = {one.method: one for one in findings.times}
    rows = [*findings.main, *findings.trivial]
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
    if MONTAGE in pictures:
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
            "## Which PSFs are believed",
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
    parts.append("## Made with\n\n" + ", ".join(f"{name} {version}" for name, version in versions().items()))
    return "\n\n".join(part for part in parts if part) + "\n"
