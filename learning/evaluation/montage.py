"""Scenes side by side: the truth and every method's picture and depth, on one white and one scale of depths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.plots.drawing import (
    INK,
    LEGEND_WIDTH,
    PAPER,
    depth_colours,
    draw_depth_legend,
    fitted,
    font,
    png_bytes,
    resized,
)

_TILE, _GAP, _WORDS, _HEAD, _LEGEND = 160, 10, 18, 62, 180  # pixels


@dataclass(frozen=True, eq=False)
class Shown:
    """A scene as one method, or the truth, has it.

    Attributes:
        picture: ``(h, w, 3)`` sRGB codes 0..1.
        depth_m: ``(h, w)``.
        words: a few, such as its scores.
        valid: ``(h, w)``, False where there was no surface; None where all count.
    """

    picture: NDArray[np.floating]
    depth_m: NDArray[np.floating]
    words: str = ""
    valid: NDArray[np.bool_] | None = None


def montage_png(
    columns: Sequence[str],
    scenes: Sequence[Sequence[Shown]],
    title: str,
    line: str,
    near_m: float,
    far_m: float,
) -> bytes:
    """Return the montage as PNG.

    Args:
        columns: what stands above each column, the truth first.
        scenes: one row each; as many entries as columns.
        title: first line.
        line: second line.
        near_m: depth of the first colour.
        far_m: depth of the last.
    """
    from PIL import Image, ImageDraw

    rows, wide = scenes[0][0].picture.shape[:2]
    height = min(max(_TILE // rows, 1) * rows, 256)
    width = max(1, round(wide * height / rows))
    high = 2 * height + 2 + _WORDS + _GAP
    across = _GAP + len(columns) * (width + _GAP) + LEGEND_WIDTH
    across = max(across, round(max(font(15).getlength(title), font(12).getlength(line))) + 2 * _GAP)
    sheet = Image.new("RGB", (across, _HEAD + _WORDS + max(len(scenes) * high, _LEGEND + 40)), PAPER)
    draw = ImageDraw.Draw(sheet)
    draw.text((_GAP, 8), title, fill=INK, font=font(15))
    draw.text((_GAP, 32), line, fill=INK, font=font(12))
    for column, name in enumerate(columns):
        x = _GAP + column * (width + _GAP)
        draw.text((x, _HEAD), fitted(name, 12, width), fill=INK, font=font(12))
        for row, scene in enumerate(scenes):
            y = _HEAD + _WORDS + row * high
            shown = scene[column]
            codes = np.round(np.clip(shown.picture, 0, 1) * 255).astype(np.uint8)
            depth = shown.depth_m.astype(np.float32)
            valid = np.ones_like(depth, dtype=bool) if shown.valid is None else shown.valid
            colours = depth_colours(depth, valid, near_m, far_m)
            sheet.paste(resized(codes, height), (x, y))
            sheet.paste(resized(colours, height), (x, y + height + 2))
            draw.text((x, y + 2 * height + 4), fitted(shown.words, 11, width), fill=INK, font=font(11))
    legend = _GAP + len(columns) * (width + _GAP)
    draw_depth_legend(draw, legend, _HEAD + _WORDS + 8, _LEGEND - 40, near_m, far_m)
    return png_bytes(sheet)
