"""One picture of a calibration: the true PSFs, the captured ones, and their difference."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import to_numpy
from simulator.io.files import write_atomic
from simulator.optics.captured_report import captured_differences
from simulator.optics.plot import shown_depths
from simulator.optics.plot_panels import FAINT, INK, SMALL, DepthView, draw_psfs
from simulator.optics.psf_stack import PsfStack
from simulator.text import length, share

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOURS = {"true": "#0072b2", "captured": "#d55e00"}  # told apart by colour-blind eyes too (Okabe and Ito, 2008)


def plot_captured(nominal: PsfStack, captured: PsfStack, path: Path) -> Path:
    """Draw nominal and captured PSFs and their difference at up to three depths into one PNG.

    The first two rows share one scale; differences are the channels' mean, on one scale of their own.

    Raises:
        InputError: when the second was not captured from the first.
        StorageError: the picture cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    differences = captured_differences(nominal, captured)
    shown = shown_depths(nominal.depths_m)
    figure = Figure(figsize=(4.6 * len(shown) + 1, 13), dpi=120, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(3, len(shown), squeeze=False)
    views = [
        _view(stack, k, f"{length(nominal.depths_m[k])}, {name}", _COLOURS[name])
        for name, stack in (("true", nominal), ("captured", captured))
        for k in shown
    ]
    scale = draw_psfs([*panels[0], *panels[1]], views, nominal.pixel_pitch_m)
    changes = [after.grey - before.grey for before, after in zip(views[: len(shown)], views[len(shown) :], strict=True)]
    most = max(float(np.percentile(np.abs(change), 99.9)) for change in changes)
    for axes, above, change, k in zip(panels[2], panels[1], changes, shown, strict=True):
        picture = axes.imshow(change, extent=_extent(change, above), cmap="RdBu_r", vmin=-most, vmax=most)
        axes.set(xlim=above.get_xlim(), ylim=above.get_ylim())
        row = differences[k]
        words = f"difference {share(row.relative_l2)}, shift {row.shift_px[0]:+.2f}, {row.shift_px[1]:+.2f} px"
        axes.set_title(words, loc="left", fontsize=SMALL + 1, color=INK)
        axes.tick_params(labelsize=SMALL, colors=INK)
    bar = figure.colorbar(picture, ax=list(panels[2]), location="bottom", shrink=0.5, aspect=50)
    bar.set_label("captured - true, × the light at the mask", fontsize=SMALL, color=INK)
    figure.supxlabel(scale, x=0.99, ha="right", fontsize=SMALL, color=FAINT)
    content = io.BytesIO()
    figure.savefig(content, format="png", metadata={"Software": "flatlight"})
    write_atomic(path, content.getvalue())
    return path


def _view(stack: PsfStack, k: int, name: str, colour: str) -> DepthView:
    psf = to_numpy(stack.values)[k].astype(np.float64)
    return DepthView(name, colour, psf, psf.mean(0), stack.channels)


def _extent(image: NDArray[np.float64], above: Axes) -> tuple[float, float, float, float]:
    """Return left, right, bottom, top of a whole grid in the units of the panel above, which shows a part of it."""
    shown: Any = above.get_images()[0]
    left, right, _, _ = shown.get_extent()
    pixel = (right - left) / shown.get_array().shape[1]
    rows, columns = (n // 2 + 0.5 for n in image.shape)
    return -columns * pixel, (image.shape[1] - columns) * pixel, (image.shape[0] - rows) * pixel, -rows * pixel
