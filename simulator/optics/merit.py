"""Figures of merit of PSFs: sharpness of the autocorrelation, contrast over all frequencies, depths that are told apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import to_numpy
from simulator.optics.metrics import autocorrelation, radial_mtf
from simulator.optics.psf_stack import PsfStack

_RAYS, _STEPS_PER_PIXEL = 64, 4


@dataclass(frozen=True)
class Peak:
    """The central peak of an autocorrelation.

    Attributes:
        width_m: full width at half maximum, metres: the diameter of the disc with the area inside which the autocorrelation
            A stays above one half along every ray from zero shift.
        sidelobe: the highest A at shifts of at least ``width_m``: what the PSF confuses with a point elsewhere.
    """

    width_m: float
    sidelobe: float


def autocorrelation_peak(image: NDArray[np.floating], pitch_m: float) -> Peak:
    """Return width and highest sidelobe of a PSF's autocorrelation A(s) = sum_x I(x) I(x + s) / sum_x I(x)^2.

    Between samples A is interpolated linearly. The mean is not removed: a PSF's pedestal is a sidelobe, because light
    that is everywhere tells nothing. A Gaussian of standard deviation s has the width 4 sqrt(ln 2) s and the sidelobe 1/16.

    Args:
        image: PSF ``(H, W)``, finite and not zero everywhere.
        pitch_m: pixel pitch, metres.

    Raises:
        InputError: for another shape, NaN, or an image of zeros.
    """
    from scipy.ndimage import map_coordinates

    peak = autocorrelation(image)
    middle = [n // 2 for n in peak.shape]
    angles = np.arange(_RAYS) * np.pi / _RAYS  # A(-s) = A(s): half a turn is enough
    radii = np.arange(1 + _STEPS_PER_PIXEL * (max(middle) + 1)) / _STEPS_PER_PIXEL
    at = [m + np.outer(turned, radii) for m, turned in zip(middle, (np.sin(angles), np.cos(angles)), strict=True)]
    along = map_coordinates(peak, at, order=1)  # zero beyond the last shift, so every ray falls below one half
    first = np.argmax(along < 0.5, axis=1)
    ray = np.arange(_RAYS)
    above, below = along[ray, first - 1], along[ray, first]
    half = radii[first] - (0.5 - below) / (above - below) / _STEPS_PER_PIXEL
    width = 2 * np.sqrt(np.mean(half**2))
    rows, columns = (np.arange(n) - m for n, m in zip(peak.shape, middle, strict=True))
    beyond = rows[:, None] ** 2 + columns[None, :] ** 2 >= width**2
    return Peak(float(width * pitch_m), float(peak[beyond].max(initial=0.0)))


def mean_mtf(image: NDArray[np.floating], pitch_m: float) -> float:
    """Return the mean over frequencies, from zero to Nyquist, of the radially averaged MTF: 1 for a single bright pixel.

    Raises:
        InputError: as :func:`simulator.optics.metrics.radial_mtf`.

    Example:
        >>> mean_mtf(np.eye(1), 1e-5), mean_mtf(np.array([[0.0, 0, 0], [0, 2, 0], [0, 0, 0]]), 1e-5)
        (1.0, 1.0)
    """
    frequency, mtf = radial_mtf(image, pitch_m)
    if len(frequency) == 1:
        return float(mtf[0])
    return float(np.trapezoid(mtf, frequency) / frequency[-1])


def depth_correlations(stack: PsfStack) -> NDArray[np.float64]:
    """Return how alike the PSFs of every two depths are: C_ij = <H_i, H_j> / (||H_i|| ||H_j||), over channels and pixels.

    The mean is not removed, so the empty rim of the grid does not count.

    Returns:
        ``(K, K)``, symmetric, 1 on the diagonal, 0 for PSFs that share no lit pixel.
    """
    planes = to_numpy(stack.values).reshape(len(stack.depths_m), -1).astype(np.float64)
    planes /= np.linalg.norm(planes, axis=1, keepdims=True)  # a stack refuses planes that are zero everywhere
    return np.clip(planes @ planes.T, 0, 1)


def distinct_depths(correlations: NDArray[np.float64]) -> float:
    """Return the effective number of depths that a stack tells apart, N = K^2 / sum_ij C_ij^2.

    It is the participation ratio (tr C)^2 / tr(C^2) of the eigenvalues of the correlations: 1 when all PSFs are alike,
    K when no two overlap.

    Args:
        correlations: ``(K, K)`` of :func:`depth_correlations`.

    Example:
        >>> distinct_depths(np.ones((4, 4))), distinct_depths(np.eye(4))
        (1.0, 4.0)
    """
    return float(len(correlations) ** 2 / np.sum(correlations**2))
