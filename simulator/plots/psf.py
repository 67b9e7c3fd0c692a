"""One image of a PSF stack: mask, PSFs near to far, cross-sections, autocorrelation, MTF and the numbers behind them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import to_numpy
from simulator.io.files import write_atomic
from simulator.optics.mask import Mask
from simulator.optics.metrics import autocorrelation, radial_mtf
from simulator.optics.stack import PsfStack
from simulator.plots.drawing import figure_png, new_figure
from simulator.plots.psf_facts import budget_facts, psf_facts
from simulator.text import length

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

INK, FAINT, GRID = "#1c2226", "#6b747b", "#e3e6e8"
SMALL, NORMAL, TITLE = 9.0, 10.0, 12.0
# Line widths near to far, by the number of depths: equal curves stay visible under each other.
_WIDTHS = {1: (1.8,), 2: (3.0, 1.3), 3: (3.2, 2.0, 1.0)}
_SHOWN_LIGHT, _MARGIN = 0.98, 1.15  # the PSF window holds this share of the light at every depth, and some more
_WHITE_SHARE = 0.01  # pixels brighter than white hold this share of the light
_FINE = 100  # mask pixels in the magnified corner


@dataclass(frozen=True)
class DepthView:
    """One depth as it is drawn.

    Attributes:
        name: the depth in words.
        colour: of its lines and title.
        psf: ``(C, H, W)``.
        grey: the channels' mean, ``(H, W)``.
        channels: their names; R, G, B are shown in colour.
    """

    name: str
    colour: str
    psf: NDArray[np.float64]
    grey: NDArray[np.float64]
    channels: tuple[str, ...]


def draw_mask(axes: Axes, mask: Mask | None) -> None:
    """Draw the height map, or the amplitude where the height is flat, with a magnified corner for fine staircases."""
    if mask is None:
        head(axes, "Mask")
        axes.set_axis_off()
        words = "no mask:\nthese PSFs were measured"
        axes.text(0.5, 0.5, words, ha="center", va="center", fontsize=TITLE, color=FAINT, linespacing=1.6)
        return
    height, amplitude = to_numpy(mask.height_m), to_numpy(mask.amplitude)
    has_height = bool(np.ptp(height[amplitude > 0]) > 0)
    image = np.where(amplitude > 0, height * 1e6, np.nan) if has_height else amplitude
    colours: dict[str, Any] = {"cmap": "viridis" if has_height else "gray"}
    colours |= {"vmin": np.nanmin(image), "vmax": np.nanmax(image)} if has_height else {"vmin": 0, "vmax": 1}
    per_metre, unit = _unit(max(mask.shape) * mask.pitch_m)
    extent = _extent(-mask.shape[0] / 2, -mask.shape[1] / 2, mask.shape, mask.pitch_m * per_metre)
    drawn = axes.imshow(image, extent=extent, **colours)
    head(axes, "Mask height" if has_height else "Mask amplitude")
    style(axes, f"x on the mask ({unit})", f"y ({unit})")
    _few_ticks(axes)
    if has_height and mask.profile == "staircase" and min(mask.shape) > 4 * _FINE:
        _magnify(axes, image, mask.pitch_m, per_metre, colours)
    bar = axes.figure.colorbar(drawn, ax=axes, location="bottom", shrink=0.75, aspect=32, pad=0.02)
    bar.set_label("height (µm)" if has_height else "amplitude transmission", fontsize=SMALL, color=INK)
    bar.ax.tick_params(labelsize=SMALL, colors=INK)
    bar.outline.set_visible(False)


def _magnify(axes: Axes, image: NDArray[Any], pitch_m: float, per_metre: float, colours: dict[str, Any]) -> None:
    """Show the mask's centre magnified in the lower right corner, and where it lies."""
    rows, columns = ((n - _FINE) // 2 for n in image.shape)
    inset = axes.inset_axes((0.56, 0.0, 0.44, 0.44))
    extent = _extent(-_FINE / 2, -_FINE / 2, (_FINE, _FINE), pitch_m * per_metre)
    inset.imshow(image[rows : rows + _FINE, columns : columns + _FINE], extent=extent, **colours)
    inset.set(xticks=[], yticks=[])
    for spine in inset.spines.values():
        spine.set(edgecolor="white", linewidth=1.6)
    label = {"boxstyle": "round,pad=0.25", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}
    words = f"{_FINE * pitch_m * 1e6:.0f} µm"
    inset.text(0.04, 0.04, words, transform=inset.transAxes, fontsize=SMALL, color=INK, va="bottom", bbox=label)
    axes.indicate_inset(inset_ax=inset, edgecolor="white", linewidth=1.2, alpha=1)


def draw_psfs(panels: list[Axes], views: list[DepthView], pitch_m: float) -> str:
    """Draw the PSFs side by side, one window and one scale for all, and return the scale in words."""
    half, white = _window(views), psf_white([view.psf for view in views])
    per_metre, unit = _unit(2 * half * pitch_m)
    for axes, view in zip(panels, views, strict=True):
        middle = [n // 2 for n in view.grey.shape]
        rows, columns = (slice(max(m - half, 0), m + half + 1) for m in middle)
        shown = np.sqrt(np.clip(view.psf[:, rows, columns] / white, 0, 1))
        in_colour = view.channels == ("R", "G", "B")
        image = np.moveaxis(shown, 0, -1) if in_colour else shown.mean(0)
        top, left = (part.start - m for part, m in zip((rows, columns), middle, strict=True))
        extent = _extent(top - 0.5, left - 0.5, image.shape, pitch_m * per_metre)
        axes.imshow(image, extent=extent, cmap="gray", vmin=0, vmax=1)
        head(axes, f"PSF at {view.name}", view.colour)
        style(axes, f"x on the sensor ({unit})", f"y ({unit})" if axes is panels[0] else "")
        _few_ticks(axes)
    return f"PSFs on one scale: white is {_number(white)} × the light at the mask, square-root stretch"


def draw_sections(axes: Axes, views: list[DepthView], pitch_m: float) -> None:
    """Draw the row through the brightest pixel of each depth, one strip per depth, all of one height."""
    half = _window(views)
    sections = [view.grey[np.unravel_index(np.argmax(view.grey), view.grey.shape)[0]] for view in views]
    highest = max(section.max() for section in sections)
    per_metre, unit = _unit(2 * half * pitch_m)
    bases = [(len(views) - 1 - strip) * 1.3 * highest for strip in range(len(views))]
    head(axes, "Brightest row of each PSF")
    style(axes, f"x on the sensor ({unit})", "light / light at the mask")
    for view, section, base in zip(views, sections, bases, strict=True):
        x = np.arange(section.size) - section.size // 2
        seen = np.abs(x) <= half
        edges = (np.append(x[seen], x[seen][-1] + 1) - 0.5) * pitch_m * per_metre
        axes.stairs(section[seen] + base, edges, baseline=base, fill=True, color=view.colour, alpha=0.25)
        axes.stairs(section[seen] + base, edges, baseline=base, color=view.colour, linewidth=1.0)
        axes.set_xlim(edges[0], edges[-1])
    axes.set_ylim(0, bases[0] + 1.15 * highest)
    axes.set_yticks([b + part * highest for b in bases for part in (0, 1)], ["0", _number(highest)] * len(bases))


_CURVES_SHARE = 0.6  # of the panel's height, for a curve that may be 1 anywhere; its image has the rest


def draw_autocorrelation(axes: Axes, views: list[DepthView], pitch_m: float) -> None:
    """Draw the autocorrelation along rows from one pixel on, and above the curves its middle as a small image."""
    images = [autocorrelation(view.grey) for view in views]
    for view, image, width in zip(views, images, _WIDTHS[len(views)], strict=True):
        row = image[image.shape[0] // 2, image.shape[1] // 2 :]
        axes.plot(np.arange(1, row.size) * pitch_m * 1e6, row[1:], color=view.colour, linewidth=width)
    head(axes, "Autocorrelation")
    style(axes, "shift along a row (µm), from one pixel", "")
    axes.set_xscale("log")
    axes.set_xlim(pitch_m * 1e6, 2 * _window(views) * pitch_m * 1e6)
    axes.set_ylim(0, 1 / _CURVES_SHARE)
    axes.set_yticks(np.linspace(0, 1, 6))
    axes.spines["left"].set_bounds(0, 1)
    _plain_numbers(axes.xaxis, (1, 2, 5))
    inset = axes.inset_axes((0.55, _CURVES_SHARE + 0.09, 0.45, 0.91 - _CURVES_SHARE))
    inset.set_anchor("NE")
    half = min(20, *(n // 2 for n in images[-1].shape))
    rows, columns = (slice(n // 2 - half, n // 2 + half + 1) for n in images[-1].shape)
    inset.imshow(images[-1][rows, columns], cmap="magma", vmin=0, vmax=1)
    inset.set(xticks=[], yticks=[])
    inset.set_xlabel(f"{views[-1].name}, ± {half} pixels", fontsize=SMALL, color=INK)


def draw_mtf(axes: Axes, views: list[DepthView], pitch_m: float) -> None:
    """Draw the radially averaged MTF up to Nyquist, in cycles per millimetre and per scene pixel."""
    lowest = 1.0
    for view, width in zip(views, _WIDTHS[len(views)], strict=True):
        frequency, mtf = radial_mtf(view.grey, pitch_m)
        axes.plot(frequency / 1e3, mtf, color=view.colour, linewidth=width, label=view.name)
        lowest = min(lowest, float(mtf.min()))
    head(axes, "MTF, mean over directions")
    style(axes, "cycles per mm on the sensor, up to Nyquist", "")
    axes.set_yscale("log")
    decades = min(np.floor(np.log10(max(lowest, 1e-4))), -1)
    axes.set_ylim(10**decades, 1.3)
    axes.set_xlim(0, 0.5 / pitch_m / 1e3)
    _plain_numbers(axes.yaxis, (1, 2, 5) if decades == -1 else (1,))
    per_pixel = 1e3 * pitch_m
    below = axes.secondary_xaxis(
        -0.19, functions=(lambda f: np.multiply(f, per_pixel), lambda f: np.divide(f, per_pixel))
    )
    below.set_xlabel("cycles per scene pixel", fontsize=NORMAL, color=INK)
    below.tick_params(labelsize=SMALL, colors=INK)
    below.spines["bottom"].set_color(FAINT)
    if len(views) > 1:
        axes.legend(frameon=False, fontsize=NORMAL, labelcolor=INK, title="depth", loc="upper right")


def head(axes: Axes, words: str, colour: str = INK) -> None:
    """Give a panel its title."""
    axes.set_title(words, loc="left", fontsize=TITLE, color=colour, fontweight="bold")


def style(axes: Axes, x_label: str, y_label: str) -> None:
    """Label a panel's axes, and leave out the frame's upper and right side."""
    axes.set_xlabel(x_label, fontsize=NORMAL, color=INK)
    axes.set_ylabel(y_label, fontsize=NORMAL, color=INK)
    axes.tick_params(labelsize=SMALL, colors=INK)
    for side, spine in axes.spines.items():
        spine.set_color(FAINT)
        spine.set_visible(side in ("left", "bottom"))


def _window(views: list[DepthView]) -> int:
    """Return the half-width in pixels, about the origin, that holds nearly all the light of every depth."""
    half = 8
    for view in views:
        y, x = (np.abs(np.arange(n) - n // 2) for n in view.grey.shape)
        away = np.maximum(y[:, None], x[None, :])
        light = np.cumsum(np.bincount(away.ravel(), view.grey.ravel()))
        half = max(half, round(_MARGIN * int(np.searchsorted(light, _SHOWN_LIGHT * light[-1]))) + 2)
    return half


def psf_white(psfs: Sequence[NDArray[np.floating]]) -> float:
    """Return the value above which pixels hold a hundredth of the light: a lone hot pixel does not darken the rest."""
    values = np.sort(np.concatenate([psf.ravel() for psf in psfs]))[::-1]
    light = np.cumsum(values, dtype=np.float64)
    return float(values[np.searchsorted(light, _WHITE_SHARE * light[-1])])


def _number(value: float) -> str:
    return f"{value:.2g}" if value < 100 else f"{value:.0f}"


def _extent(top: float, left: float, shape: tuple[int, ...], scale: float) -> tuple[float, float, float, float]:
    """Return matplotlib's left, right, bottom, top of an image whose corner lies at (top, left) pixels; rows go down."""
    return left * scale, (left + shape[1]) * scale, (top + shape[0]) * scale, top * scale


def _few_ticks(axes: Axes) -> None:
    axes.locator_params(nbins=6)
    axes.set_anchor("N")


def _plain_numbers(axis: Axis, steps: tuple[int, ...]) -> None:
    """Label a logarithmic axis as plain numbers at these steps of every decade, and nowhere else."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(LogLocator(subs=steps))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def _unit(span_m: float) -> tuple[float, str]:
    """Return how many per metre, and the name, of the unit for an axis of this span."""
    return (1e3, "mm") if span_m >= 0.2e-3 else (1e6, "µm")


SIZE_INCH, DPI = (16.0, 9.0), 150
# Near, middle, far: told apart by colour-blind eyes too (Okabe and Ito, 2008).
_COLOURS = ("#d55e00", "#009e73", "#0072b2")
_LINE_POINTS, _VALUE_POINTS = 12.0, 96.0  # of the list of facts


def plot_psf_stack(
    stack: PsfStack,
    mask: Mask | None,
    path: Path,
    scene_shape: tuple[int, int] | None = None,
    sensor_shape: tuple[int, int] | None = None,
) -> Path:
    """Draw a stack into one PNG of 2400 x 1350 pixels.

    All PSFs share one stated scale and a square-root stretch; cross-sections and autocorrelations are along rows, MTFs
    are averaged over rings, all three of the channels' mean.

    Args:
        stack: the PSFs; the nearest, the middle (in disparity) and the farthest depth are shown.
        mask: the mask that made them; None for a measured stack.
        path: the image to write; its folder must exist.
        scene_shape: h, w of the scene; with ``sensor_shape`` the light that misses the sensor is told.
        sensor_shape: H, W of the (binned) sensor.

    Returns:
        The path of the image.

    Raises:
        StorageError: the image cannot be written.
    """
    write_atomic(path, figure_png(psf_figure(stack, mask, scene_shape, sensor_shape)))
    return path


def psf_figure(
    stack: PsfStack,
    mask: Mask | None,
    scene_shape: tuple[int, int] | None = None,
    sensor_shape: tuple[int, int] | None = None,
) -> Figure:
    """Return the figure of ``plot_psf_stack``, for those who want another format; pyplot is not involved."""
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    views = _views(stack)
    facts = psf_facts(stack, mask, scene_shape, sensor_shape) + budget_facts(stack)
    layout = ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.08)
    figure = new_figure(SIZE_INCH, DPI, layout)
    figure.suptitle(_title(stack, mask), x=0.012, ha="left", fontsize=16, fontweight="bold", color=INK)
    grid = figure.add_gridspec(2, 1, height_ratios=[1.1, 1])
    upper, lower = figure.add_subfigure(grid[0]), figure.add_subfigure(grid[1])
    facts_above = len(views) < 3  # fewer panels leave room beside them
    top = upper.subplots(1, 1 + len(views) + facts_above, squeeze=False)[0]
    bottom = lower.subplots(1, 4 - facts_above, squeeze=False)[0]
    draw_mask(top[0], mask)
    scale = draw_psfs(list(top[1 : 1 + len(views)]), views, stack.pixel_pitch_m)
    upper.supxlabel(scale, x=0.99, ha="right", fontsize=SMALL, color=FAINT)
    draw_sections(bottom[0], views, stack.pixel_pitch_m)
    draw_autocorrelation(bottom[1], views, stack.pixel_pitch_m)
    draw_mtf(bottom[2], views, stack.pixel_pitch_m)
    _draw_facts(top[-1] if facts_above else bottom[-1], facts, 40 if len(views) == 1 else 28)
    return figure


def shown_depths(depths_m: np.ndarray) -> list[int]:
    """Return the indices of the nearest, the middle and the farthest depth, fewer when there are fewer.

    The middle is taken in disparity (1/z), in which PSFs change evenly.

    Example:
        >>> shown_depths(np.array([0.1, 0.15, 0.2, 0.5, np.inf]))
        [0, 2, 4]
    """
    disparity = 1 / np.asarray(depths_m, np.float64)
    last = disparity.size - 1
    if last < 2:
        return list(range(last + 1))
    middle = 1 + int(np.argmin(np.abs(disparity[1:-1] - (disparity[0] + disparity[-1]) / 2)))
    return [0, middle, last]


def _views(stack: PsfStack) -> list[DepthView]:
    values = to_numpy(stack.values)
    views = []
    for k, colour in zip(shown_depths(stack.depths_m), _COLOURS, strict=False):
        psf = values[k].astype(np.float64)
        views.append(DepthView(length(stack.depths_m[k]), colour, psf, psf.mean(0), stack.channels))
    return views


def _title(stack: PsfStack, mask: Mask | None) -> str:
    record = stack.provenance.get("mask")
    name = mask.name if mask is not None else record["name"] if record else f"{stack.provenance.get('kind', '')} PSF"
    parts = [name.strip()]
    if "mask_to_sensor_m" in stack.provenance:
        parts.append(f"{length(stack.provenance['mask_to_sensor_m'])} from the sensor")
    parts.append(f"{length(stack.pixel_pitch_m)} pixels")
    return "  ·  ".join(parts)


def _draw_facts(axes: Axes, facts: list[tuple[str, str]], characters: int) -> None:
    """Write the facts as two columns; a value of more characters goes on in the next line."""
    import textwrap

    axes.set_axis_off()
    axes.set_title("Numbers", loc="left", fontsize=TITLE, color=INK, fontweight="bold")
    lines = []
    for what, value in facts:
        first, *more = textwrap.wrap(value, characters)
        lines += [(what, first), *(("", part) for part in more)]
    for line, (what, value) in enumerate(lines):
        for words, right, colour in ((what, 0.0, FAINT), (value, _VALUE_POINTS, INK)):
            text = axes.annotate(
                words,
                (0, 1),
                (right, -line * _LINE_POINTS),
                xycoords="axes fraction",
                textcoords="offset points",
                va="top",
                fontsize=SMALL,
                color=colour,
            )
            text.set_in_layout(False)
