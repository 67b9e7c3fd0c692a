"""Transfer functions of free space and of plane-parallel layers, with a phase that stays accurate in float32.

The phase of the straight ray is left out throughout: intensities do not need it, and what remains is small. With the
transverse sine s = lambda f and w = sqrt(n^2 - s^2), phase = -2 pi / lambda sum_j d_j s^2 / (w_j + n_j); evanescent = 0.

Sources: Goodman, Introduction to Fourier Optics, section 3.10; oblique waves: Matsushima, Opt. Express 18, 18453 (2010).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from simulator.arrays import Array, namespace, number, real_dtype, unit_phasor
from simulator.arrays import like as as_array
from simulator.optics.layers import Distance, Strata, as_strata

_ALL = slice(None)


class Transfer:
    """The transfer function of one grid and wavelength, evaluated for any distance at the price of one exponential.

    It is even in both frequencies, so only one quadrant is computed. Phases are reckoned in turns in float64 and reduced
    to one turn before the exponential: this is what keeps complex64 accurate.
    """

    def __init__(self, shape: tuple[int, ...], pitch_m: float, wavelength_m: float, *, like: Array) -> None:
        """Prepare the quadrant.

        Args:
            shape: rows and columns of the (padded) grid.
            pitch_m: sample pitch, metres.
            wavelength_m: vacuum wavelength, metres (of the medium, where distances are plain numbers).
            like: array whose kind, device and precision the transfer function takes.
        """
        self._wavelength_m, self._real = wavelength_m, real_dtype(like)
        self._sine_y, self._sine_x = (
            as_array(np.arange(n // 2 + 1) * (wavelength_m / (n * pitch_m)), like, namespace(like).float64)
            for n in shape
        )

    def quadrant(
        self,
        distance_m: Distance,
        reach_m: tuple[float, ...] | None = None,
        rows: slice = _ALL,
        columns: slice = _ALL,
    ) -> Array:
        """Return exp(i phase) for frequencies from zero to Nyquist, ``(H // 2 + 1, W // 2 + 1)``.

        Args:
            distance_m: distance in metres, or layers.
            reach_m: drop plane waves that travel farther sideways than this (rows, columns; metres; ``inf`` keeps all):
                the band limit. Its edge is soft, over ``band_edge_m`` inwards: a sharp one (Matsushima's) rings by 1-5 %.
            rows: which of the quadrant's rows.
            columns: which of the quadrant's columns.
        """
        sine_y, sine_x = self._sine_y[rows, None], self._sine_x[None, columns]
        return _transfer(sine_y, sine_x, (0.0, 0.0), as_strata(distance_m), self._wavelength_m, self._real, reach_m)


class TiltedTransfer:
    """The transfer function around an oblique carrier, without the carrier's own phase and sideways travel.

    The output grid is therefore centred where the carrier's ray through the input grid's centre arrives.
    """

    def __init__(
        self,
        shape: tuple[int, ...],
        pitch_m: float,
        wavelength_m: float,
        carrier: tuple[float, float],
        *,
        like: Array,
    ) -> None:
        """Prepare the frequencies, in FFT order.

        Args:
            shape: rows and columns of the grid.
            pitch_m: sample pitch, metres.
            wavelength_m: vacuum wavelength, metres.
            carrier: transverse sines (x, y) of the direction in which the carrier travels.
            like: as in ``Transfer``.
        """
        self._wavelength_m, self._real, self._carrier = wavelength_m, real_dtype(like), carrier
        self._sine_y, self._sine_x = (
            as_array(np.fft.fftfreq(n, pitch_m) * wavelength_m, like, namespace(like).float64) for n in shape
        )

    def block(
        self,
        distance_m: Distance,
        reach_m: tuple[float, ...] | None = None,
        rows: slice = _ALL,
        columns: slice = _ALL,
    ) -> Array:
        """Return rows and columns of the transfer function in FFT order; arguments as in ``Transfer.quadrant``."""
        sine_y, sine_x = self._sine_y[rows, None], self._sine_x[None, columns]
        return _transfer(sine_y, sine_x, self._carrier, as_strata(distance_m), self._wavelength_m, self._real, reach_m)


def band_edge_m(wavelength_m: float, distance_m: float) -> float:
    """Return the width of the band limit's soft edge: a few Fresnel zones, in metres of sideways travel."""
    return 4 * math.sqrt(wavelength_m * distance_m)


def _transfer(
    offset_y: Array,
    offset_x: Array,
    carrier: tuple[float, float],
    strata: Strata,
    wavelength_m: float,
    real: Any,
    reach_m: tuple[float, ...] | None,
) -> Array:
    """Return the transfer function at transverse sines ``carrier + offset``."""
    xp = namespace(offset_y)
    carrier_x, carrier_y = carrier
    carrier_squared = carrier_x**2 + carrier_y**2
    offset_squared = offset_y**2 + offset_x**2
    # s^2 - s_c^2, exact near zero where the phase must be
    excess = (
        offset_squared if carrier_squared == 0 else offset_squared + 2 * (carrier_y * offset_y + carrier_x * offset_x)
    )
    along = None if carrier_squared == 0 else carrier_y * offset_y + carrier_x * offset_x
    turns: Any = 0.0
    lowest = min(index for _, index in strata)
    for thickness_m, index in strata:
        chief = math.sqrt(index**2 - carrier_squared)
        cosine = xp.sqrt(xp.clip(chief**2 - excess, 0, None))
        path = offset_squared / (cosine + chief)
        if along is not None:
            # Beside the parabola: the carrier's own sideways travel is taken out, its change with the angle is not.
            path += along * excess / (chief * (cosine + chief) ** 2)
        turns = turns + path * (-thickness_m / wavelength_m)
    turns = turns - xp.round(turns)
    transfer = unit_phasor(xp.astype(turns * (2 * np.pi), real))
    if float(xp.max(excess)) > lowest**2 - carrier_squared:
        transfer *= xp.astype(excess <= lowest**2 - carrier_squared, real)  # evanescent waves end here
    if reach_m is not None:
        total_m = sum(number(thickness_m) for thickness_m, _ in strata)
        edge_m = max(band_edge_m(wavelength_m, total_m), 1e-12)
        sines = (offset_y + carrier_y, offset_x + carrier_x)
        for axis, reach in enumerate(reach_m):
            if math.isfinite(reach):
                _limit(transfer, sines, axis, carrier, strata, reach, edge_m)
    return transfer


def _limit(
    transfer: Array,
    sines: tuple[Array, Array],
    axis: int,
    carrier: tuple[float, float],
    strata: Strata,
    reach_m: float,
    edge_m: float,
) -> None:
    """Take away, in place, the waves that travel farther than ``reach_m`` along an axis beyond the carrier's travel."""
    xp = namespace(transfer)
    carrier_squared = carrier[0] ** 2 + carrier[1] ** 2
    straight = sum(number(t) * carrier[1 - axis] / math.sqrt(n**2 - carrier_squared) for t, n in strata)

    def travelled(along: Array, across_squared: Any) -> Array:
        total: Any = -straight
        for thickness_m, index in strata:
            cosine = xp.sqrt(xp.clip(index**2 - along**2 - across_squared, 1e-12, None))
            total = total + along * (number(thickness_m) / cosine)
        return xp.abs(total)

    # Most waves stay far inside: only those that would not, were the other axis as steep as it gets, are looked at.
    along, across = xp.reshape(sines[axis], (-1,)), sines[1 - axis]
    steepest = xp.max(across**2)
    concerned = travelled(along, steepest) > reach_m - edge_m
    if not bool(xp.any(concerned)):
        return
    where = xp.nonzero(concerned)[0]
    part = slice(int(where[0]), int(where[-1]) + 1)
    index = (part, slice(None)) if axis == 0 else (slice(None), part)
    chosen = sines[axis][part] if axis == 0 else sines[axis][:, part]
    beyond = xp.clip((travelled(chosen, across**2) - reach_m) / edge_m + 1, 0, 1)
    transfer[index] = transfer[index] * xp.astype(xp.cos(np.pi / 2 * beyond) ** 2, real_dtype(transfer))
