"""The exact sampled field behind a staircase mask: a free-space kernel integrated over each mask pixel.

A fabricated mask is constant over its pixels, so its spectrum goes on in diffraction orders far beyond the grid's band;
sampling the mask at its pixel centres folds that light to wrong angles (4-8 % of the PSF of a PhlatCam). Here each mask
pixel instead sends the Rayleigh-Sommerfeld wave of a uniform square, so the discrete convolution gives the true field
at the grid's points, all orders up to the chosen angle included.

Through layers (a cover glass) it is the wave that rays carry there: phase along them, amplitude by their spreading.

Source: Rayleigh-Sommerfeld kernel of the first kind (Goodman, Introduction to Fourier Optics, eq. 3-41) times the
far-field pattern of a square pixel: over 2 um the wavefront is flat to pi p^2 / (12 lambda d) = 1e-3 rad.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from simulator.arrays import Array, complex_dtype, fft2, is_torch, like, namespace, real_dtype, unit_phasor
from simulator.optics.propagation import Distance, Quadrant, Strata, as_strata, fan, whole_even

# Light up to this multiple of lambda / pixel, times the oversampling, is followed: the zeroth and first orders.
ORDERS = 1.5
STEEPEST = 0.75  # 49 degrees: what leaves a mask pixel more steeply is spread over more than four distances squared
# Angle and place go together only many Fresnel lengths sqrt(lambda d) away: behind pixels of 30 um at 0.5 mm (FlatCam) a
# wave cut at its first orders, half a Fresnel length out, would bring twice the light that was sent.
FRESNEL_LENGTHS = 16


def kernel_reach_m(
    pixel_m: float, wavelength_m: float, distance_m: float, orders: float = ORDERS, oversampling: int = 1
) -> float:
    """Return how far sideways (metres) light of so many diffraction orders, times the oversampling, travels."""
    sine = min(orders * oversampling * wavelength_m / pixel_m, STEEPEST)
    farthest_m = distance_m * STEEPEST / math.sqrt(1 - STEEPEST**2)
    least_m = FRESNEL_LENGTHS * math.sqrt(wavelength_m * distance_m)
    return max(distance_m * sine / math.sqrt(1 - sine**2), least_m, min(oversampling * least_m, farthest_m))


class PixelKernel:
    """Transfer functions of the pixel-integrated kernel on one grid and wavelength, for any distance."""

    def __init__(
        self, shape: tuple[int, ...], pitch_m: float, wavelength_m: float, reach_m: float, *, like: Array
    ) -> None:
        """Prepare the quadrant of displacements.

        Args:
            shape: even rows and columns of the padded grid.
            pitch_m: sample pitch, metres: also the side of the square that each sample stands for.
            wavelength_m: wavelength in the medium, metres.
            reach_m: largest sideways displacement, metres; the grid must be padded by twice this.
            like: array whose kind, device and precision the transfer function takes.
        """
        self._like, self._pitch_m, self._wavelength_m = like, pitch_m, wavelength_m
        self._shape = (shape[0] // 2 + 1, shape[1] // 2 + 1)
        samples = math.floor(reach_m / pitch_m)
        self._y, self._x = (np.arange(min(n, samples + 1)) * pitch_m for n in self._shape)

    def quadrant(self, distance_m: Distance) -> Quadrant:
        """Return the transfer function: any of its rows from zero to Nyquist, ``(rows, W // 2 + 1)``.

        Args:
            distance_m: distance in metres, or layers.
        """
        return _even_transform(self._kernel(as_strata(distance_m)), self._shape)

    def _kernel(self, strata: Strata) -> Array:
        """Return the wave of one pixel over displacements 0..reach, without the constant phase exp(ikd)."""
        xp, wavelength_m = namespace(self._like), self._wavelength_m
        y, x = (like(part, self._like, xp.float64) for part in (self._y[:, None], self._x[None, :]))
        rays = fan(strata, y**2 + x**2)
        turns = rays.path_m / wavelength_m
        real = real_dtype(self._like)
        wave = unit_phasor(xp.astype((turns - xp.round(turns)) * (2 * np.pi), real))
        inverse_r = xp.astype(rays.inverse_m, real)
        square = _sinc(inverse_r * like(self._y[:, None] * self._pitch_m / wavelength_m, self._like, real))
        square *= _sinc(inverse_r * like(self._x[None, :] * self._pitch_m / wavelength_m, self._like, real))
        size = square * xp.astype(rays.spreading, real) * (self._pitch_m**2 / wavelength_m)
        # (1 / r - ik) / (2 pi) e^(i phase) = (1 / (k r) - i) / lambda e^(i phase)
        near = inverse_r * (wavelength_m / (2 * np.pi))
        return xp.astype(wave * size * (near - 1j), complex_dtype(self._like))


def _sinc(x: Array) -> Array:
    """Return sin(pi x) / (pi x) for x >= 0."""
    xp = namespace(x)
    angle = x * np.pi + 1e-12
    return xp.sin(angle) / angle


def _even_transform(quadrant: Array, shape: tuple[int, int]) -> Quadrant:
    """Return the FFT, from zero to Nyquist, of the even function whose non-negative quadrant is given, zero beyond it."""
    if is_torch(quadrant):
        xp = namespace(quadrant)
        padded = xp.zeros(shape, dtype=quadrant.dtype, device=quadrant.device)
        padded[: quadrant.shape[0], : quadrant.shape[1]] = quadrant
        return fft2(whole_even(padded))[: shape[0], : shape[1]].__getitem__

    import scipy.fft

    # The FFT of an even sequence is a cosine transform of its half; the second one waits until its rows are asked for.
    half: Any = scipy.fft.dct(quadrant, type=1, n=shape[0], axis=0)
    return lambda rows: scipy.fft.dct(half[rows], type=1, n=shape[1], axis=1)
