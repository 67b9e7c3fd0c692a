"""Cropping and resampling in linear light, against block means, known ramps and the geometry of the window."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulator.errors import InputError
from simulator.importers.videos import Window, fit, fit_frames, largest_window

# OpenCV adds up to a few hundred float32 numbers per pixel: some roundings of 2**-24 each.
ROUNDING = {"rtol": 2e-6, "atol": 0}


@pytest.fixture
def rng():
    return np.random.default_rng(3)


@pytest.mark.parametrize("factor", [2, 3, 5])
def test_whole_factors_give_block_means(rng, factor):
    picture = rng.random((8 * factor, 6 * factor, 3), dtype=np.float32)
    expected = picture.astype(np.float64).reshape(8, factor, 6, factor, 3).mean(axis=(1, 3))
    result = fit(picture, Window(0, 0, 8 * factor, 6 * factor), (8, 6))
    np.testing.assert_allclose(result, expected, **ROUNDING)


def test_shrinking_keeps_the_mean_light_for_any_factor(rng):
    # One bright pixel: wherever it falls, its light is shared out whole, which neither gamma nor point sampling would do.
    for place in rng.integers(0, (240, 427), (20, 2)):
        picture = np.zeros((240, 427, 3), np.float32)
        picture[tuple(place)] = 1000
        result = fit(picture, Window(0, 0, 240, 427), (160, 150))
        np.testing.assert_allclose(result.mean((0, 1), np.float64), picture.mean((0, 1), np.float64), rtol=1e-5)


def test_enlarging_interpolates_between_neighbours_and_never_beyond(rng):
    ramp = np.broadcast_to(np.arange(10, dtype=np.float32)[:, None, None], (10, 10, 3))
    large = fit(ramp, Window(0, 0, 10, 10), (40, 40))
    # Centres of the new pixels in the old one's coordinates; the edge pixels reach outwards.
    expected = np.clip((np.arange(40) + 0.5) / 4 - 0.5, 0, 9)
    np.testing.assert_allclose(large[:, 7, 1], expected, atol=1e-6)
    noise = rng.random((9, 9, 3), dtype=np.float32)
    large = fit(noise, Window(0, 0, 9, 9), (31, 31))
    assert large.min() >= noise.min()
    assert large.max() <= noise.max()


def test_same_size_is_a_copy(rng):
    picture = rng.random((8, 9, 3), dtype=np.float32)
    result = fit(picture, Window(0, 0, 8, 9), (8, 9))
    np.testing.assert_array_equal(result, picture)
    result[:] = 0
    assert picture.any()


sizes = st.tuples(st.integers(4, 2000), st.integers(4, 2000))


@given(size=sizes, shape=sizes, crop=st.sampled_from(["centre", "random"]), seed=st.integers(0, 9))
def test_window_lies_inside_is_as_large_as_can_be_and_keeps_proportions(size, shape, crop, seed):
    window = largest_window(size, shape, crop, np.random.default_rng(seed))
    assert window.row >= 0
    assert window.column >= 0
    assert window.row + window.rows <= size[0]
    assert window.column + window.columns <= size[1]
    assert window.rows == size[0] or window.columns == size[1]
    scale = min(size[0] / shape[0], size[1] / shape[1])
    # To the nearest whole pixel, and at least one.
    assert abs(window.rows - max(1, scale * shape[0])) <= 0.5 + 1e-9
    assert abs(window.columns - max(1, scale * shape[1])) <= 0.5 + 1e-9
    if crop == "centre":
        assert abs(size[0] - window.rows - 2 * window.row) <= 1
        assert abs(size[1] - window.columns - 2 * window.column) <= 1


def test_random_window_takes_every_place():
    rng = np.random.default_rng(0)
    columns = {largest_window((10, 14), (5, 5), "random", rng).column for _ in range(200)}
    assert columns == {0, 1, 2, 3, 4}


def test_all_frames_of_a_clip_go_through_one_window(rng):
    picture = rng.random((10, 30, 3), dtype=np.float32)
    frames, window = fit_frames((picture + i for i in range(4)), "film", (10, 10), "random", rng)
    expected = picture[:, window.column : window.column + 10]
    for number, frame in enumerate(frames):
        np.testing.assert_array_equal(frame, expected + np.float32(number))


def test_changing_size_and_no_frames_are_refused(rng):
    with pytest.raises(InputError, match=r"my\.mp4 changes its size from 8 x 8 to 8 x 9"):
        fit_frames([np.zeros((8, 8, 3), np.float32), np.zeros((8, 9, 3), np.float32)], "my.mp4", (4, 4), "centre", rng)
    with pytest.raises(InputError, match=r"my\.mp4 gave no frames"):
        fit_frames([], "my.mp4", (4, 4), "centre", rng)
