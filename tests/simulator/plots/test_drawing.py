"""Colours against values worked out by hand, and against what they promise to the eye."""

import numpy as np
import pytest

from simulator.plots.drawing import depth_colours, id_colours, motion_colours, normal_colours

GREY = [120, 120, 120]


def test_depths_are_monotone_in_lightness() -> None:
    depths = (1 / np.linspace(1 / 0.04, 1 / 0.2, 100, dtype=np.float32))[None]  # even steps of the scale
    colours = depth_colours(depths, np.ones_like(depths, bool), 0.04, 0.2)[0]
    luminance = colours @ np.array([0.2126, 0.7152, 0.0722])
    assert np.all(np.diff(luminance) < 0)  # near is light, far is dark, also in greyscale
    flat = depth_colours(depths, np.ones_like(depths, bool), 0.1, 0.1)
    assert flat.shape == (1, 100, 3)


def test_normals() -> None:
    """The colours of every normal map: (n + 1) / 2 with x right, y up and z towards the eye."""
    normals = np.array([[(0, 0, -1), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 0)]], np.float32)
    expected = [[128, 128, 255], [255, 128, 128], [0, 128, 128], [128, 0, 128], [128, 255, 128], GREY]
    assert normal_colours(normals)[0].tolist() == expected


def test_shapes_have_colours_of_their_own() -> None:
    numbers = np.arange(-1, 60, dtype=np.int32)
    colours = id_colours(numbers[None])[0].astype(int)
    assert colours[0].tolist() == GREY
    assert len({tuple(colour) for colour in colours}) == len(colours)
    following = np.abs(np.diff(colours[1:], axis=0)).max(axis=1)
    assert following.min() > 60  # of 255: neighbours in number often touch in the image
    assert np.array_equal(id_colours(numbers[None, 20:])[0], colours[20:])  # whatever else is in the image


@pytest.mark.parametrize(
    ("right", "down", "colour"),
    [
        (0, 0, [255, 255, 255]),
        (4, 0, [255, 0, 0]),  # the wheel's beginning
        (2, 0, [255, 128, 128]),  # half as fast, half as full
        (0, 4, [255, 234, 0]),  # a quarter of 55 steps is 13.75 of the 15 from red to yellow
        (-4, 0, [0, 197, 255]),  # half of 55 is 2.5 of the 11 steps from cyan to blue behind it
        (0, -4, [103, 0, 255]),  # three quarters is 5.25 of the 13 steps from blue to magenta
        (8, 0, [191, 0, 0]),  # beyond the scale
    ],
)
def test_motion(right: float, down: float, colour: list[int]) -> None:
    motion = np.array([[(right, down, 9.0)]], np.float32)
    yes = np.ones((1, 1), bool)
    found = motion_colours(motion, yes, yes, 4.0)[0, 0]
    np.testing.assert_allclose(found, colour, atol=1)
    dark = motion_colours(motion, yes, ~yes, 4.0)[0, 0]
    np.testing.assert_allclose(dark, 0.6 * np.array(colour), atol=1)
    assert motion_colours(motion, ~yes, yes, 4.0)[0, 0].tolist() == GREY
