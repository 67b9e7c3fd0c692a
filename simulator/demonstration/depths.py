"""Two points at two depths: their PSFs and what the camera measures of both (figure 2.6 of the thesis)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from simulator.demonstration.bench import Bench
from simulator.demonstration.paper import panel, sheet, tinted, white_of
from simulator.optics.plot_panels import FAINT, INK, NORMAL, TITLE
from simulator.preview.drawing import centimetres

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLOURS = ((1.0, 0.1, 0.85), (1.0, 0.85, 0.1))  # magenta near, yellow far
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
        "Colours stand for depths; the light itself is white. Sensor pictures are the channels' mean on one scale: white "
        "is the level above which 1 % of the light lies; sRGB-encoded.",
    ]
    figure = sheet("PSFs grow as points come near", notes, (13.5, 9.2))
    top, bottom = figure.subplots(2, 2)
    _draw_camera(top[0], depths_m)
    both = list(zip(images, _COLOURS, strict=True))
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
