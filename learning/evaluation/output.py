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
from learning.metrics import SSIM_DEFINITION
from simulator.dataset.plain import readable_json
from simulator.files import write_atomic
from simulator.preview.drawing import depth_range

# Depth RMSE in table 5.2 of the thesis, and what the best constant has on depths that are uniform in its 3.6 to 20 cm.
_THESIS = (
    "the thesis's classical methods have a depth RMSE of 4.87 cm (CLS) and 5.26 cm (ADMM) on its own scenes (table 5.2), the "
    "best constant 4.73 cm on depths that are uniform in its range"
)
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
        figures[NOISE] = noise_png(findings.ablation, colours, findings.trivial)
    figures[DEPTH] = depth_png(findings.main, colours, findings.trivial, findings.edges_cm)
    if findings.compared:
        figures[STACKS] = stacks_png(findings.compared, colours, findings.config.data.compare_stacks)
    if findings.times:
        figures[TIMES] = times_png(findings.times, colours, findings.device)
    return figures


def _report(findings: Findings, pictures: Sequence[str]) -> str:
    times = {one.method: one for one in findings.times}
    rows = [*findings.main, *findings.trivial]
    parts = [
        f"# {findings.config.name}",
        _conditions(findings),
        markdown_table(rows, times, findings.constant_cm),
        _legend(findings),
        "\n".join(f"- {one.method}: {one.note}" for one in findings.main if one.note),
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
        parts += ["## Noise", *tables, "\n".join(notes), f"{_WHISKERS}\n\n![scores against noise](noise.png)"]
    parts += ["## Depth error against depth", markdown_bins(rows, findings.edges_cm), "![depth error](depth.png)"]
    if findings.compared:
        stacks = findings.config.data.compare_stacks
        tables = [markdown_matrix(findings.compared, score, stacks, "stack", " PSFs") for score, _ in PANELS]
        parts += ["## Which PSFs are believed", *tables, f"{_WHISKERS}\n\n![scores by PSFs](stacks.png)"]
    if findings.times:
        words = (
            f"{findings.device}; one scene at a time, the methods by turns, median of {findings.config.time.repeats} after "
            "one that does not count. The seconds of learned methods are those of their first seed."
        )
        parts += ["## Time", words, markdown_times(findings.times), "![seconds per stage](times.png)"]
    parts.append("## Made with\n\n" + ", ".join(f"{name} {version}" for name, version in versions().items()))
    return "\n\n".join(part for part in parts if part) + "\n"


def _conditions(findings: Findings) -> str:
    psf = findings.test.info.config["psf"]
    planes = f", PSFs {psf['model']} at {psf['depths']} depths" if psf.get("model") else ""
    stack = findings.config.data.stack
    believed = "their own PSFs" if stack == "own" else f"the PSFs {stack}"
    return (
        f"{len(findings.test)} scenes, split {findings.test.split} of a data set with fingerprint "
        f"`{findings.test.fingerprint[:12]}`{planes}; measurements as stored have {findings.stored_db:.1f} dB. The methods "
        f"believe {believed}, with {len(findings.camera.stack.depths_m)} planes."
    )


def _legend(findings: Findings) -> str:
    seeds = [len(next(iter(one.scores.values())).seeds) for one in findings.main if one.kind == "learned"]
    brackets = f", in brackets over {max(seeds)} seeds" if seeds and max(seeds) > 1 else ""
    depth = "Every method's depths are clamped to the range alike, and count where there is a surface."
    return (
        f"Mean ± standard deviation over scenes{brackets}; the best of each column is bold; answers in italics look at no "
        f"measurement. {depth} Pooled: over all pixels of all scenes; beside it as a share of the best constant depth's. "
        f"SSIM: {SSIM_DEFINITION}. {findings.perceptual[0].upper()}{findings.perceptual[1:]}. For "
        f"reference: {_THESIS}."
    )
