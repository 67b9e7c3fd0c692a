"""What the figures share: a sheet, panels with titles, light on one stated scale."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simulator.colour import linear_to_srgb
from simulator.io.files import write_atomic
from simulator.optics.plot_panels import FAINT, INK, SMALL, TITLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DPI = 110
_OVER_WHITE = 0.01  # share of the light in pixels brighter than white
_LINE_INCH = 0.2

Tinted = tuple[NDArray[np.floating], tuple[float, float, float]]


def white_of(pictures: Sequence[NDArray[np.floating]]) -> float:
    """Return the value above which pixels hold a hundredth of the light of all the pictures; 1 where all is black."""
    values = np.sort(np.concatenate([np.ravel(picture) for picture in pictures]).astype(np.float64))[::-1]
    light = np.cumsum(values)
    if not light.size or light[-1] <= 0:
        return 1.0
    return float(values[np.searchsorted(light, _OVER_WHITE * light[-1])]) or 1.0


def tinted(pictures: Sequence[Tinted], white: float) -> NDArray[np.float32]:
    """Return grey pictures, each in its colour, added up as light and encoded for the screen: sRGB ``(H, W, 3)``."""
    light = sum(np.asarray(grey)[..., None] / white * np.array(colour) for grey, colour in pictures)
    return linear_to_srgb(np.clip(light, 0, 1))


def sheet(title: str, notes: Sequence[str], size_inch: tuple[float, float]) -> Figure:
    """Return an empty figure with a title above, and notes below in which the scales are stated."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    below = (len(notes) * _LINE_INCH + 0.15) / size_inch[1]
    layout = ConstrainedLayoutEngine(w_pad=0.06, h_pad=0.06, rect=(0.01, below, 0.98, 0.99 - below))
    figure = Figure(figsize=size_inch, dpi=DPI, facecolor="white", layout=layout)
    FigureCanvasAgg(figure)
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


def save(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG, at once or not at all."""
    picture = io.BytesIO()
    figure.savefig(picture, format="png", metadata={"Software": "flatlight"})
    write_atomic(path, picture.getvalue())
    return path
