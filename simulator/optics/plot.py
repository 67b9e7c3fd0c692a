"""One picture of a PSF stack: mask, PSFs near to far, cross-sections, autocorrelation, MTF and the numbers behind them."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from simulator.arrays import to_numpy
from simulator.io.files import write_atomic
from simulator.optics.facts import psf_facts
from simulator.optics.mask import Mask
from simulator.optics.plot_panels import (
    FAINT,
    INK,
    SMALL,
    TITLE,
    DepthView,
    draw_autocorrelation,
    draw_mask,
    draw_mtf,
    draw_psfs,
    draw_sections,
)
from simulator.optics.psf_stack import PsfStack
from simulator.text import length

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
        path: the picture to write; its folder must exist.
        scene_shape: h, w of the scene; with ``sensor_shape`` the light that misses the sensor is told.
        sensor_shape: H, W of the (binned) sensor.

    Returns:
        The path of the picture.

    Raises:
        InputError: when scene and sensor do not fit.
        StorageError: the picture cannot be written.
    """
    picture = io.BytesIO()
    psf_figure(stack, mask, scene_shape, sensor_shape).savefig(
        picture, format="png", metadata={"Software": "flatlight"}
    )
    write_atomic(path, picture.getvalue())
    return path


def psf_figure(
    stack: PsfStack,
    mask: Mask | None,
    scene_shape: tuple[int, int] | None = None,
    sensor_shape: tuple[int, int] | None = None,
) -> Figure:
    """Return the figure of ``plot_psf_stack``, for those who want another format; pyplot is not involved."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    views = _views(stack)
    facts = psf_facts(stack, mask, scene_shape, sensor_shape)
    layout = ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.08)
    figure = Figure(figsize=SIZE_INCH, dpi=DPI, facecolor="white", layout=layout)
    FigureCanvasAgg(figure)
    figure.suptitle(_title(stack, mask), x=0.012, ha="left", fontsize=16, fontweight="bold", color=INK)
    grid = figure.add_gridspec(2, 1, height_ratios=[1.1, 1])
    upper, lower = figure.add_subfigure(grid[0]), figure.add_subfigure(grid[1])
    facts_above = len(views) < 3  # fewer pictures leave room beside them
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
