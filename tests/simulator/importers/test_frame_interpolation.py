"""What all ways of temporal frame interpolation share: given frames stay, pairs are filled, bad frames are refused."""

import numpy as np
import pytest
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.importers.frame_interpolation import interpolate_pairs


def halfway(first: NDArray, second: NDArray, times: list[float]) -> NDArray:
    return np.stack([(1 - time) * first + time * second for time in times])


def test_new_frames_lie_between_those_that_are_left_bit_for_bit() -> None:
    frames = np.random.default_rng(0).random((3, 2, 4, 3), np.float32)
    found = interpolate_pairs(frames, 4, halfway)
    assert found.shape == (9, 2, 4, 3)
    assert np.array_equal(found[::4], frames)
    np.testing.assert_allclose(found[5], 0.75 * frames[1] + 0.25 * frames[2], rtol=1e-6)
    assert np.array_equal(interpolate_pairs(frames, 1, halfway), frames)
    assert np.array_equal(interpolate_pairs(frames[:1], 5, halfway), frames[:1])


def test_equal_frames_are_copied() -> None:
    frames = np.repeat(np.random.default_rng(0).random((1, 2, 4, 3), np.float32), 2, axis=0)

    def never(*_: object) -> NDArray:
        raise AssertionError

    assert np.array_equal(interpolate_pairs(frames, 3, never), np.repeat(frames[:1], 4, axis=0))


@pytest.mark.parametrize(
    ("frames", "factor", "name"),
    [
        (np.zeros((2, 4, 4, 3), np.float32), 0, "factor"),
        (np.zeros((2, 4, 4, 3), np.float32), 2.5, "factor"),
        (np.zeros((2, 4, 4), np.float32), 2, "frames"),
        (np.zeros((2, 4, 4, 3)), 2, "frames"),
        (np.full((2, 4, 4, 3), -1, np.float32), 2, "frames"),
        (np.full((2, 4, 4, 3), np.nan, np.float32), 2, "frames"),
    ],
)
def test_bad_frames_are_refused(frames: NDArray, factor: int, name: str) -> None:
    with pytest.raises(InputError, match=f"{name}: "):
        interpolate_pairs(frames, factor, halfway)
