"""The figures of an evaluation of classifiers: confusion, reliability, and accuracy against what is varied."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from learning.labels import spoken
from learning.recognition.scores import Predictions, wilson
from simulator.plots import drawing
from simulator.plots.psf import GRID, INK, style

_DPI = 120
_GREY = "#8a9299"
_MARKS = "osD^vPX*"
_APART = 0.06  # curves, as a share of the distance between the points of one


def confusion_png(predictions: Sequence[Predictions]) -> bytes:
    """Return a matrix for each classifier: rows are what is done, columns what it is taken for, in per cent of the row."""
    classes = predictions[0].classes
    side = 1.6 + 0.42 * len(classes)
    figure = drawing.new_figure((side * len(predictions) + 1.2, side + 0.6), _DPI)
    axes = figure.subplots(1, len(predictions), sharey=True, squeeze=False)[0]
    names = list(map(spoken, classes))
    for place, one in zip(axes, predictions, strict=True):
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


def reliability_png(predictions: Sequence[Predictions], colours: Mapping[str, str]) -> bytes:
    """Return the reliability diagram: accuracy, with 95 % intervals, against confidence, and how often each one occurs."""
    figure = drawing.new_figure((6.4, 5.4), _DPI)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[3, 1])
    above.plot([0, 1], [0, 1], color=_GREY, lw=1, ls="--", label="calibrated")
    for one in predictions:
        confidence, right, counts = one.reliability()
        known = counts > 0
        confidence, right, counts = confidence[known], right[known], counts[known]
        ends = np.array([wilson(round(share * count), int(count)) for share, count in zip(right, counts, strict=True)])
        look: Any = {"color": colours[one.name], "marker": "o", "ms": 4, "lw": 1.6, "elinewidth": 1, "capsize": 2}
        label = f"{one.name} (ECE {100 * one.calibration_error():.1f} %)"
        above.errorbar(confidence, right, np.abs(ends.T - right), label=label, **look)
        below.plot(confidence, counts / counts.sum(), color=colours[one.name], lw=1.4)
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
    points: Mapping[str, Sequence[tuple[float, Predictions]]],
    colours: Mapping[str, str],
    title: str,
    constant: float,
) -> bytes:
    """Return top-1 accuracy against what is varied, with its 95 % interval over captures, and that of the best constant.

    The curves are a little apart along the axis, so that their intervals do not hide each other.
    """
    figure = drawing.new_figure((8.4, 4.2), _DPI)
    axes = figure.subplots()
    every = sorted({place for found in points.values() for place, _ in found})
    step = _APART * min(np.diff(every), default=1.0)
    for at, (name, found) in enumerate(points.items()):
        found = sorted(found, key=lambda pair: pair[0])
        places = [place + step * (at - (len(points) - 1) / 2) for place, _ in found]
        rates = 100 * np.array([one.accuracy() for _, one in found])
        ends = 100 * np.array([one.intervals[1] or (one.accuracy(), one.accuracy()) for _, one in found])
        look: Any = {"color": colours[name], "marker": _MARKS[at % len(_MARKS)], "ms": 5, "lw": 1.8, "label": name}
        axes.errorbar(places, rates, np.abs(ends.T - rates), elinewidth=1, capsize=2, **look)
    axes.axhline(100 * constant, color=_GREY, lw=1, ls="--", label="most frequent class")
    style(axes, title, "top-1 accuracy, %")
    axes.set_xticks(every, [f"{place:g}" for place in every])
    axes.set_ylim(bottom=0)
    axes.grid(color=GRID)
    figure.legend(loc="outside right upper", fontsize=8, frameon=False)
    return drawing.figure_png(figure)
