"""Random surfaces for mask designs: Perlin's gradient noise and smooth Gaussian noise."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import require_memory

_PLACES_PER_UNIT = 24


def perlin(shape: tuple[int, int], cell: float, seed: int) -> NDArray[np.float32]:
    """Return Perlin noise normalised to 0..1.

    Source: Perlin, "Improving noise", SIGGRAPH 2002: gradients on a lattice, quintic fade.

    Args:
        shape: rows and columns.
        cell: lattice cell in samples.
        seed: of the lattice's gradients.
    """
    rng = np.random.default_rng(seed)
    rows, columns = (np.arange(n, dtype=np.float32) / np.float32(cell) for n in shape)
    angles = rng.uniform(0, 2 * np.pi, (int(rows[-1]) + 2, int(columns[-1]) + 2)).astype(np.float32)
    gradient_y, gradient_x = np.sin(angles), np.cos(angles)
    i, j = rows.astype(int)[:, None], columns.astype(int)[None, :]
    fy, fx = (rows - rows.astype(int))[:, None], (columns - columns.astype(int))[None, :]

    def corner(di: int, dj: int) -> NDArray[np.float32]:
        dot = gradient_y[i + di, j + dj] * (fy - di) + gradient_x[i + di, j + dj] * (fx - dj)
        return dot.astype(np.float32)

    fade_y, fade_x = (t**3 * (t * (t * 6 - 15) + 10) for t in (fy, fx))
    top = corner(0, 0) * (1 - fade_x) + corner(0, 1) * fade_x
    bottom = corner(1, 0) * (1 - fade_x) + corner(1, 1) * fade_x
    noise = top * (1 - fade_y) + bottom * fade_y
    return np.asarray((noise - noise.min()) / max(float(np.ptp(noise)), 1e-12), np.float32)


def gaussian_surface(shape: tuple[int, int], correlation: float, seed: int) -> NDArray[np.float32]:
    """Return smooth Gaussian noise of zero mean and unit standard deviation.

    Args:
        shape: rows and columns.
        correlation: 1/e half-width of the surface's autocorrelation, in samples.
        seed: of the white noise.
    """
    from scipy.ndimage import gaussian_filter

    white = np.random.default_rng(seed).standard_normal(shape, dtype=np.float32)
    # White noise blurred by sigma has the autocorrelation exp(-x^2 / (4 sigma^2)).
    surface = gaussian_filter(white, correlation / 2, mode="wrap")
    return (surface - surface.mean()) / surface.std()


def poisson_disc(width: float, seed: int) -> NDArray[np.float64]:
    """Return random points in a square, no two nearer than 1 and no room left for another.

    Source: random sequential addition (Feder, J. Theor. Biol. 87, 237, 1980), on a lattice of 24 places per unit, so that
    all of them can be tried.

    Args:
        width: side of the square, in units of the least distance.
        seed: of the places.

    Returns:
        ``(N, 2)`` points within 0..width.

    Raises:
        InputError: naming ``spacing_um`` where the lattice exceeds the machine's memory.
    """
    lattice = max(1, round(width * _PLACES_PER_UNIT))
    # A permutation of the places, its copy without those taken, and two flags per place.
    require_memory("spacing_um", (lattice, lattice), 2, 9, "use a wider spacing or a narrower mask")
    free = np.ones((lattice, lattice), bool)
    left = np.random.default_rng(seed).permutation(lattice**2)
    points = []
    while len(left):
        tried = max(256, len(left) // 64)
        for place in left[:tried]:
            row, column = divmod(int(place), lattice)
            if free[row, column]:
                points.append((row, column))
                near = [
                    slice(max(at - _PLACES_PER_UNIT, 0), min(at + _PLACES_PER_UNIT, lattice)) for at in (row, column)
                ]
                y, x = np.ogrid[near[0], near[1]]
                free[near[0], near[1]] &= (y - row) ** 2 + (x - column) ** 2 >= _PLACES_PER_UNIT**2
        left = left[tried:]
        left = left[free.ravel()[left]]
    return (np.array(points, np.float64) + 0.5) * (width / lattice)
