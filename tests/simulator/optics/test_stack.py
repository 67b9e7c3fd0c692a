"""The stack's rules and the spacing of its depths."""

import numpy as np
import pytest
import torch

from simulator.errors import InputError
from simulator.optics.stack import PsfStack, check_depths, depth_planes


def _stack(values, depths=(0.1, 0.2), channels=("R", "G"), pitch=1e-5):
    return PsfStack(values, np.asarray(depths, float), pitch, channels, "f")


def test_energy_is_the_sum_times_the_pixel_area():
    values = np.random.default_rng(0).random((2, 2, 5, 6)).astype(np.float32)
    expected = values.astype(float).sum((2, 3)) * 1e-10
    np.testing.assert_allclose(_stack(values).energy_m2(), expected, rtol=1e-6)
    np.testing.assert_allclose(_stack(torch.tensor(values)).energy_m2(), expected, rtol=1e-6)


def test_float32_stacks_are_summed_in_float64():
    """16 million values of 1 + 2^-23: a float32 sum would stop growing."""
    values = np.full((1, 1, 4100, 4100), 1, np.float32)
    values[0, 0, 0, 0] = 2.0**24
    stack = _stack(values, [1.0], ("Y",), 1.0)
    assert stack.energy_m2()[0, 0] == 4100**2 - 1 + 2**24


def _with(index, value):
    values = np.ones((2, 2, 3, 3))
    values[index] = value
    return values


@pytest.mark.parametrize(
    ("values", "depths", "channels", "words"),
    [
        (np.ones((2, 3, 3)), (0.1, 0.2), ("R", "G"), "^values: "),
        (np.ones((2, 2, 3, 3)), (0.1,), ("R", "G"), "^depths_m, channels: "),
        (np.ones((2, 2, 3, 3)), (0.1, 0.2), ("R", "G", "B"), "^depths_m, channels: "),
        (_with((0, 0, 1, 1), np.nan), (0.1, 0.2), ("R", "G"), "^values: "),
        (_with((0, 0, 1, 1), np.inf), (0.1, 0.2), ("R", "G"), "^values: "),
        (_with((1, 0, 0, 0), -1e-9), (0.1, 0.2), ("R", "G"), "^values: "),
        (_with((1, 0), 0), (0.1, 0.2), ("R", "G"), "^values: .*0.2 m, channel 'R'"),
        (np.ones((2, 2, 3, 3)), (0.2, 0.1), ("R", "G"), "^depths_m: "),
        (np.ones((2, 2, 3, 3)), (-0.1, 0.2), ("R", "G"), "^depths_m: "),
    ],
)
def test_stacks_that_break_the_rules_are_refused(values, depths, channels, words):
    with pytest.raises(InputError, match=words):
        _stack(values, depths, channels)


@pytest.mark.parametrize(
    "depths", [[], [[0.1]], [0.0], [-1.0, 2.0], [0.1, 0.1], [0.2, 0.1], [np.nan], [0.1, np.inf, np.inf]]
)
def test_senseless_depths_are_refused(depths):
    with pytest.raises(InputError, match=r"^depths_m: "):
        check_depths(np.array(depths))


@pytest.mark.parametrize(
    ("spacing", "scale"), [("disparity", lambda z: 1 / z), ("log", np.log), ("linear", lambda z: z)]
)
def test_depths_are_even_in_their_scale(spacing, scale):
    depths = depth_planes(0.036, 0.2, 25, spacing)
    assert (depths[0], depths[-1], depths.size) == (0.036, 0.2, 25)
    steps = np.diff(scale(depths))
    np.testing.assert_allclose(steps, steps[0], rtol=1e-9)
    check_depths(depths)


def test_disparity_reaches_infinity():
    np.testing.assert_allclose(depth_planes(0.5, np.inf, 5), [0.5, 0.5 * 4 / 3, 1.0, 2.0, np.inf])
    check_depths(depth_planes(0.5, np.inf, 5))


def test_one_depth_is_the_middle_of_the_range():
    assert depth_planes(0.1, 0.2, 1)[0] == pytest.approx(2 / 15)  # of disparities 10 and 5
    assert depth_planes(0.1, np.inf, 1)[0] == pytest.approx(0.2)
    assert depth_planes(0.1, 0.4, 1, "log")[0] == pytest.approx(0.2)
    assert depth_planes(0.1, 0.4, 1, "linear")[0] == pytest.approx(0.25)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((0.1, 0.2, 3, "cubic"), "^spacing: "),
        ((0.1, 0.2, 0), "^near, far, count: "),
        ((0.2, 0.1, 3), "^near, far, count: "),
        ((0.0, 0.1, 3), "^near, far, count: "),
        ((-0.1, 0.1, 3), "^near, far, count: "),
        ((0.1, np.inf, 3, "log"), "^far: "),
        ((0.1, np.inf, 3, "linear"), "^far: "),
    ],
)
def test_senseless_ranges_are_refused(arguments, words):
    with pytest.raises(InputError, match=words):
        depth_planes(*arguments)
