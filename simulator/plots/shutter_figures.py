"""Figures that show what a camera's shutter and PSFs do to a few flashes of light (figures 2.3 to 2.6 of the thesis)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simulator.colour import linear_to_srgb
from simulator.io.files import write_atomic
from simulator.plots.drawing import centimetres, figure_png, new_figure
from simulator.plots.psf import FAINT, INK, NORMAL, SMALL, TITLE, style
from simulator.plots.shutter_bench import SAMPLES, Bench, Spot, duration, shutter_name

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 110
_OVER_WHITE = 0.01  # share of the light in pixels brighter than white
_LINE_INCH = 0.2

Tinted = tuple[NDArray[np.floating], tuple[float, float, float]]


def white_of(images: Sequence[NDArray[np.floating]]) -> float:
    """Return the value above which pixels hold a hundredth of the light of all the images; 1 where all is black."""
    values = np.sort(np.concatenate([np.ravel(image) for image in images]).astype(np.float64))[::-1]
    light = np.cumsum(values)
    if not light.size or light[-1] <= 0:
        return 1.0
    return float(values[np.searchsorted(light, _OVER_WHITE * light[-1])]) or 1.0


def tinted(images: Sequence[Tinted], white: float) -> NDArray[np.float32]:
    """Return grey images, each in its colour, added up as light and encoded for the screen: sRGB ``(H, W, 3)``."""
    light = sum(np.asarray(grey)[..., None] / white * np.array(colour) for grey, colour in images)
    return linear_to_srgb(np.clip(light, 0, 1))


def sheet(title: str, notes: Sequence[str], size_inch: tuple[float, float]) -> Figure:
    """Return an empty figure with a title above, and notes below in which the scales are stated."""
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    below = (len(notes) * _LINE_INCH + 0.15) / size_inch[1]
    layout = ConstrainedLayoutEngine(w_pad=0.06, h_pad=0.06, rect=(0.01, below, 0.98, 0.99 - below))
    figure = new_figure(size_inch, DPI, layout)
    figure.suptitle(title, x=0.015, ha="left", fontsize=15, fontweight="bold", color=INK)
    for line, note in enumerate(notes):
        away = (len(notes) - line) * _LINE_INCH - 0.1
        figure.text(0.015, away / size_inch[1], note, fontsize=SMALL, color=FAINT, va="bottom", in_layout=False)
    return figure


def panel(axes: Axes, image: NDArray[np.floating], title: str = "", colour: str = INK) -> None:
    """Show sRGB, or grey of 0 to 1, without ticks."""
    axes.imshow(image, cmap="gray", vmin=0, vmax=1, interpolation="antialiased")
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_color(FAINT)
    if title:
        axes.set_title(title, loc="left", fontsize=TITLE, color=colour)


_OPEN, _READ = "#b9c0c5", "#e07b1a"
_FEW_ROWS = 40  # are drawn as bars of their own
_BANDS = 2000  # more rows than an image has pixels are thinned out


def diagram_figure(bench: Bench) -> Figure:
    """Draw rows against time."""
    windows_ms = bench.shutter.windows_s(bench.rows).reshape(-1, 2) * 1e3
    exposures = bench.shutter.exposures_s(bench.rows)
    times = dict.fromkeys([duration(float(exposures.min())), duration(float(exposures.max()))])
    rows = f"{len(windows_ms)} physical rows"
    if bench.shutter.binning > 1:
        rows += f", {bench.shutter.binning} of them to a row of the image"
    notes = [
        f"{rows}; each is open for {' to '.join(times)}; the last one closes after {duration(bench.duration_s)}.",
        "Row 0 is the sensor's top row. The image is rotated by 180 degrees: the sensor's top row is its bottom row.",
    ]
    figure = sheet(shutter_name(bench.shutter).capitalize(), notes, (11, 6.2))
    axes = figure.subplots()
    _draw_rows(axes, windows_ms)
    style(axes, "time from the capture's start (ms)", "physical row of the sensor")
    axes.set_xlim(0, bench.duration_s * 1.02e3)
    axes.set_ylim(len(windows_ms) - 0.5, -0.5)
    axes.set_facecolor("#f6f7f8")
    _image_rows(axes, bench)
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


def _image_rows(axes: Axes, bench: Bench) -> None:
    """Number the image's rows on the right: the last one is the sensor's first."""
    last, binning = bench.rows - 1, bench.shutter.binning
    right = axes.secondary_yaxis(
        "right",
        functions=(
            lambda row: last + 0.5 - np.add(row, 0.5) / binning,
            lambda row: np.subtract(last + 0.5, row) * binning - 0.5,
        ),
    )
    right.set_ylabel("row of the image", fontsize=NORMAL, color=INK)
    right.tick_params(labelsize=SMALL, colors=INK)
    right.spines["right"].set_color(FAINT)


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
    scenes = [bench.scene(spot) for spot in spots]
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
        ("Scene", [tinted([light], 1.0) for light in zip(scenes, tints, strict=True)]),
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
        "Colours stand for times; the light itself is white. Images on the sensor are the channels' mean, sRGB-encoded. "
        "White in the rows above is the level over which 1 % of the spots' light lies,",
        f"white in the measurements is {ratio:.3g} times as much.",
    ]
    if lens:
        notes[-1] += " A lens (a pinhole's PSF) shows the scene alone; its white is that of an open row."
    return notes


def _name(axes: Axes, words: str) -> None:
    axes.set_ylabel(words, rotation=0, ha="right", va="center", fontsize=NORMAL, color=INK, labelpad=8)


_NEAR_FAR = ((1.0, 0.1, 0.85), (1.0, 0.85, 0.1))  # magenta near, yellow far
_HEX, _NAMES = ("#d613b5", "#b58900"), ("magenta", "yellow")
_PLACES = ((0.5, 0.3), (0.5, 0.7))  # row, column in the scene


def depth_figure(bench: Bench) -> Figure:
    """Draw where the points are, the PSF of each, and their measurement; for a stack of several depths."""
    depths_m = [float(depth) for depth in bench.ends.depths_m]
    images = [bench.point(*place, depth) for place, depth in zip(_PLACES, depths_m, strict=True)]
    white = white_of(images)
    said = " and ".join(f"{centimetres(depth)} ({name})" for depth, name in zip(depths_m, _NAMES, strict=True))
    notes = [
        f"Points of one scene pixel at {said}, as the configuration's forward model exposes them under its shutter.",
        "Colours stand for depths; the light itself is white. Sensor images are the channels' mean on one scale: white "
        "is the level above which 1 % of the light lies; sRGB-encoded.",
    ]
    figure = sheet("PSFs grow as points come near", notes, (13.5, 9.2))
    top, bottom = figure.subplots(2, 2)
    _draw_camera(top[0], depths_m)
    both = list(zip(images, _NEAR_FAR, strict=True))
    panel(top[1], tinted(both, white), "Measurement: both add up")
    for axes, depth, part, colour, name in zip(bottom, depths_m, both, _HEX, _NAMES, strict=True):
        panel(axes, tinted([part], white), f"Point at {centimetres(depth)} alone ({name})", colour)
    return figure


def _draw_camera(axes: Axes, depths_m: list[float]) -> None:
    """Draw points, mask and sensor from the side, with the edges of the mask's shadows; not to scale."""
    mask, sensor = 0.0, -1.6
    axes.set_title("Camera from the side (not to scale)", loc="left", fontsize=TITLE, color=INK)
    for (along, across), depth, colour in zip(((5.0, 1.3), (11.0, -1.6)), depths_m, _HEX, strict=True):
        ends = []
        for edge in (-1.0, 1.0):
            end = edge + (edge - across) * (mask - sensor) / along
            axes.plot([along, mask, sensor], [across, edge, end], color=colour, linewidth=1.4, alpha=0.8)
            ends.append(end)
        axes.plot([sensor] * 2, ends, color=colour, linewidth=6, alpha=0.6, solid_capstyle="butt")
        axes.plot(along, across, "o", color=colour, markersize=10)
        axes.annotate(
            centimetres(depth), (along, across), (0, 12), textcoords="offset points", ha="center", color=colour
        )
    axes.plot([mask, mask], [-1, 1], color=INK, linewidth=4, linestyle=(0, (1.2, 0.5)))
    axes.plot([sensor, sensor], [-2.6, 2.6], color=FAINT, linewidth=1.5)
    for place, words in ((mask, "mask"), (sensor, "sensor")):
        axes.text(place, -3.0, words, ha="center", va="top", fontsize=NORMAL, color=INK)
    axes.set_xlim(-2.8, 12.5)
    axes.set_ylim(-3.7, 3.2)
    axes.set_axis_off()


Draw = Callable[[Bench], "Figure"]


def figures_of(bench: Bench) -> dict[str, Draw]:
    """Return what draws each figure, by file name; a stack of one depth has no two depths to show."""
    figures: dict[str, Draw] = {
        "shutter_diagram.png": diagram_figure,
        "flashes_along_the_columns.png": along_figure,
        "flashes_along_the_rows.png": across_figure,
    }
    return figures if len(bench.ends.depths_m) == 1 else figures | {"points_at_two_depths.png": depth_figure}


def draw_figures(bench: Bench, folder: Path) -> list[Path]:
    """Draw all figures and return their paths; the folder is made where it is missing.

    Raises:
        StorageError: an image cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    figures = figures_of(bench)
    for name, draw in figures.items():
        write_atomic(folder / name, figure_png(draw(bench)))
    return [folder / name for name in figures]
