"""Contact sheets and animations of clips: radiance, depth and extras side by side, all on the same stated scales."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.plots.drawing import (
    INK,
    LEGEND_WIDTH,
    PAPER,
    animation_webp,
    depth_colours,
    depth_range,
    draw_depth_legend,
    draw_motion_legend,
    draw_normal_legend,
    encoded,
    fitted,
    font,
    id_colours,
    motion_colours,
    normal_colours,
    resized,
    seen_colours,
    white_level,
)
from simulator.types import Clip

if TYPE_CHECKING:
    from PIL import Image

_AT_REST_PX = 0.01
_FAST_PERCENTILE = 98  # of what moves: a finger's tip that flies past the camera must not pale all the rest
_HIDDEN_DEPTH = re.compile(r"hidden(\d+)_depth_m")


@dataclass(frozen=True)
class Tile:
    """A named image, uint8 ``(h, w, 3)``."""

    name: str
    pixels: NDArray[np.uint8]


@dataclass(frozen=True)
class Scales:
    """What white, the first and last depth colour and the full motion colours stand for, in all of a sheet.

    Attributes:
        white: linear radiance.
        near_m: metres.
        far_m: metres.
        motion_px: pixels per frame, 0 where nothing moves.
    """

    white: float
    near_m: float
    far_m: float
    motion_px: float


def common_scales(clips: Sequence[Clip], lit: Sequence[Sequence[int]], coloured: Sequence[Sequence[int]]) -> Scales:
    """Return scales for what is shown of each clip: the radiance of ``lit`` frames, depth and extras of ``coloured`` ones."""
    seen: list[NDArray[np.float32]] = []
    moving = [np.zeros(0, np.float32)]
    for clip, frames in zip(clips, map(list, coloured), strict=True):
        seen.append(clip.depth_m[frames][clip.valid[frames]])
        for name, depth in clip.extras.items():
            if found := _HIDDEN_DEPTH.fullmatch(name):
                seen.append(depth[frames][clip.extras[f"hidden{found[1]}_valid"][frames]])
        if "motion" in clip.extras:
            moved = clip.extras["motion"][frames][clip.valid[frames]]
            speed = np.hypot(moved[:, 0], moved[:, 1])
            moving.append(speed[speed > _AT_REST_PX])
    depths = np.concatenate(seen)
    if depths.size == 0:
        depths = np.concatenate([clip.depth_m.ravel() for clip in clips])
    speeds = np.concatenate(moving)
    return Scales(
        white_level(clip.rgb[list(frames)] for clip, frames in zip(clips, lit, strict=True)),
        float(depths.min()),
        float(depths.max()),
        float(np.percentile(speeds, _FAST_PERCENTILE)) if speeds.size else 0.0,
    )


def radiance_tile(clip: Clip, frame: int, scales: Scales, name: str = "radiance") -> Tile:
    """Return what the scene's light looks like."""
    return Tile(name, encoded(clip.rgb[frame], scales.white))


def depth_tile(clip: Clip, frame: int, scales: Scales) -> Tile:
    """Return the depth in colours."""
    return Tile("depth", depth_colours(clip.depth_m[frame], clip.valid[frame], scales.near_m, scales.far_m))


def extra_tiles(clip: Clip, frame: int, scales: Scales) -> list[Tile]:
    """Return the extras that an image can show, in the order in which rendering names them."""
    extras = {name: values[frame] for name, values in clip.extras.items()}
    tiles: list[Tile] = []
    if "shape_id" in extras:
        tiles.append(Tile("ids", id_colours(extras["shape_id"])))
    if "normal" in extras:
        tiles.append(Tile("normals", normal_colours(extras["normal"])))
    if "albedo" in extras:  # a reflectance: white is 1, whatever the light
        tiles.append(Tile("albedo", encoded(extras["albedo"])))
    if "motion" in extras:
        largest = scales.motion_px or 1.0
        colours = motion_colours(extras["motion"], clip.valid[frame], extras["motion_valid"], largest)
        tiles.append(Tile("motion", colours))
    for name in extras:
        if found := _HIDDEN_DEPTH.fullmatch(name):
            layer = f"hidden{found[1]}"
            valid = extras[f"{layer}_valid"]
            colours = seen_colours(encoded(extras[f"{layer}_rgb"], scales.white), valid)
            tiles.append(Tile(f"hidden {found[1]}", colours))
            depth = depth_colours(extras[name], valid, scales.near_m, scales.far_m)
            tiles.append(Tile(f"depth {found[1]}", depth))
    return tiles


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
    """Lay cells, whose tiles have one size, out below two lines of text and beside the legends of what is drawn."""
    from PIL import Image, ImageDraw

    height = _tile_height(cells[0].tiles[0].pixels.shape[0])
    images = [[resized(tile.pixels, height) for tile in cell.tiles] for cell in cells]
    wide = max(sum(image.width + _NEXT for image in row) for row in images) + _GAP
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
    for number, (cell, row) in enumerate(zip(cells, images, strict=True)):
        x, y = _GAP + (number % columns) * wide, _HEAD + (number // columns) * high
        names = [tile.name for tile in cell.tiles]
        above = [tile.name for tile in cells[number - columns].tiles] if number >= columns else []
        for name, image in zip(names, row, strict=True):
            if names != above:
                draw.text((x, y + 2), fitted(name, 11, image.width), fill=INK, font=font(11))
            sheet.paste(image, (x, y + _NAME))
            x += image.width + _NEXT
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


ANIMATIONS = (".gif", ".webp")
_LOOP_MS, _FASTEST_MS, _SLOWEST_MS = 2500, 50, 250
_TICK_MS = 10  # of GIF


def animation(clips: Sequence[Clip], captions: Sequence[str], title: str, suffix: str) -> bytes:
    """Return clips playing side by side, with the extras that they have.

    Args:
        clips: at least one, of one scene shape; the shorter ones rest on their last frame.
        captions: a few words for each.
        title: first line; the second states white and by how much time is slowed down.
        suffix: ``.gif`` or ``.webp``.

    Raises:
        InputError: no clip has two frames.
    """
    count = max(len(clip.rgb) for clip in clips)
    if count < 2:
        raise InputError("frames", "all scenes are stills, of one frame each; write a contact sheet (.png) instead")
    frames = [range(len(clip.rgb)) for clip in clips]
    scales = common_scales(clips, frames, frames)
    shown_ms = frame_milliseconds(count)
    lasting_s = float(np.mean(np.diff(clips[0].frame_edges_s)))
    slower = f"{1 / lasting_s:.4g} frames/s, shown {shown_ms * 1e-3 / lasting_s:.3g} times slower"
    pages: list[Image.Image] = []
    for frame in range(count):
        cells = []
        for clip, caption in zip(clips, captions, strict=True):
            here = min(frame, len(clip.rgb) - 1)
            cells.append(
                Cell(caption, [radiance_tile(clip, here, scales, f"frame {here}"), *extra_tiles(clip, here, scales)])
            )
        drawn = {tile.name for cell in cells for tile in cell.tiles}
        line = f"{describe_scales(scales, drawn)}; {slower}"
        pages.append(draw_sheet(cells, title, line, scales, drawn))
    if suffix == ".webp":
        return animation_webp(pages, shown_ms)
    stream, (first, *others) = io.BytesIO(), _one_palette(pages)
    first.save(stream, "GIF", save_all=True, append_images=others, duration=shown_ms, loop=0, disposal=1)
    return stream.getvalue()


def frame_milliseconds(count: int) -> int:
    """Return how long each of ``count`` frames is shown.

    Example:
        >>> frame_milliseconds(20), frame_milliseconds(2), frame_milliseconds(600)
        (120, 250, 50)
    """
    return int(np.clip(_LOOP_MS // count // _TICK_MS * _TICK_MS, _FASTEST_MS, _SLOWEST_MS))


def _one_palette(pages: list[Image.Image]) -> list[Image.Image]:
    """Reduce all pages to the same 256 colours: with a palette each, what rests would flicker."""
    from PIL import Image

    some = [pages[number] for number in sorted({*range(0, len(pages), max(1, len(pages) // 8)), len(pages) - 1})]
    strip = Image.new("RGB", (some[0].width, some[0].height * len(some)))
    for number, page in enumerate(some):
        strip.paste(page, (0, number * page.height))
    palette = strip.quantize(256, Image.Quantize.MEDIANCUT, dither=Image.Dither.NONE)
    return [page.quantize(palette=palette, dither=Image.Dither.NONE) for page in pages]
