"""The reference: the Rayleigh-Sommerfeld integral of the first kind as a direct sum over the source samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError

_CHUNK = 2**20  # source samples at a time: keeps the work arrays in the cache's reach


def rayleigh_sommerfeld(
    field: NDArray[np.complexfloating],
    pitch_m: float,
    wavelength_m: float,
    distance_m: float,
    points_m: NDArray[np.floating],
) -> NDArray[np.complex128]:
    """Sum U(P) = sum U0 exp(ikr) / (2 pi r) (d / r) (1 / r - ik) dx^2 over all source samples, in float64.

    The sum itself must be sampled: a source of pitch dx has aliased orders every lambda d / dx, so refine the source
    until two refinements agree. Cost: one exponential per source sample and point.

    Source: Goodman, Introduction to Fourier Optics, eq. 3-41 with the full obliquity factor; convention exp(+ikr),
    the constant phase exp(ikd) included.

    Args:
        field: complex ``(H, W)`` on a centred grid: sample i lies at ``(i - (N - 1) / 2) pitch_m``.
        pitch_m: sample pitch, metres.
        wavelength_m: wavelength in the medium, metres.
        distance_m: distance to the plane of the points, metres, positive.
        points_m: ``(N, 2)`` sensor points as x, y in metres.

    Returns:
        ``(N,)`` complex128 field values.

    Raises:
        InputError: when shapes or lengths are not plausible.
    """
    if field.ndim != 2:
        raise InputError("field", f"expected 2-D (H, W), got shape {field.shape}")
    points = np.asarray(points_m, np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError("points_m", f"expected (N, 2) as x, y in metres, got shape {points.shape}")
    if not distance_m > 0:
        raise InputError("distance_m", f"got {distance_m!r}, expected positive metres")
    y, x = (((np.arange(n) - (n - 1) / 2) * pitch_m) for n in field.shape)
    k = 2 * np.pi / wavelength_m
    band = max(1, _CHUNK // field.shape[1])
    values = np.zeros(len(points), np.complex128)
    for start in range(0, field.shape[0], band):
        rows = slice(start, start + band)
        source = np.asarray(field[rows], np.complex128)
        for i, (px, py) in enumerate(points):
            r = np.sqrt((px - x[None, :]) ** 2 + (py - y[rows, None]) ** 2 + distance_m**2)
            values[i] += np.sum(source * np.exp(1j * k * r) * (1 / r - 1j * k) / r**2)
    return values * distance_m * pitch_m**2 / (2 * np.pi)
