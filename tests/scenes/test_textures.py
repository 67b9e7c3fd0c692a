"""Patterns, reflectances and colours."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from scenes.textures import PATTERNS, draw_ramp, draw_reflectance, draw_theme, pattern_pool, tiled


@pytest.mark.parametrize("pattern", PATTERNS, ids=lambda pattern: pattern.__name__)
def test_a_pattern_repeats_without_a_seam(pattern: Callable[[int, np.random.Generator], NDArray[np.float64]]) -> None:
    seam = inside = 0.0
    for seed in range(12):
        values = pattern(64, np.random.default_rng(seed))
        assert values.shape == (64, 64)
        assert values.min() >= 0
        assert values.max() <= 1
        assert values.std() > 0.02
        for axis in (0, 1):
            steps = np.abs(np.diff(values, axis=axis, append=np.take(values, [0], axis=axis)))
            edge = np.take(steps, -1, axis=axis).mean()
            # Straight edges of bricks and checks may lie on the seam, so the liveliest inner line is the measure.
            lines = np.take(steps, range(63), axis=axis).mean(axis=1 - axis)
            seam, inside = seam + edge, inside + np.percentile(lines, 98)
    assert seam <= 1.3 * inside


def test_the_pool_is_fixed_and_its_patterns_differ() -> None:
    pool = pattern_pool(32)
    assert pool.dtype == np.uint8
    assert pool is pattern_pool(32)
    assert len(np.unique(pool.reshape(len(pool), -1), axis=0)) == len(pool) == 5 * len(PATTERNS)


def test_reflectances_are_physical_float32_and_decided_by_the_generator() -> None:
    first, again, other = (np.random.default_rng(seed) for seed in (1, 1, 2))
    colours = draw_ramp(np.random.default_rng(0), draw_theme(np.random.default_rng(0)))
    picture = draw_reflectance(first, colours, 64)
    assert picture.dtype == np.float32
    assert picture.shape == (64, 64, 3)
    assert 0.01 <= picture.min() < picture.max() <= 0.921
    np.testing.assert_array_equal(picture, draw_reflectance(again, colours, 64))
    assert not np.array_equal(picture, draw_reflectance(other, colours, 64))


def test_tiling_repeats_a_smaller_copy_and_keeps_the_mean() -> None:
    picture = np.random.default_rng(0).random((8, 12, 3), dtype=np.float32)
    small = tiled(picture, 2, 4)
    np.testing.assert_array_equal(small[:4, :3], small[4:, 9:])
    np.testing.assert_allclose(small[0, 0], picture[:2, :4].mean(axis=(0, 1)), rtol=1e-6)
    np.testing.assert_allclose(small.mean(axis=(0, 1)), picture.mean(axis=(0, 1)), rtol=1e-5)
    np.testing.assert_array_equal(tiled(picture, 1, 1), picture)


def test_a_ramp_rises_in_lightness() -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        ramp = draw_ramp(rng, draw_theme(rng))
        assert ramp.dtype == np.float32
        lightest = ramp.max(axis=1)  # HSV's value
        assert np.all(np.diff(lightest) > 0)
        assert 0 <= ramp.min() <= ramp.max() <= 1
