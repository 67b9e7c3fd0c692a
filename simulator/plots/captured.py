"""Nominal and captured PSFs side by side: how much they differ at each depth, in numbers and as an image."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import to_numpy
from simulator.errors import InputError
from simulator.io.files import write_atomic
from simulator.optics.registration import registration_shift
from simulator.optics.stack import PsfStack
from simulator.plots.drawing import figure_png, new_figure
from simulator.plots.psf import FAINT, INK, SMALL, DepthView, draw_psfs, shown_depths
from simulator.text import length, share

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True)
class DepthDifference:
    """What a calibration changed at one depth.

    Attributes:
        depth_m: stated depth, metres.
        relative_l2: norm of the difference by the norm of the nominal PSF, over all channels.
        shift_px: how far the captured PSF lies from the nominal one, x and y, pixels (by registration).
        energy_ratio: light of the captured PSF by that of the nominal one.
        snr_db: of the recording, against the light that reached the sensor.
    """

    depth_m: float
    relative_l2: float
    shift_px: tuple[float, float]
    energy_ratio: float
    snr_db: float


def captured_differences(nominal: PsfStack, captured: PsfStack) -> list[DepthDifference]:
    """Compare a nominal stack with the same as captured, depth by depth."""
    if captured.provenance.get("nominal_fingerprint") != nominal.fingerprint:
        raise InputError("captured", "not captured from the nominal stack (its provenance names another, or none)")
    records = captured.provenance["recordings"]
    differences = []
    for k, depth in enumerate(nominal.depths_m):
        true, found = (to_numpy(stack.values[k]).astype(np.float64) for stack in (nominal, captured))
        differences.append(
            DepthDifference(
                float(depth),
                float(np.linalg.norm(found - true) / np.linalg.norm(true)),
                registration_shift(true.mean(0), found.mean(0)),
                float(found.sum() / true.sum()),
                records[k]["snr_db"],
            )
        )
    return differences


def describe_captured(nominal: PsfStack, captured: PsfStack) -> str:
    """Return a table of the differences, one line per depth, below what the calibration's light was."""
    lines = [
        f"as captured by {captured.provenance['response']}",
        f"{'depth':>9}  {'error':>9}  {'differs by':>10}  {'shift x, y (px)':>16}  {'light':>7}  {'SNR':>7}",
    ]
    for row, true in zip(captured_differences(nominal, captured), captured.provenance["true_depths_m"], strict=True):
        x, y = row.shift_px
        off = f"{(float(true) - row.depth_m) * 1e3:+.2f} mm" if np.isfinite(row.depth_m) else "-"
        lines.append(
            f"{length(row.depth_m):>9}  {off:>9}  {share(row.relative_l2):>10}  {x:+7.2f}, {y:+7.2f}  "
            f"{share(row.energy_ratio):>7}  {row.snr_db:4.0f} dB"
        )
    return "\n".join(lines)


_COLOURS = {"true": "#0072b2", "captured": "#d55e00"}  # told apart by colour-blind eyes too (Okabe and Ito, 2008)


def plot_captured(nominal: PsfStack, captured: PsfStack, path: Path) -> Path:
    """Draw nominal and captured PSFs and their difference at up to three depths into one PNG.

    The first two rows share one scale; differences are the channels' mean, on one scale of their own.

    Raises:
        InputError: when the second was not captured from the first.
        StorageError: the image cannot be written.
    """
    differences = captured_differences(nominal, captured)
    shown = shown_depths(nominal.depths_m)
    figure = new_figure((4.6 * len(shown) + 1, 13), 120)
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
        image = axes.imshow(change, extent=_extent(change, above), cmap="RdBu_r", vmin=-most, vmax=most)
        axes.set(xlim=above.get_xlim(), ylim=above.get_ylim())
        row = differences[k]
        words = f"difference {share(row.relative_l2)}, shift {row.shift_px[0]:+.2f}, {row.shift_px[1]:+.2f} px"
        axes.set_title(words, loc="left", fontsize=SMALL + 1, color=INK)
        axes.tick_params(labelsize=SMALL, colors=INK)
    bar = figure.colorbar(image, ax=list(panels[2]), location="bottom", shrink=0.5, aspect=50)
    bar.set_label("captured - true, × the light at the mask", fontsize=SMALL, color=INK)
    figure.supxlabel(scale, x=0.99, ha="right", fontsize=SMALL, color=FAINT)
    write_atomic(path, figure_png(figure))
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
