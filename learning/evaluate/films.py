"""Films side by side: the frames of a clip as the truth and every method have them, as a sheet and as an animation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simulator.plots.drawing import INK, PAPER, animation_webp, fitted, font, resized, wrapped

if TYPE_CHECKING:
    from PIL import Image

_TILE, _GAP, _WORDS, _HEAD, _NAMES, _MARGIN = 72, 4, 16, 48, 190, 10  # pixels
_ANIMATED = 160


@dataclass(frozen=True, eq=False)
class NamedFilm:
    """Frames ``(N, h, w, 3)`` in sRGB codes 0..1, of a method or the truth, and a few words."""

    name: str
    frames: NDArray[np.floating]
    words: str = ""


def film_sheet(clips: Sequence[Sequence[NamedFilm]], title: str, line: str) -> Image.Image:
    """Return a sheet: for each clip a row per method, the truth first, whose columns are the frames."""
    from PIL import Image, ImageDraw

    frames, rows, columns = clips[0][0].frames.shape[:3]
    height = max(_TILE // rows, 1) * rows
    width = max(1, round(columns * height / rows))
    block = sum(height + _GAP for _ in clips[0]) + 2 * _WORDS
    across = max(_NAMES + frames * (width + _GAP) + _MARGIN, round(font(15).getlength(title)) + 2 * _MARGIN)
    across = max(across, round(font(12).getlength(line)) + 2 * _MARGIN)
    sheet = Image.new("RGB", (across, _HEAD + len(clips) * block + _MARGIN), PAPER)
    draw = ImageDraw.Draw(sheet)
    wide, most = _NAMES - 2 * _MARGIN, max(1, (height - 6) // _WORDS - 1)  # of a name: pixels, lines
    draw.text((_MARGIN, 8), title, fill=INK, font=font(15))
    draw.text((_MARGIN, 28), line, fill=INK, font=font(12))
    for number, films in enumerate(clips):
        top = _HEAD + number * block + _WORDS
        for row, film in enumerate(films):
            y = top + row * (height + _GAP)
            names = wrapped(film.name, 12, wide)
            if len(names) > most:
                names[most - 1 :] = [fitted(" ".join(names[most - 1 :]), 12, wide)]
            for line_number, words in enumerate(names):
                draw.text((_MARGIN, y + 4 + line_number * _WORDS), words, fill=INK, font=font(12))
            below = y + 6 + len(names) * _WORDS
            draw.text((_MARGIN, below), fitted(film.words, 11, wide), fill=INK, font=font(11))
            for at, frame in enumerate(film.frames):
                sheet.paste(resized(_codes(frame), height), (_NAMES + at * (width + _GAP), y))
    return sheet


def film_webp(clips: Sequence[Sequence[NamedFilm]]) -> bytes:
    """Return an animation: for each clip a row, the methods side by side under their names, frame after frame."""
    from PIL import Image, ImageDraw

    first = clips[0]
    frames, rows, columns = first[0].frames.shape[:3]
    height = max(_ANIMATED // rows, 1) * rows
    width = max(1, round(columns * height / rows))
    names = [wrapped(film.name, 12, width) for film in first]
    head = _GAP + _WORDS * max(len(lines) for lines in names)
    size = (_MARGIN + len(first) * (width + _MARGIN), head + len(clips) * (height + _MARGIN))
    pictures = [Image.new("RGB", size, PAPER) for _ in range(frames)]
    for number, picture in enumerate(pictures):
        draw = ImageDraw.Draw(picture)
        for column in range(len(first)):
            x = _MARGIN + column * (width + _MARGIN)
            for line, words in enumerate(names[column]):
                draw.text((x, _GAP + line * _WORDS), words, fill=INK, font=font(12))
            for row, films in enumerate(clips):
                picture.paste(
                    resized(_codes(films[column].frames[number]), height), (x, head + row * (height + _MARGIN))
                )
    return animation_webp(pictures)


def _codes(frame: NDArray[np.floating]) -> NDArray[np.uint8]:
    return np.round(np.clip(frame, 0, 1) * 255).astype(np.uint8)
