"""What the colours of a picture mean: a scale of depths, a ball for normals, a wheel for motion."""

from __future__ import annotations

from typing import Any

import numpy as np

from simulator.preview.colours import depth_colours, motion_colours, normal_colours
from simulator.preview.drawing import INK, PAPER, UNSEEN, centimetres, font

LEGEND_WIDTH = 96
_DISC = 72  # pixels across


def draw_depth_legend(draw: Any, left: int, top: int, height: int, near_m: float, far_m: float) -> None:
    """Draw the scale of `depth_colours` with five depths (one where all are alike), and grey for what is not seen below it.

    Args:
        draw: Pillow's ImageDraw.
        left: pixels.
        top: pixels.
        height: pixels of the scale; the grey takes 24 more.
        near_m: depth of the first colour.
        far_m: depth of the last.
    """
    width = 16
    steps = (1 / np.linspace(1 / near_m, 1 / far_m, height))[:, None].astype(np.float32)
    for row, colour in enumerate(depth_colours(steps, np.ones_like(steps, dtype=bool), near_m, far_m)[:, 0]):
        draw.line([(left, top + row), (left + width, top + row)], fill=tuple(colour.tolist()))
    for share in (0.0, 0.25, 0.5, 0.75, 1.0) if far_m > near_m else (0.5,):
        depth_m = 1 / ((1 - share) / near_m + share / far_m)
        place = (left + width + 6, top + share * (height - 1))
        draw.text(place, centimetres(depth_m), fill=INK, font=font(12), anchor="lm")
    draw.rectangle([(left, top + height + 8), (left + width, top + height + 24)], fill=UNSEEN)
    draw.text((left + width + 6, top + height + 16), "no surface", fill=INK, font=font(12), anchor="lm")


def draw_normal_legend(sheet: Any, draw: Any, left: int, top: int) -> int:
    """Draw a ball in the colours of `normal_colours`; returns where it ends."""
    x, y, inside = _disc()
    towards = -np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    normals = np.stack([x, y, towards], axis=-1).astype(np.float32)
    return _draw_disc(sheet, draw, left, top, normal_colours(normals), inside, ("normals:", "as on a ball"))


def draw_motion_legend(sheet: Any, draw: Any, left: int, top: int, largest_px: float) -> int:
    """Draw the wheel of `motion_colours` with the speed at its rim; returns where it ends."""
    x, y, inside = _disc()
    motion = np.stack([x, y], axis=-1).astype(np.float32) * np.float32(largest_px)
    colours = motion_colours(motion, inside, inside, largest_px * (1 + 1e-6))
    words = ("motion: at rim", f"{largest_px:.3g} px/frame", "dark: not in", "the next frame")
    return _draw_disc(sheet, draw, left, top, colours, inside, words)


def _disc() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    steps = (np.arange(_DISC) + 0.5) * 2 / _DISC - 1
    x, y = np.meshgrid(steps, steps)
    return x, y, np.hypot(x, y) <= 1


def _draw_disc(
    sheet: Any, draw: Any, left: int, top: int, colours: np.ndarray, inside: np.ndarray, words: tuple[str, ...]
) -> int:
    from PIL import Image

    picture = np.where(inside[..., None], colours, np.array(PAPER, np.uint8)).astype(np.uint8)
    sheet.paste(Image.fromarray(picture), (left, top))
    for line, text in enumerate(words):
        draw.text((left, top + _DISC + 4 + 14 * line), text, fill=INK, font=font(12))
    return top + _DISC + 4 + 14 * len(words)
