"""The figures of an evaluation of classifiers: confusion, reliability, and accuracy against what is varied."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from learning.labels import spoken
from learning.recognition.scores import Answers
from simulator.plots import drawing
from simulator.plots.psf import GRID, INK, style

_DPI = 120
_GREY = "#8a9299"


def confusion_png(answers: Sequence[Answers]) -> bytes:
    """Return a matrix for each classifier: rows are what is done, columns what it is taken for, in per cent of the row."""
    classes = answers[0].classes
    side = 1.6 + 0.42 * len(classes)
    figure = drawing.new_figure((side * len(answers) + 1.2, side + 0.6), _DPI)
    axes = figure.subplots(1, len(answers), sharey=True, squeeze=False)[0]
    names = list(map(spoken, classes))
    for place, one in zip(axes, answers, strict=True):
        shares = 100 * one.confusion()
        place.imshow(shares, cmap="Blues", vmin=0, vmax=100)
        place.set_title(f"{one.name}: top-1 {100 * one.accuracy():.0f} %", fontsize=10, color=INK)
        place.set_xticks(range(len(names)), names, rotation=60, ha="right", rotation_mode="anchor", fontsize=8)
        place.set_yticks(range(len(names)), names, fontsize=8)
        for row, column in np.argwhere(shares >= 0.5):
            dark = shares[row, column] > 55
            text = f"{shares[row, column]:.0f}"
            place.text(column, row, text, ha="center", va="center", fontsize=7, color="white" if dark else INK)
        place.set_xlabel("predicted class", fontsize=9)
    axes[0].set_ylabel("true class", fontsize=9)
    return drawing.figure_png(figure)


def reliability_png(answers: Sequence[Answers], colours: Mapping[str, str]) -> bytes:
    """Return the reliability diagram: accuracy against confidence, and how often each confidence occurs."""
    figure = drawing.new_figure((6.4, 5.4), _DPI)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[3, 1])
    above.plot([0, 1], [0, 1], color=_GREY, lw=1, ls="--", label="calibrated")
    for one in answers:
        confidence, right, counts = one.reliability()
        known = counts > 0
        label = f"{one.name} ({100 * one.calibration_error():.1f} %)"
        above.plot(confidence[known], right[known], color=colours[one.name], marker="o", ms=4, lw=1.6, label=label)
        below.plot(confidence[known], counts[known] / counts.sum(), color=colours[one.name], lw=1.4)
    style(above, "", "accuracy")
    style(below, "confidence", "share")
    below.set_ylim(bottom=0)
    above.set_xlim(0, 1)
    above.set_ylim(0, 1)
    for place in (above, below):
        place.grid(color=GRID)
    above.legend(fontsize=8, frameon=False)
    return drawing.figure_png(figure)


def against_png(
    points: Mapping[str, Sequence[tuple[float, Answers]]],
    colours: Mapping[str, str],
    title: str,
    constant: float,
) -> bytes:
    """Return top-1 accuracy against what is varied, with its 95 % interval over captures, and of the best constant answer."""
    figure = drawing.new_figure((8.4, 4.2), _DPI)
    axes = figure.subplots()
    for name, found in points.items():
        found = sorted(found, key=lambda pair: pair[0])
        places, rates = [place for place, _ in found], [100 * one.accuracy() for _, one in found]
        axes.plot(places, rates, color=colours[name], marker="o", ms=5, lw=1.8, label=name)
        for place, one in found:
            if (ends := one.intervals[1]) is not None:
                axes.plot([place, place], [100 * end for end in ends], color=colours[name], lw=1, alpha=0.7)
    axes.axhline(100 * constant, color=_GREY, lw=1, ls="--", label="most frequent class")
    style(axes, title, "top-1 accuracy, %")
    axes.set_ylim(bottom=0)
    axes.grid(color=GRID)
    figure.legend(loc="outside right upper", fontsize=8, frameon=False)
    return drawing.figure_png(figure)
