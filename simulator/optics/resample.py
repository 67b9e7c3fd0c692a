"""Separable resampling of images: exact pixel integration, cubic interpolation, magnification that keeps energy and sign.

The first two are linear maps along one axis in which each output needs a few neighbouring inputs, so they run, with
gradients, as a handful of small matrix products on NumPy and torch alike.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import Array, is_torch, like, namespace

_TILE = 16  # outputs whose weights make one small dense matrix


@dataclass(frozen=True)
class Band:
    """A banded linear map along one axis: ``out[j] = sum_b weights[j, b] * x[first[j] + b]``, zero outside the input.

    Attributes:
        first: ``(J,)`` index of the first input of each output, not decreasing; may lie outside the input.
        weights: ``(J, B)`` float64.
    """

    first: np.ndarray
    weights: np.ndarray

    def apply(self, array: Array, axis: int) -> Array:
        """Apply the map along ``axis`` (-1 or -2) of an array."""
        return self.prepared(array, array.shape[axis])(array, axis)

    def prepared(self, reference: Array, length: int) -> Callable[[Array, int], Array]:
        """Return ``apply`` for many arrays of the reference's kind and precision with ``length`` samples along the axis."""
        xp = namespace(reference)
        tiles = []
        width = self.weights.shape[1]
        for j in range(0, len(self.first), _TILE):
            first, weights = self.first[j : j + _TILE], self.weights[j : j + _TILE]
            start, stop = int(first[0]), int(first[-1]) + width
            tile = np.zeros((len(first), stop - start))
            np.add.at(tile, (np.arange(len(first))[:, None], (first - start)[:, None] + np.arange(width)), weights)
            # A tile outside the input altogether multiplies an empty slice, which gives zeros.
            inside = slice(min(max(start, 0), length), min(max(stop, 0), length))
            tiles.append((inside, like(tile[:, inside.start - start : inside.stop - start], reference)))

        def apply(array: Array, axis: int) -> Array:
            if axis == -1:
                return xp.concat([array[..., inside] @ tile.T for inside, tile in tiles], axis=-1)
            return xp.concat([tile @ array[..., inside, :] for inside, tile in tiles], axis=-2)

        return apply


@dataclass(frozen=True)
class MovingBoxes:
    """Boxes whose edges are torch tensors with a gradient: the same integral as a dense matrix.

    Attributes:
        start: ``(J,)`` lower edges in cells.
        stop: ``(J,)`` upper edges in cells.
        pitch_m: width of a cell, metres.
    """

    start: Array
    stop: Array
    pitch_m: float

    def prepared(self, reference: Array, length: int) -> Callable[[Array, int], Array]:
        """Return the map, as ``Band.prepared``."""
        xp = namespace(reference)
        cells = like(np.arange(length), self.start)
        inside = xp.minimum(self.stop[:, None], cells + 1) - xp.maximum(self.start[:, None], cells)
        matrix = xp.astype(xp.clip(inside, 0, None) * self.pitch_m, reference.dtype)
        return lambda array, axis: array @ matrix.T if axis == -1 else matrix @ array


def box_integral(origin: float, pitch_m: float, centres_m: Array, width_m: Any) -> Band | MovingBoxes:
    """Return the map from samples to their integral over boxes (metres x sample).

    Each sample stands for a cell of ``pitch_m``; cells that a box's edge cuts count by the part inside. The integral
    over all boxes of a gapless row therefore equals the sum of the samples times ``pitch_m``, to rounding.

    Args:
        origin: index, possibly half-way between two samples, of coordinate zero.
        pitch_m: sample pitch, metres.
        centres_m: ``(J,)`` centres of the boxes, metres; NumPy, or torch to have gradients.
        width_m: width of the boxes, metres.
    """
    start = (centres_m - width_m / 2) / pitch_m + origin + 0.5  # in cells; cell i spans i .. i + 1
    stop = (centres_m + width_m / 2) / pitch_m + origin + 0.5
    if is_torch(start):
        return MovingBoxes(start, stop, pitch_m)
    first = np.floor(start).astype(np.int64)
    cells = first[:, None] + np.arange(int(np.max(np.ceil(stop) - first)))
    overlap = np.minimum(stop[:, None], cells + 1) - np.maximum(start[:, None], cells)
    return Band(first, np.clip(overlap, 0, None) * pitch_m)


def cubic_interpolation(length: int, factor: int) -> Band:
    """Return the map from samples to ``factor`` times finer samples over the same extent, by cubic convolution.

    Source: Keys, IEEE Trans. ASSP 29, 1153 (1981), a = -1/2: third-order accurate, four neighbours.
    """
    position = (np.arange(length * factor) + 0.5) / factor - 0.5
    first = np.floor(position).astype(np.int64) - 1
    distance = np.abs(position[:, None] - (first[:, None] + np.arange(4)))
    near = 1.5 * distance**3 - 2.5 * distance**2 + 1
    far = -0.5 * distance**3 + 2.5 * distance**2 - 4 * distance + 2
    weights = np.where(distance <= 1, near, far)
    # Beyond the border the edge sample goes on: its weight takes what falls outside.
    clipped = np.clip(first, 0, max(length - 4, 0))
    folded = np.zeros((position.size, min(4, length)))
    rows = np.arange(position.size)
    for b in range(4):
        target = np.clip(first + b, 0, length - 1) - clipped
        np.add.at(folded, (rows, target), weights[:, b])
    return Band(clipped, folded)


# ---- magnification and shift


def magnified(
    image: NDArray[Any], factor: float, shift_px: Sequence[float] | NDArray[Any] = (0, 0)
) -> NDArray[np.float64]:
    """Magnify images about sample ``(H // 2, W // 2)``, then shift them; energy and sign are kept, but off the grid.

    Samples are integrals over pixels, so their running sum is known exactly at pixel edges. It is interpolated there by
    monotone cubics (Fritsch and Carlson, SIAM J. Numer. Anal. 17, 238, 1980) and its differences are the new pixels.

    Args:
        image: ``(..., H, W)``, not negative.
        factor: magnification, positive.
        shift_px: x and y by which what was magnified is moved, pixels.
    """
    x, y = (float(shift) for shift in shift_px)
    return _stretched(_stretched(np.asarray(image, np.float64), factor, x, -1), factor, y, -2)


def _stretched(image: NDArray[np.float64], factor: float, shift: float, axis: int) -> NDArray[np.float64]:
    from scipy.interpolate import PchipInterpolator

    size = image.shape[axis]
    edges = np.arange(size + 1) - 0.5 - size // 2
    running = np.insert(np.cumsum(image, axis), 0, 0.0, axis)
    new = np.clip((edges - shift) / factor, edges[0], edges[-1])  # beyond the grid the running sum stands still
    # Monotone but for rounding, which must not make light negative.
    return np.maximum(np.diff(PchipInterpolator(edges, running, axis=axis)(new), axis=axis), 0)
