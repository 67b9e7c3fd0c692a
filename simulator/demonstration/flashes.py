"""Spots that flash one after another, down a column or along a row, as the shutter lets them through (figures 2.4, 2.5)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from simulator.demonstration.bench import SAMPLES, Bench, Spot
from simulator.demonstration.facts import duration, shutter_name
from simulator.demonstration.paper import panel, sheet, tinted, white_of
from simulator.optics.plot_panels import INK, NORMAL

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Light that stands for a time: apart for colour-blind eyes too, and still apart where it overlaps.
_COLOURS = (((1.0, 0.28, 0.05), "orange"), ((0.1, 0.85, 0.45), "green"), ((0.25, 0.45, 1.0), "blue"))
_WHOLE_SPOT = 0.99  # a row is open so much of a time sample


def along_figure(bench: Bench) -> Figure:
    """Draw three spots that flash one after another down a column."""
    spots = [
        Spot(row, column, sample, *colour)
        for row, column, sample, colour in zip((0.25, 0.5, 0.75), (0.5, 0.5, 0.5), (20, 50, 80), _COLOURS, strict=True)
    ]
    return _figure(bench, spots, "down a column", lens=False)


def across_figure(bench: Bench) -> Figure:
    """Draw two spots that flash one after another along a row, seen through a lens too."""
    samples = _seen_and_missed(bench)
    spots = [
        Spot(0.5, column, sample, *colour)
        for column, sample, colour in zip((0.3, 0.7), samples, (_COLOURS[0], _COLOURS[2]), strict=True)
    ]
    return _figure(bench, spots, "along a row", lens=True)


def _seen_and_missed(bench: Bench) -> tuple[int, int]:
    """Return two time samples, at one of which the scene's middle row is open behind a lens, and at the other closed.

    Where it is open for all of the capture, the 20th and the 50th, as in the thesis.
    """
    edges = np.linspace(0, bench.duration_s, SAMPLES + 1)
    share = bench.shutter.weights(bench.rows, edges)[:, bench.rows // 2]
    closed = np.flatnonzero(share == 0) + 1
    if not closed.size:
        return 20, 50
    best = np.flatnonzero(share >= min(_WHOLE_SPOT, share.max())) + 1
    seen = int(best[len(best) // 2])
    apart = max(SAMPLES // 4, 1)
    missed = int(closed[np.argmin(np.abs(np.abs(closed - seen) - apart))])
    return (seen, missed) if seen < missed else (missed, seen)


def _figure(bench: Bench, spots: Sequence[Spot], where: str, *, lens: bool) -> Figure:
    tints = [spot.colour for spot in spots]
    pictures = [bench.picture(spot) for spot in spots]
    convolved, exposed = [bench.convolved(spot) for spot in spots], [bench.exposed(spot) for spot in spots]
    behind_lens = [bench.exposed_behind_lens(spot) for spot in spots] if lens else []
    white, white_sum = white_of(convolved), white_of([np.sum(convolved, axis=0)])
    white_lens = max(float(bench.exposed_behind_lens(spot, always=True).max()) for spot in spots) if lens else 1.0
    open_rows = [np.broadcast_to(bench.share(spot)[:, None], bench.sensor_shape) for spot in spots]

    wide, scene_wide = (columns / rows for rows, columns in (bench.sensor_shape, bench.scene_shape))
    figure = sheet(
        f"{shutter_name(bench.shutter).capitalize()}: spots flash {where}",
        _notes(bench, white_sum / white, lens),
        (13.5, 2.15 * len(spots) + 5.4),
    )
    grid = figure.add_gridspec(2, 1, height_ratios=[2.15 * len(spots), 4.2])
    ratios = [scene_wide, wide, wide, wide] + [scene_wide] * lens
    top = figure.add_subfigure(grid[0]).subplots(len(spots), len(ratios), squeeze=False, width_ratios=ratios)
    columns = [
        ("Scene", [tinted([light], 1.0) for light in zip(pictures, tints, strict=True)]),
        ("Convolved with the PSF", [tinted([light], white) for light in zip(convolved, tints, strict=True)]),
        ("Rows that are open (white)", open_rows),
        ("Let through by the shutter", [tinted([light], white) for light in zip(exposed, tints, strict=True)]),
    ]
    if lens:
        columns.append(("Lens", [tinted([light], white_lens) for light in zip(behind_lens, tints, strict=True)]))
    for (head, shown), axes in zip(columns, top.T, strict=True):
        for number, image in enumerate(shown):
            panel(axes[number], image, "" if number else head)
    for spot, axes in zip(spots, top[:, 0], strict=True):
        _name(axes, f"sample {spot.sample}\n{duration(bench.time_s(spot.sample))}\n({spot.name})")

    measured = [(f"This {shutter_name(bench.shutter).partition(',')[0]}", exposed, white_sum)]
    if not bench.is_global:
        always = [bench.exposed_globally(spot) for spot in spots]
        measured.insert(0, ("Global shutter, open for all of the capture", always, white_sum))
    if lens:
        measured.append(("Lens, this shutter", behind_lens, white_lens))
    ratios = [wide] * (len(measured) - lens) + [scene_wide] * lens
    bottom = figure.add_subfigure(grid[1]).subplots(1, len(measured), squeeze=False, width_ratios=ratios)[0]
    for axes, (head, images, level) in zip(bottom, measured, strict=True):
        panel(axes, tinted(list(zip(images, tints, strict=True)), level), f"Measured: {head[0].lower()}{head[1:]}")
    return figure


def _notes(bench: Bench, ratio: float, lens: bool) -> list[str]:
    notes = [
        f"Spots shine for one of {SAMPLES} time samples of the capture, {duration(bench.duration_s / SAMPLES)} each, at the "
        "farthest depth of the PSF stack. All is computed by the configuration's forward model.",
        "Colours stand for times; the light itself is white. Pictures on the sensor are the channels' mean, sRGB-encoded. "
        "White in the rows above is the level over which 1 % of the spots' light lies,",
        f"white in the measurements is {ratio:.3g} times as much.",
    ]
    if lens:
        notes[-1] += " A lens (a pinhole's PSF) shows the scene alone; its white is that of an open row."
    return notes


def _name(axes: Axes, words: str) -> None:
    axes.set_ylabel(words, rotation=0, ha="right", va="center", fontsize=NORMAL, color=INK, labelpad=8)
