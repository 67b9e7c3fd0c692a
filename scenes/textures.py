"""A pool of tileable grey patterns, made once per process, and the reflectances that a scene draws from it.

Synthesis costs more than rendering, colouring is a table look-up: so the patterns are fixed (they are part of what a
seed means, like the shapes of `scenes.meshes`) and each use gets its own colours, offset, grain and repeats.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from scenes.patterns import PATTERNS, clouds

_POOL_SEED = 20260101
_VARIANTS = 5
_GRAINS = 4


@functools.cache
def pattern_pool(size: int) -> NDArray[np.uint8]:
    """Return ``(N, size, size)`` tileable patterns, 0..255; the same in every process.

    Args:
        size: pixels along an edge.
    """
    rng = np.random.default_rng(_POOL_SEED)
    pool = [_as_bytes(pattern(size, rng)) for _ in range(_VARIANTS) for pattern in PATTERNS]
    return np.stack(pool)


@functools.cache
def _grain_pool(size: int) -> NDArray[np.float32]:
    """Return ``(N, size, size)`` fine noise around 1, by which reflectances are multiplied."""
    rng = np.random.default_rng(_POOL_SEED + 1)
    grains = [clouds(size, rng, slope=slope) for slope in np.linspace(0.4, 1.1, _GRAINS)]
    return (np.stack(grains) - 0.5).astype(np.float32)


def draw_reflectance(rng: np.random.Generator, colours: NDArray[np.float32], size: int) -> NDArray[np.float32]:
    """Draw a pattern and paint it: linear RGB ``(size, size, 3)``, within 0.01..0.92, tileable.

    Args:
        rng: decides pattern, offset, grain, and whether the colours blend or step.
        colours: ``(n, 3)`` linear RGB, n >= 2, from the pattern's dark end to its light end.
        size: pixels along an edge.
    """
    pool, grains = pattern_pool(size), _grain_pool(size)
    pattern = pool[rng.integers(len(pool))]
    grain = grains[rng.integers(len(grains))]
    shift = rng.integers(size, size=(2, 2))
    table = _colour_table(colours, stepped=bool(rng.random() < 0.35))
    strength = np.float32(rng.uniform(0.05, 0.4))
    reflectance = table[np.roll(pattern, tuple(shift[0]), axis=(0, 1))]
    reflectance = reflectance * (1 + strength * np.roll(grain, tuple(shift[1]), axis=(0, 1)))[..., np.newaxis]
    return np.clip(reflectance, np.float32(0.01), np.float32(0.92))


def tiled(reflectance: NDArray[np.float32], down: int, across: int) -> NDArray[np.float32]:
    """Repeat a texture ``down`` and ``across`` times within its own size (which they divide), averaging its pixels."""
    rows, columns, channels = reflectance.shape
    small = reflectance.reshape(rows // down, down, columns // across, across, channels).mean(axis=(1, 3))
    return np.tile(small, (down, across, 1))


def _colour_table(colours: NDArray[np.float32], *, stepped: bool) -> NDArray[np.float32]:
    """Return ``(256, 3)``: the colours in equal steps, or blended linearly."""
    level = np.linspace(0.0, 1.0, 256)
    if stepped:
        return colours[np.minimum((level * len(colours)).astype(int), len(colours) - 1)]
    stops = np.linspace(0.0, 1.0, len(colours))
    return np.stack([np.interp(level, stops, colours[:, channel]) for channel in range(3)], axis=1).astype(np.float32)


def _as_bytes(pattern: NDArray[np.float64]) -> NDArray[np.uint8]:
    return np.rint(255 * np.clip(pattern, 0, 1)).astype(np.uint8)
