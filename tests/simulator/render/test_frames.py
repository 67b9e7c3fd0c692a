"""Broken pixels and fireflies of rendered frames."""

from __future__ import annotations

import numpy as np
import pytest

from simulator.render.frames import firefly_dimming, repair


def test_repair_replaces_a_broken_pixel_by_its_neighbours() -> None:
    rgb = np.full((40, 40, 3), 2.0, dtype=np.float32)
    rgb[7, 9] = (np.nan, 1.0, 1.0)
    rgb[0, 0, 2] = 1e4  # bright is not broken
    repaired, count = repair(rgb)
    assert count == 1
    np.testing.assert_array_equal(repaired[7, 9], (2, 2, 2))
    assert repaired[0, 0, 2] == 1e4
    assert np.isnan(rgb[7, 9, 0]), "the input must stay as it was"
    rgb[:, 3] = -1
    with pytest.raises(RuntimeError, match="41 of 1600"):
        repair(rgb)


def test_lone_glaring_pixels_are_dimmed_and_highlights_and_lines_are_not() -> None:
    rgb = np.full((20, 30, 3), 0.2, dtype=np.float32)
    rgb[4, 5] = (8, 4, 0)  # a firefly
    rgb[10, 10:12] = 8.0  # the end of a highlight: each pixel has only one bright neighbour
    rgb[15, 0:30] = 8.0  # a line
    rgb[0, 29] = 8.0  # a firefly in a corner
    factor = firefly_dimming(rgb)
    expected = np.ones((20, 30))
    expected[4, 5] = 2 * 0.2 / 4
    expected[10, 10:12] = 2 * 0.2 / 8
    expected[15, [0, 29]] = 2 * 0.2 / 8
    expected[0, 29] = 2 * 0.2 / 8
    np.testing.assert_allclose(factor, expected, rtol=1e-6)
    with np.errstate(all="raise"):
        for dark in ((4, 4), (1, 9), (9, 1), (1, 1)):
            np.testing.assert_array_equal(firefly_dimming(np.zeros((*dark, 3), np.float32)), np.ones(dark))
    np.testing.assert_array_equal(firefly_dimming(rgb[15:16]), np.ones((1, 30)))
    rgb[10:12, 10:12] = 8.0  # a highlight of 2 x 2 pixels stays
    assert np.all(firefly_dimming(rgb)[10:12, 10:12] == 1)
