"""A picture of where two PSF stacks differ."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from psf_library.reference.difference import compare_stacks
from simulator.arrays import to_numpy
from simulator.io.files import write_atomic
from simulator.optics.stack import PsfStack
from simulator.text import length


def draw_difference(found: PsfStack, expected: PsfStack, path: Path) -> Path:
    """Draw the plane that differs most: expected, found and their difference, each with its scale, as one PNG.

    Expected and found share one scale with a square-root stretch; the difference is linear about zero. A ring marks the
    pixel that differs most.

    Args:
        found: the stack to judge.
        expected: the stack that it should be.
        path: the picture to write; its folder must exist.

    Returns:
        The path of the picture.

    Raises:
        InputError: when the stacks cannot be compared.
        StorageError: the picture cannot be written.
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
    picture = io.BytesIO()
    figure.savefig(picture, format="png", metadata={"Software": "flatlight"})
    write_atomic(path, picture.getvalue())
    return path
