"""Textures: tileable grey patterns, colours that go together, and the reflectances that a scene paints with both.

Every pattern lives on a torus (whole numbers of periods, wrapped distances), so that it repeats without a seam. Synthesis
costs more than rendering, colouring is a table look-up: so a pool of patterns is made once per process (it is part of what
a seed means, like the shapes of `scenes.meshes`), and each use gets its own colours, offset, grain and repeats.
"""

from __future__ import annotations

import colorsys
import functools
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from simulator.colour import srgb_to_linear

Pattern = NDArray[np.float64]


def _unit_square(size: int) -> tuple[Pattern, Pattern]:
    axis = (np.arange(size) + 0.5) / size
    row, column = np.meshgrid(axis, axis, indexing="ij")
    return row, column


def _spread(values: Pattern) -> Pattern:
    """Stretch linearly so that the 1st and 99th percentiles become 0 and 1, and clip."""
    low, high = np.percentile(values, [1, 99])
    return np.clip((values - low) / (high - low), 0, 1)


def _warp(size: int, rng: np.random.Generator, amount: float) -> tuple[Pattern, Pattern]:
    """Return the coordinates of the unit square, bent smoothly by up to about ``amount``."""
    row, column = _unit_square(size)
    bend = [clouds(size, rng, slope=2.2) - 0.5 for _ in range(2)]
    return row + amount * bend[0], column + amount * bend[1]


def clouds(size: int, rng: np.random.Generator, *, slope: float | None = None) -> Pattern:
    """Noise whose amplitude falls as frequency ** -slope: 0.5 is sand, 2 is clouds."""
    exponent = rng.uniform(1.0, 2.2) if slope is None else slope
    frequency = np.hypot(np.fft.fftfreq(size)[:, np.newaxis], np.fft.rfftfreq(size))
    frequency[0, 0] = np.inf
    spectrum = np.fft.rfft2(rng.standard_normal((size, size))) * frequency**-exponent
    return _spread(np.fft.irfft2(spectrum, s=(size, size)))


def marble(size: int, rng: np.random.Generator) -> Pattern:
    """Wavy veins."""
    row, column = _warp(size, rng, rng.uniform(0.3, 0.7))
    waves = rng.integers(1, 4, size=2)
    return 1 - np.abs(np.sin(np.pi * (waves[0] * row + waves[1] * column))) ** rng.uniform(0.4, 1.2)


def checks(size: int, rng: np.random.Generator) -> Pattern:
    """A chequerboard, straight or bent."""
    row, column = _warp(size, rng, rng.choice([0.0, 0.15]))
    cells = 2 * rng.integers(1, 5)
    return (np.floor(row * cells) + np.floor(column * cells)) % 2


def stripes(size: int, rng: np.random.Generator) -> Pattern:
    """Slanted stripes with sharp or soft edges."""
    row, column = _warp(size, rng, rng.choice([0.0, 0.25]))
    waves = rng.integers([0, 1], [4, 7])
    wave = np.sin(2 * np.pi * (waves[0] * row + waves[1] * column))
    return np.clip(0.5 + rng.uniform(0.5, 6) * wave, 0, 1)


def dots(size: int, rng: np.random.Generator) -> Pattern:
    """Discs or rings on a staggered lattice."""
    row, column = _unit_square(size)
    count = 2 * rng.integers(1, 4)
    v = row * count
    u = column * count + 0.5 * (np.floor(v) % 2)
    radius = np.hypot(u % 1 - 0.5, v % 1 - 0.5)
    edge, ring = rng.uniform(0.25, 0.42), rng.random() < 0.4
    disc = np.clip((edge - radius) * 30, 0, 1)
    return disc * np.clip((radius - 0.5 * edge) * 30, 0, 1) if ring else disc


def cells(size: int, rng: np.random.Generator) -> Pattern:
    """Scattered cells in flat tones (Worley noise), like flagstones."""
    distance, nearest, tones = _nearest_points(size, rng)
    gap = np.clip((distance[1] - distance[0]) * rng.uniform(20, 60), 0, 1)
    return tones[nearest] * gap


def scales(size: int, rng: np.random.Generator) -> Pattern:
    """Distance to the nearest of scattered points: pebbles, or leather when inverted."""
    distance, _, _ = _nearest_points(size, rng)
    return _spread(distance[0] if rng.random() < 0.5 else distance[1] - distance[0])


def _nearest_points(size: int, rng: np.random.Generator) -> tuple[Pattern, NDArray[np.intp], Pattern]:
    """Distances ``(2, size, size)`` to the two nearest of some random points on the torus, which one, and its tone."""
    points = rng.random((int(rng.integers(8, 40)), 2))
    axis = (np.arange(size)[:, np.newaxis] + 0.5) / size
    along_rows, along_columns = (np.abs(axis - points[:, side]) for side in range(2))
    squares = [np.minimum(offset, 1 - offset) ** 2 for offset in (along_rows, along_columns)]
    distance = squares[0][:, np.newaxis] + squares[1][np.newaxis]
    nearest = np.argmin(distance, axis=-1)
    two = np.sqrt(np.partition(distance, 1, axis=-1)[..., :2])
    return np.moveaxis(two, -1, 0), nearest, rng.uniform(0.15, 1, len(points))


def bricks(size: int, rng: np.random.Generator) -> Pattern:
    """A running bond with a tone for each brick and dark joints."""
    row, column = _unit_square(size)
    courses, per_course = 2 * int(rng.integers(2, 5)), int(rng.integers(2, 5))
    course = np.floor(row * courses).astype(int)
    along = column * per_course + 0.5 * (course % 2)
    tones = rng.uniform(0.45, 1, (courses, per_course))
    joint = np.minimum((row * courses) % 1 / courses, along % 1 / per_course) < 0.012
    return np.where(joint, 0.0, tones[course, np.floor(along).astype(int) % per_course])


def rings(size: int, rng: np.random.Generator) -> Pattern:
    """Wood: bent rings around an axis."""
    row, column = _warp(size, rng, 0.25)
    radius = np.hypot(np.sin(np.pi * (row - 0.5)), np.sin(np.pi * (column - 0.5)) * rng.uniform(0.2, 1))
    return (radius * rng.uniform(4, 10)) % 1


def plaid(size: int, rng: np.random.Generator) -> Pattern:
    """Woven bands of several widths, crossing."""
    bands = int(rng.integers(5, 12))
    warp, weft = rng.random((2, bands))
    row, column = _unit_square(size)
    return 0.5 * (warp[np.floor(row * bands).astype(int)] + weft[np.floor(column * bands).astype(int)])


def arcs(size: int, rng: np.random.Generator) -> Pattern:
    """Truchet tiles: quarter circles that join into winding lines."""
    count = int(rng.integers(4, 9))
    row, column = _unit_square(size)
    v, u = row * count, column * count
    flipped = rng.random((count, count)) < 0.5
    u_in = np.where(flipped[v.astype(int), u.astype(int)], 1 - u % 1, u % 1)
    v_in = v % 1
    distance = np.minimum(np.hypot(u_in, v_in), np.hypot(1 - u_in, 1 - v_in))
    return np.clip((rng.uniform(0.1, 0.25) - np.abs(distance - 0.5)) * 20 + 0.5, 0, 1)


def collage(size: int, rng: np.random.Generator) -> Pattern:
    """Overlapping paper scraps, rotated rectangles and ellipses of flat tones."""
    row, column = _unit_square(size)
    tones = np.full((size, size), rng.random())
    for _ in range(int(rng.integers(15, 40))):
        v = (row - rng.random() + 0.5) % 1 - 0.5
        u = (column - rng.random() + 0.5) % 1 - 0.5
        turn = rng.uniform(0, np.pi)
        a, b = u * np.cos(turn) + v * np.sin(turn), v * np.cos(turn) - u * np.sin(turn)
        half_a, half_b = rng.uniform(0.05, 0.22, 2)
        rectangle = np.maximum(np.abs(a) / half_a, np.abs(b) / half_b)
        inside = (rectangle if rng.random() < 0.6 else np.hypot(a / half_a, b / half_b)) < 1
        tones[inside] = rng.random()
    return tones


PATTERNS: tuple[Callable[[int, np.random.Generator], Pattern], ...] = (
    clouds,
    marble,
    checks,
    stripes,
    dots,
    cells,
    scales,
    bricks,
    rings,
    plaid,
    arcs,
    collage,
)


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


_POOL_SEED = 20260101
_VARIANTS = 5
_GRAINS = 4


@functools.cache
def pattern_pool(size: int) -> NDArray[np.uint8]:
    """Return ``(N, size, size)`` tileable patterns, 0..255; the same in every process."""
    rng = np.random.default_rng(_POOL_SEED)
    pool = [np.clip(pattern(size, rng), 0, 1) for _ in range(_VARIANTS) for pattern in PATTERNS]
    return np.rint(255 * np.stack(pool)).astype(np.uint8)


@functools.cache
def _grain_pool(size: int) -> NDArray[np.float32]:
    """Return ``(N, size, size)`` fine noise around 1, by which reflectances are multiplied."""
    rng = np.random.default_rng(_POOL_SEED + 1)
    grains = [clouds(size, rng, slope=slope) for slope in np.linspace(0.4, 1.1, _GRAINS)]
    return (np.stack(grains) - 0.5).astype(np.float32)


def draw_reflectance(rng: np.random.Generator, colours: NDArray[np.float32], size: int) -> NDArray[np.float32]:
    """Draw a pattern, its offset and grain, and whether its colours blend or step.

    Returns:
        Tileable linear RGB ``(size, size, 3)`` in 0.01..0.92, of ``colours`` ``(n, 3)``, n >= 2, from its dark end to its
        light end.
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
