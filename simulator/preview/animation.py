"""An animated preview of clips, slowed down until it can be watched, in a loop."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from simulator.errors import InputError
from simulator.preview.sheet import Cell, describe_scales, draw_sheet
from simulator.preview.tiles import common_scales, extra_tiles, radiance_tile
from simulator.types import Clip

if TYPE_CHECKING:
    from PIL import Image

ANIMATIONS = {".gif": "GIF", ".webp": "WEBP"}
_LOOP_MS, _FASTEST_MS, _SLOWEST_MS = 2500, 50, 250
_TICK_MS = 10  # of GIF
_WEBP_QUALITY = 90


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
        msg = "these scenes are stills, of one frame each, and nothing moves; write a contact sheet (.png) instead"
        raise InputError(msg)
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
    stream = io.BytesIO()
    if suffix == ".gif":
        pages = _one_palette(pages)
        options: dict[str, Any] = {"disposal": 1}
    else:
        options = {"quality": _WEBP_QUALITY, "method": 4}
    pages[0].save(
        stream, ANIMATIONS[suffix], save_all=True, append_images=pages[1:], duration=shown_ms, loop=0, **options
    )
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
