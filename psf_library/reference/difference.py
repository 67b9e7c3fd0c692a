"""Where two PSF stacks differ, by how much, and an image of it."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import to_numpy
from simulator.errors import InputError
from simulator.io.files import write_atomic
from simulator.optics.stack import PsfStack
from simulator.text import length


@dataclass(frozen=True)
class StackDifference:
    """How far one stack lies from another.

    Attributes:
        relative_l2: ``(K, C)``: ||found - expected|| / ||expected|| of each depth and channel.
        worst_pixel: depth, channel, row and column of the greatest absolute difference in the plane that is farthest off.
        found: the value there.
        expected: the value that was to be there.
        depths_m: ``(K,)`` metres.
        channels: their names.
    """

    relative_l2: NDArray[np.float64]
    worst_pixel: tuple[int, int, int, int]
    found: float
    expected: float
    depths_m: NDArray[np.float64]
    channels: tuple[str, ...]

    @property
    def error(self) -> float:
        """The greatest relative L2 difference of any plane."""
        return float(self.relative_l2.max())

    def __str__(self) -> str:
        k, c, row, column = self.worst_pixel
        lines = [
            f"worst plane: depth {length(self.depths_m[k])}, channel {self.channels[c]}, relative L2 {self.error:.3g}",
            f"worst pixel: row {row}, column {column}: found {self.found:.9g}, expected {self.expected:.9g}",
            f"relative L2  {'  '.join(f'{name:>9}' for name in self.channels)}",
        ]
        for depth_m, errors in zip(self.depths_m, self.relative_l2, strict=True):
            lines.append(f"{length(depth_m):>11}  {'  '.join(f'{error:9.3g}' for error in errors)}")
        return "\n".join(lines)


def compare_stacks(found: PsfStack, expected: PsfStack) -> StackDifference:
    """Compare a stack with the one that it should be, of the same depths, channels and pixels.

    Raises:
        InputError: when their sizes, pixel pitches, channels or depths differ, so that no pixel has a counterpart.

    Example:
        >>> stack = PsfStack(np.ones((1, 1, 2, 2)), np.array([0.1]), 1e-5, ("G",), "")
        >>> brighter = PsfStack(stack.values * 1.01, stack.depths_m, 1e-5, ("G",), "")
        >>> round(compare_stacks(brighter, stack).error, 6)
        0.01
    """
    for what, one, other in (
        ("size (K, C, H, W)", tuple(found.values.shape), tuple(expected.values.shape)),
        ("channels", found.channels, expected.channels),
        ("pixel pitch (m)", found.pixel_pitch_m, expected.pixel_pitch_m),
        ("depths (m)", found.depths_m.tolist(), expected.depths_m.tolist()),
    ):
        if one != other:
            raise InputError(what, f"got {one}, expected {other}: such stacks have no common pixels to compare")
    values, wanted = (to_numpy(stack.values).astype(np.float64) for stack in (found, expected))
    # A stack refuses planes that are zero everywhere, so nothing is divided by zero.
    relative = np.linalg.norm(values - wanted, axis=(-2, -1)) / np.linalg.norm(wanted, axis=(-2, -1))
    k, c = (int(i) for i in np.unravel_index(np.argmax(relative), relative.shape))
    away = np.abs(values[k, c] - wanted[k, c])
    row, column = (int(i) for i in np.unravel_index(np.argmax(away), away.shape))
    return StackDifference(
        relative,
        (k, c, row, column),
        float(values[k, c, row, column]),
        float(wanted[k, c, row, column]),
        np.asarray(expected.depths_m),
        expected.channels,
    )


def draw_difference(found: PsfStack, expected: PsfStack, path: Path) -> Path:
    """Draw the plane that differs most as one PNG, and return its path: expected, found and difference, each with its scale.

    Expected and found share one scale with a square-root stretch; the difference is linear about zero. A ring marks the
    pixel that differs most. The folder must exist.

    Raises:
        InputError: when the stacks cannot be compared.
        StorageError: the image cannot be written.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import PowerNorm
    from matplotlib.figure import Figure

    difference = compare_stacks(found, expected)
    k, c, row, column = difference.worst_pixel
    one, other = (to_numpy(stack.values)[k, c].astype(np.float64) for stack in (found, expected))
    white, most = max(one.max(), other.max()), max(float(np.abs(one - other).max()), np.finfo(float).tiny)
    figure = Figure(figsize=(13, 4.6), dpi=110, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(
        f"depth {length(difference.depths_m[k])}, channel {difference.channels[c]}: "
        f"relative L2 difference {difference.error:.3g}",
        x=0.01,
        ha="left",
    )
    light = {"norm": PowerNorm(0.5, 0, white), "cmap": "gray"}
    signed = {"vmin": -most, "vmax": most, "cmap": "RdBu_r"}
    panels = zip(
        figure.subplots(1, 3),
        (("expected", other, light), ("found", one, light), ("found - expected", one - other, signed)),
        strict=True,
    )
    for axes, (title, image, scale) in panels:
        drawn = axes.imshow(image, **scale)
        axes.plot(
            column, row, "o", markersize=14, markerfacecolor="none", markeredgecolor="#009e73", markeredgewidth=1.5
        )
        axes.set(title=title, xlabel="column", ylabel="row")
        figure.colorbar(drawn, ax=axes, shrink=0.85)
    png = io.BytesIO()
    figure.savefig(png, format="png", metadata={"Software": "flatlight"})
    write_atomic(path, png.getvalue())
    return path
