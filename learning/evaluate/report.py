"""All that an evaluation found, and its files: results.json, table.csv, paired.csv, report.md and figures."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any
from urllib.parse import quote

from learning.camera import CaptureModel
from learning.config import EvaluateConfig
from learning.evaluate.curves import Curve
from learning.evaluate.figures import (
    Shown,
    curves_png,
    depth_png,
    method_colours,
    montage_png,
    noise_png,
    over_time_png,
    stacks_png,
    times_png,
)
from learning.evaluate.films import NamedFilm, film_sheet, film_webp
from learning.evaluate.folder import DESCRIPTION, remove_stale
from learning.evaluate.outcome import SCORES, Outcome
from learning.evaluate.paired import COMPARED, EXPLAINED, Difference, compare
from learning.evaluate.scoring import Times
from learning.evaluate.tables import (
    TUNED_ELSEWHERE,
    csv_differences,
    csv_table,
    markdown_bins,
    markdown_differences,
    markdown_further,
    markdown_matrix,
    markdown_table,
    markdown_times,
    markdown_verdicts,
)
from learning.metrics import DEFINITIONS, SSIM_DEFINITION
from learning.provenance import versions
from simulator.dataset.reader import Dataset
from simulator.io.files import storage_errors, write_atomic
from simulator.io.json import readable_json
from simulator.plots.drawing import depth_range, png_bytes

RESULTS, TABLE, PAIRED, REPORT = "results.json", "table.csv", "paired.csv", "report.md"
MONTAGE, NOISE, DEPTH, STACKS, TIMES = "montage.png", "noise.png", "depth.png", "stacks.png", "times.png"
FILMS, ANIMATION, CURVES, OVER_TIME = "films.png", "films.webp", "curves.png", "over_time.png"
_OWN = (REPORT, TABLE, PAIRED, RESULTS, MONTAGE, NOISE, DEPTH, STACKS, TIMES, FILMS, ANIMATION, CURVES, OVER_TIME)
OWN_FILES = (DESCRIPTION, *_OWN)
"""Names that no data set may have: the folder of its figures lies beside these files."""
_PACKAGES = ("torch", "numpy", "scikit-image", "flip-evaluator", "lpips", "cvvdp", "ortools")
_WHISKERS = "Whiskers are the standard deviation over seeds."
_TUNED_ELSEWHERE = f"{TUNED_ELSEWHERE} with parameters that were tuned at another level, see below."


@dataclass(frozen=True, eq=False)
class Findings:
    """What came out on one data set.

    Attributes:
        camera: what the first method that tells depths apart was told, or else the first.
        stored_db: PSNR of the measurements as stored.
        edges_cm: of the bins of depth.
        methods: what is known of each method and seed.
        outcomes: of all methods, PSFs and levels.
        naive: of what looks at no measurement; ``naive_part`` on the scenes of noise levels and of compared PSFs.
        times: seconds per scene; empty where none were taken.
        montage: for each scene shown the truth and every method, in the order of ``columns``; empty of clips.
        films: for each clip shown the same; empty of stills.
        groups: the rows of the table for some of the scenes alone, by a title for these.
    """

    config: EvaluateConfig
    test: Dataset
    camera: CaptureModel
    stored_db: float
    edges_cm: tuple[float, ...]
    methods: Sequence[Mapping[str, Any]]
    outcomes: Sequence[Outcome]
    naive: Sequence[Outcome]
    naive_part: Sequence[Outcome]
    times: Sequence[Times]
    montage: Sequence[Sequence[Shown]]
    columns: Sequence[str]
    films: Sequence[Sequence[NamedFilm]] = ()
    groups: Mapping[str, Sequence[Outcome]] = field(default_factory=dict)
    curves: Sequence[Curve] = ()

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
    def levels(self) -> dict[str, list[Outcome]]:
        """Every method at each further level of noise, by a title for it, with what looks at no measurement."""
        levels = sorted({one.noise_db for one in self.ablation if one.noise_db is not None})
        return {
            f"{level:g} dB": [*(one for one in self.ablation if one.noise_db == level), *self.naive_part]
            for level in levels
        }

    @cached_property
    def differences(self) -> dict[str, list[Difference]]:
        """The paired differences from the reference, as stored, by group and level of noise; empty for one method."""
        reference = self.config.reference or self.config.methods[0].name
        stored = {f"stored ({self.stored_db:.0f} dB)": [*self.main, *self.naive]}
        cases = stored | dict(self.groups) | self.levels
        methods = {title: [one for one in outcomes if one.kind != "naive"] for title, outcomes in cases.items()}
        found = {title: compare(reference, judged, self.config.seed) for title, judged in methods.items()}
        return found if len(self.config.methods) > 1 else {}

    def plain(self) -> dict[str, Any]:
        """Return all of it but the images, for JSON."""
        return {
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
            "methods": list(self.methods),
            "outcomes": [one.plain() for one in self.outcomes],
            "naive": [one.plain() for one in self.naive],
            "paired": [one.plain() for found in self.differences.values() for one in found],
            "times": [one.plain() for one in self.times],
            "curves": [one.plain() for one in self.curves],
        }


@dataclass(frozen=True, eq=False)
class Evaluation:
    """All of a file: its findings by data set, whose name is empty where it is the only one.

    ``perceptual`` says which perceptual metric was measured, or why none.
    """

    config: EvaluateConfig
    findings: Mapping[str, Findings]
    perceptual: str
    device: str

    @property
    def side_by_side(self) -> dict[str, list[Outcome]]:
        """The rows of each data set's table."""
        return {name: [*found.main, *found.naive] for name, found in self.findings.items()}

    @property
    def differences(self) -> dict[str, list[Difference]]:
        """The paired differences by data set, on the measurements as stored; empty for one method."""
        return {
            name: next(iter(found.differences.values())) for name, found in self.findings.items() if found.differences
        }

    def plain(self) -> dict[str, Any]:
        """Return all of it but the images, for JSON."""
        about = {
            "name": self.config.name,
            "config": self.config.dump(),
            "perceptual": self.perceptual,
            "definitions": DEFINITIONS,
            "device": self.device,
            "versions": versions(*_PACKAGES),
        }
        sets = {name: found.plain() for name, found in self.findings.items()}
        return about | sets.get("", {"sets": sets})


PUBLISHED = """## Published, on other data

| thesis, table 5.2 | PSNR dB ↑ | SSIM ↑ | LPIPS ↓ | depth RMSE cm ↓ | s per scene ↓ |
| --- | ---: | ---: | ---: | ---: | ---: |
| CLS + graph cut | 16.24 | 0.56 | 0.51 | 4.87 | 1.21 |
| ADMM + graph cut | 15.94 | 0.63 | 0.32 | 5.26 | 10.26 |
| FlatNet2D | 19.86 | 0.65 | 0.30 | 1.92 | 0.011 |
| FlatNet3D | 21.91 | 0.79 | 0.14 | 1.42 | 0.013 |

These are for the thesis's own scenes, camera and computer, and not directly comparable with the numbers above. For depths
uniform in the thesis's range, 3.6 to 20 cm, the best constant depth has an RMSE of 4.73 cm."""


def conditions(findings: Findings) -> str:
    """Return on which scenes the methods were judged, and what they were told of the camera."""
    psf = findings.test.info.config["psf"]
    count = len(psf["depths_cm"]) if psf.get("depths_cm") else psf.get("depths")
    planes = f", PSFs {psf['model']} at {count} depths" if psf.get("model") and count else ""
    stack = findings.config.data.stack
    assumed = "their own PSFs" if stack == "own" else f"the PSFs {stack}"
    timing = findings.camera.timing
    slivers = (
        "" if timing is None else f", {timing.frames} slivers of a capture of {1e3 * timing.frame_edges_s[-1]:.3g} ms"
    )
    ranges: dict[str, list[str]] = {}
    for method in findings.methods:
        near_cm, far_cm = (100 * depth_m for depth_m in method["depth_range_m"])
        text = f"{method['planes']} planes, depths from {near_cm:.3g} to {far_cm:.3g} cm"
        if method["planes"] == 1:
            text = f"one plane at {near_cm:.3g} cm"
        ranges.setdefault(text, []).append(method["name"])
    told = "; ".join(text if len(ranges) == 1 else f"{', '.join(names)}: {text}" for text, names in ranges.items())
    return (
        f"{len(findings.test)} scenes, split {findings.test.split} of a data set with fingerprint "
        f"`{findings.test.fingerprint[:12]}`{planes}{slivers}; measurements as stored have {findings.stored_db:.1f} dB. "
        f"The methods assume {assumed}: {told}."
    )


def how(evaluation: Evaluation) -> str:
    """Return how the tables are to be read."""
    rows = [one for found in evaluation.findings.values() for one in found.main]
    seeds = [len(next(iter(one.scores.values())).seeds) for one in rows if one.kind == "learned"]
    brackets = f", in brackets over {max(seeds)} seeds" if seeds and max(seeds) > 1 else ""
    depth = (
        " Every method's depths are clamped to its range, and count where there is a surface. Pooled: over all pixels of all "
        "scenes; shares are those of the best constant depth's, pooled."
    )
    told = any("depth_rmse_cm" in one.scores for one in rows)
    return (
        f"Mean ± standard deviation over scenes{brackets}; the best of each column is bold; what looks at no measurement "
        f"is in italics.{depth if told else ''} SSIM: {SSIM_DEFINITION}. "
        f"{evaluation.perceptual[0].upper()}{evaluation.perceptual[1:]}."
    )


def compared_scores(rows: Iterable[Outcome]) -> list[str]:
    """Return the scores that are compared, as far as they were measured."""
    known = {score for one in rows for score in one.scores}
    return [score for score in COMPARED if score in known]


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


def write_results(folder: Path, evaluation: Evaluation) -> list[Path]:
    """Write everything, and delete what an earlier run left; returns the files, the report first.

    Figures of several data sets lie in a folder for each.
    """
    tables, differences = {}, {}
    figures: dict[str, bytes] = {}
    for name, found in evaluation.findings.items():
        times = {one.method: one for one in found.times}
        tables[name] = [*found.outcomes, *found.naive], times
        differences[name] = [one for each in found.differences.values() for one in each]
        figures |= {_place(name, figure): content for figure, content in _figures(evaluation, name).items()}
    files = {
        REPORT: _report(evaluation).encode(),
        TABLE: csv_table(tables).encode(),
        RESULTS: readable_json(evaluation.plain()),
        **({PAIRED: csv_differences(differences).encode()} if any(differences.values()) else {}),
        **figures,
    }
    for name, content in files.items():
        with storage_errors(folder / name):
            (folder / name).parent.mkdir(exist_ok=True)
        write_atomic(folder / name, content)
    remove_stale(folder, files, _OWN)
    return [folder / name for name in files]


def _place(name: str, figure: str) -> str:
    """Return the place of a data set's figure."""
    return f"{name}/{figure}" if name else figure


def _figures(evaluation: Evaluation, name: str) -> dict[str, bytes]:
    findings = evaluation.findings[name]
    colours = method_colours([method.name for method in findings.config.methods])
    part, stacks = findings.naive_part, findings.config.data.compare_stacks
    figures: dict[str, bytes] = {}
    if any(one.bins_cm for one in findings.main):
        figures[DEPTH] = depth_png(findings.main, colours, findings.naive, findings.edges_cm)
    if any(one.over_time for one in findings.main) and findings.camera.timing is not None:
        edges_s = findings.camera.timing.frame_edges_s
        figures[OVER_TIME] = over_time_png(findings.main, colours, findings.naive, edges_s)
    title, camera = ": ".join(filter(None, [evaluation.config.name, name])), findings.camera
    line = f"white = radiance {camera.white:.3g}"
    if len(camera.stack.depths_m) > 1:
        line += f"; depth z {depth_range(camera.near_m, camera.far_m)}"
    if findings.films:
        figures[FILMS] = png_bytes(film_sheet(findings.films, title, line))
        figures[ANIMATION] = film_webp(findings.films)
    if findings.montage:
        figures[MONTAGE] = montage_png(findings.columns, findings.montage, title, line, camera.near_m, camera.far_m)
    if findings.ablation:
        figures[NOISE] = noise_png(findings.ablation, colours, part)
    if findings.compared:
        figures[STACKS] = stacks_png(findings.compared, colours, stacks, part)
    if findings.times:
        figures[TIMES] = times_png(findings.times, colours, evaluation.device)
    if findings.curves:
        figures[CURVES] = curves_png(findings.curves, colours)
    return figures


def _report(evaluation: Evaluation) -> str:
    """Return the whole report: what all data sets share stands before and behind the sections of each."""
    parts = [f"# {evaluation.config.name}"]
    several = "" not in evaluation.findings
    rows = [one for found in evaluation.findings.values() for one in found.main]
    if several:
        parts += [
            "## All data sets",
            *(markdown_matrix(score, evaluation.side_by_side) for score in compared_scores(rows)),
        ]
        parts += [how(evaluation)]
        if evaluation.differences:
            parts += ["## Paired differences on all data sets", EXPLAINED, markdown_verdicts(evaluation.differences)]
            parts += [markdown_differences(score, evaluation.differences) for score in compared_scores(rows)]
    for name, found in evaluation.findings.items():
        heading = "###" if several else "##"
        parts += [f"## {name}" if several else "", *_sections(found, evaluation, name, heading)]
    parts += [
        PUBLISHED if any("depth_rmse_cm" in one.scores and not one.over_time for one in rows) else "",
        "## Made with",
        ", ".join(f"{name} {version}" for name, version in versions(*_PACKAGES).items()),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _sections(findings: Findings, evaluation: Evaluation, name: str, heading: str) -> list[str]:
    """Return what is said of one data set."""
    rows, times = [*findings.main, *findings.naive], {one.method: one for one in findings.times}
    ablation, compared, whole = findings.ablation, findings.compared, len(findings.test)
    on_part = (
        f"Of all {whole} scenes." if findings.part == whole else f"Of the first {findings.part} of {whole} scenes."
    )

    def shown(words: str, figure: str) -> str:
        return f"![{words}]({quote(_place(name, figure))})"

    parts = [
        conditions(findings),
        markdown_table(rows, times),
        "" if name else how(evaluation),
        "\n".join(
            [*(f"- {one.method}: {one.note}" for one in rows if one.note), *(f"- {n}" for n in findings.unknown)]
        ),
        left_out(rows),
        f"{heading} Further scores",
        markdown_further(rows),
        f"{heading} Scenes\n\n{shown('truth and estimates', MONTAGE)}" if findings.montage else "",
        f"{heading} Films\n\n{shown('animation', ANIMATION)}\n\n{shown('films', FILMS)}" if findings.films else "",
    ]
    for title, group in findings.groups.items():
        parts += [f"{heading} {title[0].upper()}{title[1:]}", f"{group[0].scenes} scenes.", markdown_table(group, {})]
    if ablation:
        notes: dict[tuple[str, str], list[str]] = {}
        for one in (one for one in ablation if one.tuned_db is not None):
            notes.setdefault((one.method, one.note), []).append(f"{one.noise_db:g}")
        lines = [f"- {method} at {', '.join(levels)} dB: {note}" for (method, note), levels in notes.items()]
        elsewhere = any(one.tuned_elsewhere for one in ablation)
        tables = [markdown_matrix(score, findings.levels) for score in compared_scores(rows)]
        parts += [f"{heading} Noise", on_part, *tables, _TUNED_ELSEWHERE if elsewhere else "", "\n".join(lines)]
        parts += [shown("scores against noise", NOISE), "Small dots are single seeds."]
    if findings.differences:
        tables = [markdown_differences(score, findings.differences) for score in compared_scores(rows)]
        words = ["" if name else EXPLAINED, f"At further levels: {on_part.lower()}" if findings.part < whole else ""]
        parts += [f"{heading} Paired differences", *words, markdown_verdicts(findings.differences), *tables]
    if any(one.bins_cm for one in rows):
        by_depth = markdown_bins(rows, findings.edges_cm)
        parts += [f"{heading} Depth error against depth", by_depth, shown("depth error", DEPTH)]
    if any(one.over_time for one in rows):
        words = "Means over all scenes and seeds of each frame's score, at the middle of its time in the capture."
        parts += [f"{heading} Scores over the capture", words, shown("scores over time", OVER_TIME)]
    if compared:
        stacks = findings.config.data.compare_stacks
        columns = {f"{stack} PSFs": [one for one in compared if one.stack == stack] for stack in stacks}
        tables = [markdown_matrix(score, columns) for score in compared_scores(rows)]
        parts += [f"{heading} Which PSFs are assumed", on_part, *tables, _WHISKERS, shown("scores by PSFs", STACKS)]
    if findings.times:
        words = (
            f"{evaluation.device}; one scene at a time, the methods in turn, median of {findings.config.time.repeats} runs "
            "after one warm-up run. Networks are timed with their first seed."
        )
        parts += [f"{heading} Time", words, markdown_times(findings.times), shown("seconds per stage", TIMES)]
    if findings.curves:
        words = "Scores of the networks on their validation scenes while they were trained, a line for each seed."
        parts += [f"{heading} Learning curves", words, shown("scores against steps", CURVES)]
    return parts
