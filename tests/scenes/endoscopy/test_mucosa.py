"""Mucosa: seamless, reddish, low in contrast; blood absorbs green more than red; vessels branch and thin."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest
from scipy.ndimage import label

from scenes.endoscopy.mucosa import LININGS, SIZE, draw_mucosa, draw_vessels


@pytest.mark.parametrize("organ", LININGS)
def test_linings_are_reddish_seamless_and_low_in_contrast(organ: str) -> None:
    hues = []
    for seed in range(8):
        lining = draw_mucosa(organ, np.random.default_rng(seed))
        assert (lining.shape, lining.dtype) == ((SIZE, SIZE, 3), np.float32)
        assert 0.01 <= lining.min() <= lining.max() <= 0.9
        red, green, blue = lining.mean(axis=(0, 1))
        assert red > 1.6 * green > 1.6 * 0.7 * blue
        assert lining[..., 0].std() / red < 0.2, "haemoglobin leaves red nearly alone"
        assert lining[..., 1].std() / green < 0.35
        for axis in (0, 1):
            inner = np.abs(np.diff(lining, axis=axis)).mean()
            seam = np.abs(np.take(lining, 0, axis) - np.take(lining, -1, axis)).mean()
            assert seam < 1.8 * inner, "the texture repeats"
        hues.append(green / red)
    assert np.ptp(hues) > 0.03, "patients differ"


def test_vessels_darken_green_more_than_red() -> None:
    """Oxyhaemoglobin absorbs 20 to 50 times as much at 540 nm as at 640 nm (Prahl), through broad bands several times."""
    lining = draw_mucosa("colon", np.random.default_rng(0)).astype(float)
    logs = np.log(lining / np.median(lining, axis=(0, 1)))
    dark = logs[..., 1] < np.percentile(logs[..., 1], 3)
    assert logs[dark, 1].mean() < 1.4 * logs[dark, 0].mean() < 0


def test_vessels_hang_together_and_come_in_several_calibres() -> None:
    arteries = draw_vessels(1, 2.0, np.random.default_rng(2))
    pieces, _count = cast("tuple[np.ndarray, int]", label(np.tile(arteries > 20, (2, 2)), np.ones((3, 3))))
    sizes = np.bincount(pieces.ravel())[1:]
    assert sizes.max() > 0.8 * sizes.sum() / 4, "one tree on a torus"
    assert 0.01 < (arteries > 60).mean() < 0.3
    levels = np.histogram(arteries[arteries > 0], (1, 80, 140, 200, 256))[0]
    assert np.all(levels > 30)
