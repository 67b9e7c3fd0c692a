"""Films side by side: every frame of every method is where it belongs."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from learning.evaluate.films import NamedFilm, film_sheet, film_webp
from simulator.plots.drawing import fitted, font, wrapped


def films(names: int, frames: int = 3) -> list[NamedFilm]:
    """Return films whose frames are of one grey each, all different."""
    grey = np.arange(names * frames).reshape(names, frames) / (names * frames)
    shape = (frames, 16, 16, 3)
    return [
        NamedFilm(f"method {n}", np.broadcast_to(grey[n][:, None, None, None], shape), "words") for n in range(names)
    ]


def test_the_sheet_has_a_row_per_method_and_a_column_per_frame() -> None:
    clips = [films(2), films(2)]
    sheet = np.asarray(film_sheet(clips, "title", "line").convert("L")).astype(int)
    middles = []
    for grey in np.round(np.arange(6) / 6 * 255).astype(int):
        rows, columns = np.nonzero(sheet == grey)
        assert len(rows) >= 2 * 64 * 64  # in both clips, enlarged to 64 pixels
        assert np.ptp(np.percentile(columns, [10, 90])) < 64  # words have a few such greys, too
        middles.append((np.median(columns), np.percentile(rows, 10)))
    across, down = zip(*middles, strict=True)
    assert sorted(across[:3]) == list(across[:3])  # frames from left to right
    assert across[3:] == pytest.approx(across[:3], abs=1)
    assert max(down[:3]) < min(down[3:])  # methods from top to bottom


def test_the_animation_has_every_frame_of_every_method_of_each_clip() -> None:
    with Image.open(io.BytesIO(film_webp([films(2), films(2)[::-1]]))) as animation:
        assert animation.n_frames == 3
        for number in range(3):
            animation.seek(number)
            page = np.asarray(animation.convert("L")).astype(int)
            first, second = number / 6, (number + 3) / 6
            for value, row, column in ((first, 0, 0), (second, 0, 1), (second, 1, 0), (first, 1, 1)):
                tile = page[20 + row * 170 :, 10 + column * 170 :][:160, :160]
                assert np.count_nonzero(np.abs(tile - round(value * 255)) <= 3) > 0.9 * 160 * 160


def test_a_long_name_above_the_animation_takes_several_lines() -> None:
    """No letter of it is lost: the head grows by a line of 16 pixels."""
    long = [NamedFilm("plug-and-play over frames, from VideoNet", film.frames) for film in films(2)]
    with Image.open(io.BytesIO(film_webp([long]))) as animation, Image.open(io.BytesIO(film_webp([films(2)]))) as short:
        assert animation.height == short.height + 16
    lines = wrapped(long[0].name, 12, 160)
    assert " ".join(lines) == long[0].name
    assert all(font(12).getlength(line) <= 160 for line in lines)
    assert wrapped("unbreakable", 12, 30) == [fitted("unbreakable", 12, 30)]


def test_a_name_in_the_sheet_stays_in_its_row() -> None:
    """However long: where its lines end, an ellipsis says so."""
    wordy, silent = films(2)
    wordy = NamedFilm("plug-and-play over frames " * 5, wordy.frames[:, :12, :12], "words")
    silent = NamedFilm("", silent.frames[:, :12, :12])
    sheet = np.asarray(film_sheet([[wordy, silent]], "", "").convert("L")).astype(int)
    paper = sheet[0, 0]
    inked = np.flatnonzero((np.abs(sheet[:, :180] - paper) > 60).any(axis=1))
    first = np.flatnonzero((sheet[:, 190:] != paper).any(axis=1))[0]
    assert inked.min() >= first
    assert inked.max() < first + 72  # 12 rows, enlarged by 6
