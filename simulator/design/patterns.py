"""Patterns that masks are designed from: random surfaces, contours, round apertures, open and closed features."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.arrays import require_mask_memory, require_memory
from simulator.errors import InputError
from simulator.optics.mask import Mask

# ---- random surfaces and places

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


# ---- contour lines

# An edge of an image begins where its contrast exceeds this share of the image's range and goes on down to half of it.
_EDGE_CONTRAST = 0.2
# Up to this reach, in samples, a disc is drawn at every edge; above it that costs more than the distance from the edges.
_DISC_REACH = 8


def contours(samples: int, cell: float, line: float, seed: int) -> NDArray[np.float32]:
    """Return contour lines of Perlin noise, float32 ``(samples, samples)`` of 0 and 1.

    Args:
        samples: side of the image.
        cell: cell of the noise, in samples.
        line: width of the lines, in samples.
        seed: of the noise.
    """
    from skimage.feature import canny

    noise = perlin((samples, samples), cell, seed)
    # The thresholds follow the gradients' quantiles, as the original Canny implementation chooses them.
    edges = canny(noise, sigma=cell / 60, low_threshold=0.28, high_threshold=0.7, use_quantiles=True)
    if not edges.any():
        edges[samples // 2] = True  # a mask smaller than a cell may hold no contour: one line keeps it a camera
    return _widened(edges, line)


def contours_of_image(path: Path, samples: int, line: float) -> NDArray[np.float32]:
    """Return the line pattern of an image, stretched to the mask, float32 ``(samples, samples)`` of 0 and 1.

    An image of two grey levels is a pattern already: what is brighter is light. Any other gives its edges of at least a
    fifth of its contrast (Canny, blurred by a third of a line first), widened to lines.

    Args:
        path: square grey or colour image (PNG, TIFF, EXR, npy); its top row is the mask's top as seen from behind the
            sensor.
        samples: side of the pattern.
        line: width of the lines drawn along edges, in samples.

    Raises:
        InputError: for an image that is unreadable, not square, or without an edge.
    """
    from skimage.feature import canny
    from skimage.transform import resize

    from simulator.io.measurements import read_measurement

    image = np.asarray(read_measurement(path, ("R", "G", "B")), np.float64).mean(0)
    rows, columns = image.shape
    if abs(rows - columns) > 1:
        raise InputError("image", f"{path} has {rows} x {columns} pixels, expected a square; crop it first")
    low, high = image.min(), image.max()
    if low == high:
        raise InputError("image", f"{path} has one grey level everywhere; expected edges or a black and white pattern")
    fitted = resize((image - low) / (high - low), (samples, samples), order=1, anti_aliasing=rows > samples)
    if np.all((image == low) | (image == high)):
        return np.asarray(fitted >= 0.5, np.float32)
    sigma = line / 3
    # A step of contrast 1, blurred by sigma, in the units of the Sobel filter, which sums over 8 samples.
    steepest = 8 / (sigma * np.sqrt(2 * np.pi))
    low, high = (contrast * steepest for contrast in (_EDGE_CONTRAST / 2, _EDGE_CONTRAST))
    edges = canny(fitted, sigma=sigma, low_threshold=low, high_threshold=high)
    if not edges.any():
        raise InputError(
            "image",
            f"{path} shows no edge at lines {line:.3g} mask pixels wide; use a narrower line_um or more contrast",
        )
    return _widened(edges, line)


def _widened(edges: NDArray[np.bool_], line: float) -> NDArray[np.float32]:
    from scipy.ndimage import binary_dilation, distance_transform_edt

    reach = int(line / 2)
    if reach > _DISC_REACH:
        return (np.asarray(distance_transform_edt(~edges)) <= line / 2).astype(np.float32)
    y, x = np.ogrid[-reach : reach + 1, -reach : reach + 1]
    return binary_dilation(edges, x**2 + y**2 <= (line / 2) ** 2).astype(np.float32)


# ---- coordinates and round apertures

_SUBPIXELS = 16


def sample_positions_m(samples: int, pitch_m: float) -> NDArray[np.float64]:
    """Return the coordinates ``(samples,)`` of a mask's rows or columns, metres, zero at its middle."""
    return (np.arange(samples, dtype=np.float64) - (samples - 1) / 2) * pitch_m


def radius_squared_m2(samples: int, pitch_m: float) -> NDArray[np.float64]:
    """Return the squared distance of each sample of a square mask from its middle, ``(samples, samples)``, square metres."""
    x = sample_positions_m(samples, pitch_m)
    return x[:, None] ** 2 + x[None, :] ** 2


def round_aperture(samples: int, diameter: float) -> NDArray[np.float32]:
    """Return the share of each sample that lies inside a centred circle.

    Args:
        samples: side of the square grid.
        diameter: of the circle, in samples; a larger one than the grid is cut by it.

    Returns:
        ``(samples, samples)`` 0..1; rim samples are divided into 16 x 16, so their shares are right to about 0.5 %.

    Example:
        >>> round(float(round_aperture(21, 20).sum()) / 100, 2)  # pi
        3.14
    """
    require_mask_memory((samples, samples))
    x = sample_positions_m(samples, 1.0)
    radius = np.hypot(x[:, None], x[None, :])
    coverage = (radius <= diameter / 2).astype(np.float32)
    rows, columns = np.nonzero(np.abs(radius - diameter / 2) < 0.71)  # a sample's half diagonal
    sub = (np.arange(_SUBPIXELS) + 0.5) / _SUBPIXELS - 0.5
    y, x = x[rows][:, None] + sub, x[columns][:, None] + sub
    inside = y[:, :, None] ** 2 + x[:, None, :] ** 2 <= (diameter / 2) ** 2
    coverage[rows, columns] = inside.mean((1, 2))
    return coverage


# ---- open and closed features

FEATURE_TOLERANCE = 1e-6
"""How far, in samples, a feature may be from a whole number of them."""


def amplitude_mask(pattern: ArrayLike, feature_m: float, pitch_m: float, name: str) -> Mask:
    """Return an amplitude mask whose features are squares of whole samples.

    The profile is smooth because the samples stand for sharp edges, not for pixels that could be grey: a grid finer than
    the features then converges fastest (features of 30 um on 2 um samples come within 1 % of a staircase of 1 um pixels,
    1.9 mm away on 19.2 um sensor pixels, where a staircase of 2 um pixels is off by 2 %).

    Args:
        pattern: ``(H, W)`` amplitude of each feature, 0..1, in world axes.
        feature_m: side of a feature, metres.
        pitch_m: sample of the mask's grid, metres; a whole number of samples makes a feature.
        name: of the mask.

    Raises:
        InputError: when a feature is not made of whole samples, or the grid exceeds the machine's memory.
    """
    samples = round(feature_m / pitch_m)
    if samples < 1 or abs(feature_m / pitch_m - samples) > FEATURE_TOLERANCE:
        nearest_um = feature_m * 1e6 / max(samples, 1)
        raise InputError(
            "pixel_um",
            f"got {pitch_m * 1e6:g}, which does not divide features of {feature_m * 1e6:g} um; use {nearest_um:g}",
        )
    features = np.asarray(pattern, np.float32)
    rows, columns = features.shape
    require_mask_memory((rows * samples, columns * samples))
    amplitude = np.kron(features, np.ones((samples, samples), np.float32))
    return Mask(np.zeros_like(amplitude), amplitude, pitch_m, profile="smooth", name=name)


def cyclic(pattern: np.ndarray) -> np.ndarray:
    """Return a pattern ``(H, W)`` repeated to ``(2 H - 1, 2 W - 1)``: every window of its size holds one whole period.

    Example:
        >>> cyclic(np.array([[1, 0], [0, 0]]))
        array([[1, 0, 1],
               [0, 0, 0],
               [1, 0, 1]])
    """
    return np.tile(pattern, (2, 2))[:-1, :-1]
