"""Animations, read back by Pillow."""

import io

import numpy as np
import pytest
from PIL import Image

from simulator.errors import InputError
from simulator.plots.clips import animation

LEFT, TOP = 12, 76


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
