"""A contact sheet of clips: each one's radiance, depth and extras side by side, all on the same stated scales."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from simulator.preview.drawing import INK, PAPER, depth_range, fitted, font, resized
from simulator.preview.legends import LEGEND_WIDTH, draw_depth_legend, draw_motion_legend, draw_normal_legend
from simulator.preview.tiles import Scales, Tile, common_scales, depth_tile, extra_tiles, radiance_tile
from simulator.types import Clip

if TYPE_CHECKING:
    from PIL import Image

FRAMES_SHOWN = 5
_GAP, _NEXT, _NAME, _CAPTION, _HEAD = 12, 2, 18, 20, 58
_SMALL, _LARGE = 128, 256  # tiles are enlarged by whole numbers up to about the one, and reduced to the other
_ASPECT, _WIDEST = 1.4, 2400
_DEPTH_SCALE = 150  # pixels


@dataclass(frozen=True)
class Cell:
    """What a sheet shows of one clip: tiles side by side and a line of words below them."""

    caption: str
    tiles: Sequence[Tile]


def clip_sheet(
    clips: Sequence[Clip], captions: Sequence[str], title: str, most_frames: int = FRAMES_SHOWN
) -> Image.Image:
    """Draw clips: several frames each where there are several, depth and extras of one of them.

    Args:
        clips: at least one, of one scene shape.
        captions: a few words for each.
        title: first line of the sheet.
        most_frames: of a clip that are shown.

    Returns:
        The sheet; its second line states the scales.
    """
    frames = [shown_frames(len(clip.rgb), most_frames) for clip in clips]
    scales = common_scales(clips, frames, [[_key(shown)] for shown in frames])
    cells = [
        Cell(caption, _tiles(clip, shown, scales)) for clip, caption, shown in zip(clips, captions, frames, strict=True)
    ]
    drawn = {tile.name for cell in cells for tile in cell.tiles}
    return draw_sheet(cells, title, describe_scales(scales, drawn), scales, drawn)


def shown_frames(count: int, most: int = FRAMES_SHOWN) -> list[int]:
    """Return up to ``most`` evenly spaced frames of a clip.

    Example:
        >>> shown_frames(1), shown_frames(20)
        ([0], [0, 5, 10, 14, 19])
    """
    return sorted({int(frame) for frame in np.linspace(0, count - 1, min(count, most)).round()})


def describe_scales(scales: Scales, drawn: set[str]) -> str:
    """Return one line that says what white and the colours stand for."""
    words = f"sRGB, white = radiance {scales.white:.3g}"
    if "albedo" in drawn:
        words += " (albedo: white = 1)"
    if "depth" in drawn:
        words += f"; depth z {depth_range(scales.near_m, scales.far_m)}"
    if "ids" in drawn:
        words += "; ids: a colour per shape"
    return words


def draw_sheet(cells: Sequence[Cell], title: str, line: str, scales: Scales, drawn: set[str]) -> Image.Image:
    """Lay cells out in rows and columns, below two lines of words and beside the legends of what is drawn.

    Args:
        cells: at least one; their tiles have one size.
        title: first line.
        line: second line.
        scales: what colours stand for.
        drawn: names of the tiles.
    """
    from PIL import Image, ImageDraw

    height = _tile_height(cells[0].tiles[0].pixels.shape[0])
    pictures = [[resized(tile.pixels, height) for tile in cell.tiles] for cell in cells]
    wide = max(sum(picture.width + _NEXT for picture in row) for row in pictures) + _GAP
    high = _NAME + height + _CAPTION
    columns = _columns(len(cells), wide, high)
    rows = -(-len(cells) // columns)
    legends = _legends(scales, drawn)
    below = _HEAD + max(rows * high, sum(space for space, _ in legends)) + _GAP
    left = _GAP + columns * wide
    widths = [font(size).getlength(text) for size, text in ((15, title), (12, line))]
    across = max(left + (LEGEND_WIDTH if legends else 0), round(max(widths)) + 2 * _GAP)
    sheet = Image.new("RGB", (across, below), PAPER)
    draw = ImageDraw.Draw(sheet)
    draw.text((_GAP, 8), title, fill=INK, font=font(15))
    draw.text((_GAP, 32), line, fill=INK, font=font(12))
    for number, (cell, row) in enumerate(zip(cells, pictures, strict=True)):
        x, y = _GAP + (number % columns) * wide, _HEAD + (number // columns) * high
        names = [tile.name for tile in cell.tiles]
        above = [tile.name for tile in cells[number - columns].tiles] if number >= columns else []
        for name, picture in zip(names, row, strict=True):
            if names != above:
                draw.text((x, y + 2), fitted(name, 11, picture.width), fill=INK, font=font(11))
            sheet.paste(picture, (x, y + _NAME))
            x += picture.width + _NEXT
        caption = fitted(cell.caption, 11, wide - _GAP)
        draw.text((_GAP + (number % columns) * wide, y + _NAME + height + 2), caption, fill=INK, font=font(11))
    top = _HEAD + _NAME
    for space, legend in legends:
        legend(sheet, draw, left, top)
        top += space
    return sheet


def _tiles(clip: Clip, frames: list[int], scales: Scales) -> list[Tile]:
    key = _key(frames)
    names = [f"frame {frame}" if len(frames) > 1 else "radiance" for frame in frames]
    shown = [radiance_tile(clip, frame, scales, name) for frame, name in zip(frames, names, strict=True)]
    about_key = [depth_tile(clip, key, scales), *extra_tiles(clip, key, scales)]
    return [*shown, *about_key]


def _key(frames: list[int]) -> int:
    """Return the frame whose depth and extras are shown: in the middle, and never the last, which does not move on."""
    return frames[(len(frames) - 1) // 2]


def _tile_height(rows: int) -> int:
    return min(rows * max(1, _SMALL // rows), _LARGE)


def _columns(count: int, wide: int, high: int) -> int:
    """Return how many cells stand side by side, so that the sheet is a little wider than it is high."""
    possible = range(1, max(1, min(count, _WIDEST // wide)) + 1)
    return min(possible, key=lambda columns: abs(np.log(columns * wide / (-(-count // columns) * high * _ASPECT))))


def _legends(scales: Scales, drawn: set[str]) -> list[tuple[int, Callable[[Any, Any, int, int], object]]]:
    """Return the legends that the tiles need, and the height of each."""
    legends: list[tuple[int, Callable[[Any, Any, int, int], object]]] = []
    if "depth" in drawn:
        legends.append(
            (
                _DEPTH_SCALE + 50,
                lambda _, draw, x, y: draw_depth_legend(draw, x, y, _DEPTH_SCALE, scales.near_m, scales.far_m),
            )
        )
    if "normals" in drawn:
        legends.append((124, draw_normal_legend))
    if "motion" in drawn:
        legends.append((150, lambda sheet, draw, x, y: draw_motion_legend(sheet, draw, x, y, scales.motion_px or 1.0)))
    return legends
