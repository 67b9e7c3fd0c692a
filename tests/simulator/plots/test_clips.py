"""Sheets show the right values at the right places: read back pixel by pixel where the answer is known."""

import io

import numpy as np
import pytest
from PIL import Image

from simulator.errors import InputError
from simulator.plots.clips import animation, clip_sheet, shown_frames
from simulator.plots.drawing import white_level

LEFT, TOP, STEP = 12, 76, 130  # of the first tile; tiles of 64 pixels are doubled and stand 2 apart
QUARTER = 99  # sRGB of 0.25 / 2: 1.055 * 0.125^(1 / 2.4) - 0.055 = 0.3885
GREEN, GREY, NEAR, FAR = [0, 255, 0], [120, 120, 120], [253, 231, 37], [68, 1, 84]


def tiles(sheet, count: int, row: int = 0) -> np.ndarray:
    """Return the tiles of a row of cells, one pixel per scene pixel."""
    pixels = np.asarray(sheet.convert("RGB")).astype(int)
    top = TOP + 166 * row
    found = [pixels[top : top + 128, LEFT + STEP * n : LEFT + STEP * n + 128] for n in range(count)]
    for tile in found:
        assert np.array_equal(tile, tile[::2, ::2].repeat(2, 0).repeat(2, 1))
    return np.stack([tile[::2, ::2] for tile in found])


def test_a_still(known_clip) -> None:
    radiance, depth = tiles(clip_sheet([known_clip()], ["one"], "title"), 2)
    assert radiance[8, 8].tolist() == GREEN
    assert radiance[8, 16].tolist() == radiance[-1, -1].tolist() == [QUARTER] * 3
    assert depth[31, 5].tolist() == NEAR
    assert depth[32, 5].tolist() == FAR
    assert depth[-8, -8].tolist() == GREY
    assert depth[-9, -9].tolist() == FAR


def test_frames_and_extras_of_a_clip(known_clip) -> None:
    sheet = clip_sheet([known_clip(4, extras=True)], ["one"], "title")
    found = tiles(sheet, 11)
    for frame in range(4):
        assert found[frame, 8, 16 * frame + 8].tolist() == GREEN
        assert found[frame, 8, (16 * frame + 24) % 64].tolist() == [QUARTER] * 3
    depth, ids, normals, albedo, motion, hidden, hidden_depth = found[4:]  # of frame 1, which has a next one
    assert depth[0, 0].tolist() == NEAR
    assert ids[8, 24].tolist() != ids[8, 40].tolist() != GREY
    assert ids[-1, -1].tolist() == normals[-1, -1].tolist() == motion[-1, -1].tolist() == GREY
    assert normals[8, 8].tolist() == [128, 128, 255]
    assert albedo[8, 8].tolist() == [188] * 3  # sRGB of 0.5, whatever the light
    assert motion[8, 24].tolist() == [255, 0, 0]  # the fastest, to the right
    assert motion[8, 40].tolist() == [255, 255, 255]
    assert hidden[-1, -1].tolist() == [255] * 3
    assert hidden_depth[-1, -1].tolist() == FAR
    assert hidden[0, 0].tolist() == hidden_depth[0, 0].tolist() == GREY


def test_one_white_for_all(known_clip) -> None:
    """Each image alone has another white; on one sheet, what is twice as bright looks brighter."""
    first, second = known_clip(), known_clip()
    second.rgb[:] *= 2
    sheet = clip_sheet([first, second], ["one", "two"], "title")
    pixels = np.asarray(sheet.convert("RGB")).astype(int)
    places = [(TOP + 40, LEFT + 100), (TOP + 40 + 166, LEFT + 100)]
    if pixels.shape[0] < 400:  # side by side
        places[1] = (TOP + 40, LEFT + 100 + 2 * STEP + 12)
    dim, bright = (pixels[place].tolist() for place in places)
    assert bright == [QUARTER] * 3  # 0.5 of 4
    assert dim == [71] * 3  # 0.25 of 4: 0.277


def test_nothing_is_lit_or_seen(known_clip) -> None:
    clip = known_clip()
    clip.rgb[:] = 0
    clip.valid[:] = False
    radiance, depth = tiles(clip_sheet([clip], ["dark"], "title"), 2)
    assert np.all(radiance == 0)
    assert np.all(depth == GREY)


@pytest.mark.parametrize(("rows", "height"), [(24, 120), (100, 100), (200, 200), (600, 256)])
def test_tiles_keep_to_a_size(known_clip, rows: int, height: int) -> None:
    sheet = clip_sheet([known_clip(rows=rows, columns=rows)], ["one"], "title")
    assert abs(sheet.height - max(58 + 18 + height + 20, 58 + 200) - 12) <= 1


def test_a_lamp_does_not_darken_the_rest() -> None:
    image = np.ones((100, 100, 3), np.float32)
    image[0, :10] = 1e4
    assert white_level([image]) == 1
    assert white_level([np.zeros((2, 2, 3), np.float32)]) == 1
    image[10:] = 0  # darkness is no part of the scale
    assert white_level([image]) > 1


def test_frames_shown() -> None:
    for count in range(1, 40):
        frames = shown_frames(count)
        assert len(frames) == min(count, 5)
        assert (frames[0], frames[-1]) == (0, count - 1)
        assert count == 1 or frames[(len(frames) - 1) // 2] < count - 1


# Animations, read back by Pillow.


def pages(data: bytes) -> tuple[list[np.ndarray], list[int], int]:
    """Return the frames, how long each is shown in milliseconds, and how often they are repeated (0 is for ever)."""
    with Image.open(io.BytesIO(data)) as image:
        found, times = [], []
        for number in range(getattr(image, "n_frames", 1)):
            image.seek(number)
            image.load()
            found.append(np.asarray(image.convert("RGB")).astype(int))
            times.append(image.info["duration"])
        return found, times, image.info["loop"]


@pytest.mark.parametrize(("suffix", "tolerance"), [(".gif", 6), (".webp", 12)])  # 256 colours; lossy compression
def test_what_moves_moves(known_clip, suffix: str, tolerance: int) -> None:
    frames, times, loop = pages(animation([known_clip(4), known_clip(2)], ["long", "short"], "title", suffix))
    assert loop == 0
    assert times == [250] * 4
    assert len({frame.shape for frame in frames}) == 1
    for number, frame in enumerate(frames):
        tile = frame[TOP : TOP + 128, LEFT : LEFT + 128]
        np.testing.assert_allclose(tile[16, 32 * number + 16], (0, 255, 0), atol=tolerance)
        np.testing.assert_allclose(tile[16, (32 * number + 48) % 128], (99, 99, 99), atol=tolerance)
    second = frames[0][TOP:, LEFT:][:128, 128 + 2 + 12 :] if frames[0].shape[1] > 300 else frames[0][TOP + 166 :, LEFT:]
    assert np.abs(second[16, 16] - (0, 255, 0)).max() <= tolerance  # both begin alike


def test_long_clips_are_shown_faster(known_clip) -> None:
    long = known_clip(40, rows=24, columns=24)
    frames, times, _ = pages(animation([long], ["one"], "title", ".webp"))
    assert len(frames) == 40
    assert set(times) == {60}


def test_stills_do_not_move(known_clip) -> None:
    with pytest.raises(InputError, match="stills"):
        animation([known_clip()], ["one"], "title", ".gif")
