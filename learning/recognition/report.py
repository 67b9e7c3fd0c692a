"""What an evaluation of classifiers found, and its files: results.json, table.csv, report.md and figures."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from learning.config import RecognitionConfig
from learning.evaluate.figures import method_colours
from learning.evaluate.films import NamedFilm, film_sheet
from learning.evaluate.folder import remove_stale
from learning.evaluate.scoring import Times
from learning.evaluate.tables import markdown, markdown_times
from learning.labels import spoken
from learning.method import aligned
from learning.provenance import versions
from learning.recognition.figures import against_png, confusion_png, reliability_png
from learning.recognition.scores import (
    TOP,
    Difference,
    Predictions,
    chance,
    confusion_after_reversal,
    difference,
    majority,
    without_nan,
)
from simulator.io.files import storage_errors, write_atomic
from simulator.io.json import readable_json
from simulator.plots.drawing import png_bytes

REPORT, RESULTS, TABLE = "report.md", "results.json", "table.csv"
CONFUSION, RELIABILITY, NOISE, SLIVERS, SHEET = (
    "confusion.png",
    "reliability.png",
    "noise.png",
    "slivers.png",
    "sheet.png",
)
_OWN = (REPORT, RESULTS, TABLE, CONFUSION, RELIABILITY, NOISE, SLIVERS, SHEET)
_HOW = (
    "Accuracies are shares of the test captures, means over seeds; in brackets the 95 % bootstrap interval over "
    "captures (Wilson's where all captures are right equally often), and after ± half the 95 % interval (Student's t) "
    "over seeds where there are several. Probabilities have the temperature that each training found on its validation "
    "clips. The log loss is in nats; the calibration error is the mean difference of confidence and accuracy (ECE, 10 "
    "bins), mean over seeds."
)
_DIFFERENCES = (
    "Differences of top-1 accuracies in percentage points, and their 95 % intervals over captures: where both saw the same "
    "clips, bootstrap of the differences capture by capture (paired), else of independent means (Newcombe's). How trainings "
    "with other seeds differ is not in them: compare with the ± of the rows."
)


@dataclass(frozen=True, eq=False)
class Recognition:
    """All that came out.

    Attributes:
        predictions: of every classifier, as stored and at further levels of noise.
        backwards: of the reference on the same clips backwards, None where there are none.
        stored_db: PSNR of the captures as stored.
        fingerprint: of the reference's test data.
        times: seconds for a capture, of those classifiers that invert captures.
        sheet: for some captures the true frames, and what is seen of them and said.
    """

    config: RecognitionConfig
    predictions: Sequence[Predictions]
    backwards: Predictions | None
    stored_db: float
    fingerprint: str
    times: Sequence[Times]
    sheet: Sequence[Sequence[NamedFilm]]
    device: str

    @property
    def main(self) -> list[Predictions]:
        """The rows of the table: every classifier on the captures as stored."""
        return [one for one in self.predictions if one.noise_db is None]

    @property
    def reference(self) -> Predictions:
        """The one that all others are compared with."""
        return self._named(self.config.reference or self.config.classifiers[0].name)

    @property
    def ceiling(self) -> Predictions | None:
        """The one of whose accuracy shares are given."""
        return None if self.config.ceiling is None else self._named(self.config.ceiling)

    def _named(self, name: str) -> Predictions:
        return next(one for one in self.main if one.name == name)

    @cached_property
    def differences(self) -> list[Difference]:
        """The reference against every other one, on the captures as stored."""
        others = (one for one in self.main if one is not self.reference)
        return [difference(self.reference, other) for other in others]

    def of_ceiling(self, one: Predictions) -> float | None:
        """Return the top-1 accuracy of a classifier as a share of the ceiling's; None without one, or where that is 0."""
        ceiling = self.ceiling
        return one.accuracy() / ceiling.accuracy() if ceiling and ceiling.accuracy() else None

    def rows(self) -> list[list[str]]:
        """Return the table: its titles, every classifier, and what looks at nothing."""
        first, ceiling = self.reference, self.ceiling
        titles = ["classifier", *(f"top-{top} %" for top in TOP), *(["of the ceiling"] if ceiling else [])]
        titles += ["calibration error %", "log loss", "seeds"]
        rows = []
        for one in self.main:
            cells = [_accuracy(one, top) for top in TOP]
            if ceiling:
                share = self.of_ceiling(one)
                cells.append("–" if share is None else f"{100 * share:.0f} %")
            cells += [f"{100 * one.calibration_error():.1f}", f"{one.log_loss():.3f}", str(len(one.probabilities))]
            rows.append([one.name, *cells])
        rest = ["–"] * (len(titles) - 1 - len(TOP))
        rows.append(["chance", *(f"{100 * chance(first.classes, top):.1f}" for top in TOP), *rest])
        rows.append(["most frequent class", *(f"{100 * majority(first.truth, top):.1f}" for top in TOP), *rest])
        return [titles, *rows]

    def plain(self) -> dict[str, Any]:
        """Return all of it but the images, for JSON."""
        return {
            "name": self.config.name,
            "config": self.config.dump(),
            "data": {"fingerprint": self.fingerprint, "stored_psnr_db": self.stored_db},
            "classes": list(self.reference.classes),
            "predictions": [one.plain() | {"of_ceiling": self.of_ceiling(one)} for one in self.predictions],
            "differences": [
                {"other": one.other, "mean": one.mean, "interval": one.interval, "paired": one.paired}
                for one in self.differences
            ],
            "backwards": None if self.backwards is None else self._reversed(self.backwards),
            **{
                f"top_{top}": {
                    "chance": chance(self.reference.classes, top),
                    "most_frequent_class": majority(self.reference.truth, top),
                }
                for top in TOP
            },
            "times": [one.plain() for one in self.times],
            "device": self.device,
            "versions": versions("torch", "torchvision", "numpy"),
        }

    def _reversed(self, backwards: Predictions) -> dict[str, Any]:
        return {
            "test_fingerprint": backwards.test_fingerprint,
            "captures": len(backwards.truth),
            "checkpoints": list(backwards.checkpoints),
            "confusion_after_reversal": without_nan(confusion_after_reversal(self.reference, backwards)),
        }


def terminal_tables(found: Recognition) -> str:
    """Return the table, and the reference's differences from all others, as plain text."""
    lines = [f"{found.reference.name} minus {one.other}: {_points(one)} points" for one in found.differences]
    return "\n".join([*aligned(found.rows()), "", *lines])


def write_recognition(folder: Path, found: Recognition) -> list[Path]:
    """Write everything, and delete what an earlier run left; returns the files, the report first."""
    figures = _figures(found)
    files = {
        REPORT: _report(found, figures).encode(),
        TABLE: _csv(found).encode(),
        RESULTS: readable_json(found.plain()),
        **figures,
    }
    for name, content in files.items():
        with storage_errors(folder / name):
            write_atomic(folder / name, content)
    remove_stale(folder, files, _OWN)
    return [folder / name for name in files]


def _figures(found: Recognition) -> dict[str, bytes]:
    by_slivers = _by_slivers(found)
    shown = [one for one in (found.reference, found.ceiling) if one]
    shown = shown[:1] if shown[1:] == shown[:1] else shown
    levels = _by_level(found)
    for one in by_slivers:  # which have a figure of their own
        if one is not found.reference:
            levels.pop(one.name, None)
    colours = method_colours(list(dict.fromkeys([*(one.name for one in shown), *levels])))
    figures = {CONFUSION: confusion_png(shown), RELIABILITY: reliability_png(shown, colours)}
    constant = majority(found.reference.truth)
    if levels:
        points = {name: list(of.items()) for name, of in levels.items()}
        figures[NOISE] = against_png(points, colours, "PSNR of the capture, dB", constant)
    if by_slivers:
        name = found.reference.name
        points = {name: [(float(one.slivers or 0), one) for one in by_slivers]}
        figures[SLIVERS] = against_png(points, colours, "slivers", constant)
    if found.sheet:
        line = "top: true frames and class; bottom: estimate of each sliver and predicted class"
        figures[SHEET] = png_bytes(film_sheet(found.sheet, found.config.name, line))
    return figures


def _by_level(found: Recognition) -> dict[str, dict[float, Predictions]]:
    """Return each classifier's predictions at further levels of noise, by name and level."""
    by_name: dict[str, dict[float, Predictions]] = {}
    for one in found.predictions:
        if one.noise_db is not None:
            by_name.setdefault(one.name, {})[one.noise_db] = one
    return by_name


def _by_slivers(found: Recognition) -> list[Predictions]:
    """Return the reference and the rows like it but for the number of slivers, fewest first; empty without any."""
    alike = [one for one in found.main if one.kind == found.reference.kind and one.slivers is not None]
    by_number = {one.slivers or 0: one for one in [*reversed(alike), found.reference]}
    return [by_number[number] for number in sorted(by_number)] if len(by_number) > 1 else []


def _report(found: Recognition, figures: Mapping[str, bytes]) -> str:
    titles, *rows = found.rows()
    classes = list(map(spoken, found.reference.classes))
    parts = [
        f"# {found.config.name}",
        f"{len(found.reference.truth)} captures of data with fingerprint `{found.fingerprint[:12]}`, split "
        f"{found.config.data.split}, {len(classes)} classes; PSNR of the stored measurements: {found.stored_db:.1f} dB.",
        markdown(titles, rows),
        _HOW,
        "\n".join(f"- {one.name}: {one.note}" for one in found.main),
    ]
    if found.differences:
        table = [[one.other, _points(one), "yes" if one.paired else "no"] for one in found.differences]
        parts += ["## Against the reference", _DIFFERENCES]
        parts.append(markdown(["", f"{found.reference.name} minus it", "paired"], table))
    parts += [
        "## Confusion",
        f"![confusion matrix]({CONFUSION})",
        "## Per class",
        "Top-1 accuracy of each class's captures, %, mean over seeds.",
        markdown(
            ["class", *(one.name for one in found.main)],
            [[name, *(_per_cent(one.confusion()[at, at]) for one in found.main)] for at, name in enumerate(classes)],
        ),
        "## Calibration",
        "The confidence is the probability of the most likely class. Whiskers are 95 % intervals of a share (Wilson's), over "
        "the captures of all seeds; in brackets is the calibration error (ECE).",
        f"![confidence against accuracy]({RELIABILITY})",
    ]
    if NOISE in figures:
        by_name = _by_level(found)
        levels = sorted({level for of in by_name.values() for level in of})
        table = [[name, *(_accuracy(of[level], 1) for level in levels)] for name, of in by_name.items()]
        parts += ["## Noise", markdown(["top-1 %", *(f"{level:g} dB" for level in levels)], table)]
        parts.append(f"![accuracy against noise]({NOISE})")
    if SLIVERS in figures:
        table = [[str(one.slivers), _accuracy(one, 1)] for one in _by_slivers(found)]
        parts += ["## Slivers", markdown(["slivers", "top-1 %"], table), f"![accuracy against slivers]({SLIVERS})"]
    if found.backwards is not None:
        shares = confusion_after_reversal(found.reference, found.backwards)
        rows = [[name, *map(_per_cent, shares[at])] for at, name in enumerate(classes)]
        words = (
            "The same clips reversed in time and re-simulated: of the captures classified correctly (rows), the share "
            "assigned to each class after reversal (columns), %."
        )
        parts += ["## Time-reversed clips", words, markdown(["", *classes], rows)]
    if found.times:
        words = (
            f"{found.device}; one capture at a time, the networks in turn, median of {found.config.timed} runs after one "
            "warm-up run. Networks are timed with their first seed."
        )
        parts += ["## Time", words, markdown_times(found.times)]
    if found.sheet:
        parts += ["## Captures", f"![captures]({SHEET})"]
    packages = ", ".join(f"{name} {version}" for name, version in versions("torch", "torchvision", "numpy").items())
    parts += ["## Made with", packages]
    return "\n\n".join(parts) + "\n"


def _accuracy(one: Predictions, top: int) -> str:
    """Return an accuracy with its interval and spread, in per cent."""
    ends, spread = one.intervals[top], one.over_seeds(top)
    interval = "" if ends is None else f" [{100 * ends[0]:.1f}, {100 * ends[1]:.1f}]"
    return f"{100 * one.accuracy(top):.1f}{interval}{'' if spread is None else f' ±{100 * spread:.1f}'}"


def _per_cent(share: float) -> str:
    return "–" if math.isnan(share) else f"{100 * share:.0f}"


def _points(one: Difference) -> str:
    interval = "" if one.interval is None else f" [{100 * one.interval[0]:+.1f}, {100 * one.interval[1]:+.1f}]"
    return f"{100 * one.mean:+.1f}{interval}"


def _csv(found: Recognition) -> str:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    columns = [
        name
        for top in TOP
        for name in (f"top_{top}", f"top_{top}_low", f"top_{top}_high", f"top_{top}_half_interval_over_seeds")
    ]
    writer.writerow(
        ["classifier", "noise_db", "slivers", "seeds", *columns, "of_ceiling", "calibration_error", "log_loss"]
    )
    for one in found.predictions:
        numbers: list[float | None] = []
        for top in TOP:
            ends = one.intervals[top] or (None, None)
            numbers += [one.accuracy(top), *ends, one.over_seeds(top)]
        about = [one.name, one.noise_db, one.slivers, len(one.probabilities)]
        writer.writerow([*about, *numbers, found.of_ceiling(one), one.calibration_error(), one.log_loss()])
    return stream.getvalue()
