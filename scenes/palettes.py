"""Colours that go together: a theme of hues for a scene, and ramps of reflectance drawn from it."""

from __future__ import annotations

import colorsys

import numpy as np
from numpy.typing import NDArray

from simulator.colour import srgb_to_linear

# Offsets of hue, in turns, from the theme's first hue: neighbours, complement, triad, split complement.
_HARMONIES = ((0.0, 0.07, -0.07), (0.0, 0.5, 0.04), (0.0, 1 / 3, 2 / 3), (0.0, 0.42, 0.58))


def draw_theme(rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw the hues of a scene, in turns."""
    return (rng.random() + np.array(_HARMONIES[rng.integers(len(_HARMONIES))])) % 1.0


def draw_ramp(
    rng: np.random.Generator, theme: NDArray[np.float64], *, saturation: tuple[float, float] = (0.1, 0.8)
) -> NDArray[np.float32]:
    """Draw 3 or 4 linear RGB colours, ``(n, 3)``, whose lightness rises from the first to the last.

    Three ramps in four keep to the theme's hues, the others take any.

    Args:
        rng: decides the colours.
        theme: hues of `draw_theme`.
        saturation: range of HSV saturation; each ramp draws one value that its colours vary around.
    """
    count = int(rng.integers(3, 5))
    hues = rng.choice(theme, count) if rng.random() < 0.75 else np.full(count, rng.random())
    hues = hues + rng.normal(0, 0.03, count)
    saturations = np.clip(rng.uniform(*saturation) + rng.normal(0, 0.12, count), 0, 0.95)
    values = np.linspace(rng.uniform(0.2, 0.55), rng.uniform(0.8, 0.98), count)
    encoded = [colorsys.hsv_to_rgb(h % 1.0, s, v) for h, s, v in zip(hues, saturations, values, strict=True)]
    return srgb_to_linear(np.array(encoded))
