"""The shutter's diagram: when each row is open, and when it is read out (figure 2.3 of the thesis)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simulator.demonstration.bench import Bench
from simulator.demonstration.facts import duration, shutter_name
from simulator.demonstration.paper import sheet
from simulator.optics.plot_panels import FAINT, INK, NORMAL, SMALL, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_OPEN, _READ = "#b9c0c5", "#e07b1a"
_FEW_ROWS = 40  # are drawn as bars of their own
_BANDS = 2000  # more rows than a picture has pixels are thinned out


def diagram_figure(bench: Bench) -> Figure:
    """Draw rows against time."""
    windows_ms = bench.shutter.windows_s(bench.rows).reshape(-1, 2) * 1e3
    exposures = bench.shutter.exposures_s(bench.rows)
    times = dict.fromkeys([duration(float(exposures.min())), duration(float(exposures.max()))])
    rows = f"{len(windows_ms)} physical rows"
    if bench.shutter.binning > 1:
        rows += f", {bench.shutter.binning} of them to a row of the picture"
    notes = [
        f"{rows}; each is open for {' to '.join(times)}; the last one closes after {duration(bench.duration_s)}.",
        "Row 0 is the sensor's top row. The picture is turned by 180 degrees: the sensor's top row is its bottom row.",
    ]
    figure = sheet(shutter_name(bench.shutter).capitalize(), notes, (11, 6.2))
    axes = figure.subplots()
    _draw_rows(axes, windows_ms)
    style(axes, "time from the capture's start (ms)", "physical row of the sensor")
    axes.set_xlim(0, bench.duration_s * 1.02e3)
    axes.set_ylim(len(windows_ms) - 0.5, -0.5)
    axes.set_facecolor("#f6f7f8")
    _picture_rows(axes, bench)
    legend = axes.legend(
        loc="upper right", bbox_to_anchor=(1, 1.09), ncols=2, frameon=False, fontsize=NORMAL, markerscale=3
    )
    for text in legend.get_texts():
        text.set_color(INK)
    return figure


def _draw_rows(axes: Axes, windows_ms: NDArray[np.float64]) -> None:
    rows = np.arange(len(windows_ms))
    opening, closing = windows_ms.T
    if len(rows) <= _FEW_ROWS:
        axes.barh(rows, closing - opening, left=opening, height=0.8, color=_OPEN, label="open")
        axes.vlines(closing, rows - 0.4, rows + 0.4, color=_READ, linewidth=3, label="closes and is read out")
        return
    shown = np.unique(np.linspace(0, len(rows) - 1, min(len(rows), _BANDS)).round().astype(int))
    edges = np.stack([shown - 0.5, shown + 0.5], axis=1).ravel()  # each row is as high as it is, with upright sides
    edges[1:-1:2] = edges[2::2] = (edges[1:-1:2] + edges[2::2]) / 2
    axes.fill_betweenx(
        edges, opening[shown].repeat(2), closing[shown].repeat(2), color=_OPEN, linewidth=0, label="open"
    )
    axes.plot(closing[shown], shown, ".", color=_READ, markersize=3.5, label="closes and is read out")


def _picture_rows(axes: Axes, bench: Bench) -> None:
    """Number the picture's rows on the right: the last one is the sensor's first."""
    last, binning = bench.rows - 1, bench.shutter.binning
    right = axes.secondary_yaxis(
        "right",
        functions=(
            lambda row: last + 0.5 - np.add(row, 0.5) / binning,
            lambda row: np.subtract(last + 0.5, row) * binning - 0.5,
        ),
    )
    right.set_ylabel("row of the picture", fontsize=NORMAL, color=INK)
    right.tick_params(labelsize=SMALL, colors=INK)
    right.spines["right"].set_color(FAINT)
