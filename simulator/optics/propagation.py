"""Propagation by the angular spectrum through air and plane-parallel layers, with a phase that stays accurate in float32.

From top to bottom: a field through free space and back (the adjoint), the transfer functions behind it, how they are
applied in blocks, and the layers that light may cross.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np

from simulator.arrays import (
    Array,
    fft,
    fft_threads,
    ifft,
    is_torch,
    namespace,
    next_fast_len,
    number,
    real_dtype,
    unit_phasor,
)
from simulator.arrays import like as as_array
from simulator.errors import InputError
from simulator.types import CameraGeometry, Layer

MAX_SINE = 0.9  # steeper waves (64 degrees) do not reach a sensor behind a mask in any useful strength
_ALL = slice(None)
Strata = tuple[tuple[Any, float], ...]
"""Layers at one wavelength: (thickness in metres, refractive index); a thickness may be a torch scalar."""
Distance = Any
"""Metres of air (a torch scalar where gradients are wanted), or Strata."""
Quadrant = Callable[[slice], Array]
"""Gives rows of a transfer function from zero to Nyquist: (rows, W // 2 + 1)."""


# ---- a field through free space


def angular_spectrum(field: Array, pitch_m: float, wavelength_m: float, distance_m: float) -> Array:
    """Propagate a field through free space; nothing that leaves the window wraps around into it.

    Args:
        field: complex ``(..., H, W)`` in the source plane, zero outside the window.
        pitch_m: sample pitch, metres, in both planes.
        wavelength_m: wavelength in the medium, metres.
        distance_m: distance, metres, not negative.

    Returns:
        The field in the same window at the distance, same shape and dtype, without the constant phase exp(ikd).

    Raises:
        InputError: when the field is not complex or a length is not plausible.

    Example:
        >>> import numpy as np
        >>> field = np.ones((64, 64), np.complex128)
        >>> angular_spectrum(field, 2e-6, 532e-9, 0.0).shape
        (64, 64)
    """
    return _through_air(field, pitch_m, wavelength_m, distance_m, adjoint=False)


def angular_spectrum_adjoint(field: Array, pitch_m: float, wavelength_m: float, distance_m: float) -> Array:
    """Return the adjoint of ``angular_spectrum``, <A u, v> = <u, A* v>: it takes a field from the distance back.

    Arguments, padding, result and errors are those of ``angular_spectrum``; the transfer function is the conjugate one.
    """
    return _through_air(field, pitch_m, wavelength_m, distance_m, adjoint=True)


def _through_air(field: Array, pitch_m: float, wavelength_m: float, distance_m: float, *, adjoint: bool) -> Array:
    xp = namespace(field)
    if field.ndim < 2 or not xp.isdtype(field.dtype, "complex floating"):
        raise InputError("field", f"expected complex (..., H, W), got {field.dtype} {tuple(field.shape)}")
    _check_lengths(pitch_m, wavelength_m, distance_m)
    window = (field.shape[-2], field.shape[-1])
    spread = spread_samples(pitch_m, wavelength_m, distance_m)
    # Only displacements up to the window's own size lead from the window into the window. Where waves travel farther, the
    # band is limited, and the limit's soft edge comes on top.
    edge = math.ceil(band_edge_m(wavelength_m, distance_m) / pitch_m)
    limited = [spread > n or holds_steep_waves(pitch_m, wavelength_m) for n in window]
    padded = tuple(
        next_fast_len(n + (min(spread, n) + edge if limit else spread))
        for n, limit in zip(window, limited, strict=True)
    )
    reach = tuple((p - n) * pitch_m if limit else math.inf for p, n, limit in zip(padded, window, limited, strict=True))
    transfer = Transfer(padded, pitch_m, wavelength_m, like=field)

    def quadrant(rows: slice) -> Array:
        there = transfer.quadrant(distance_m, reach, rows)
        return xp.conj(there) if adjoint else there

    return even_filter(field, padded, quadrant)


def spread_samples(pitch_m: float, wavelength_m: float, distance_m: float) -> int:
    """Return how many samples the steepest plane wave on the grid travels sideways over a distance.

    The steepest wave sits in the corner of the band, at f = sqrt(2) / (2 pitch). Waves steeper than asin(MAX_SINE) are
    not counted: where the grid ``holds_steep_waves``, the band must be limited.
    """
    sine_axis = wavelength_m / (2 * pitch_m)
    cosine = math.sqrt(max(1 - 2 * sine_axis**2, 1 - MAX_SINE**2))
    return math.ceil(distance_m * min(sine_axis, MAX_SINE) / cosine / pitch_m)


def holds_steep_waves(pitch_m: float, wavelength_m: float) -> bool:
    """Whether the grid's band holds waves steeper than asin(MAX_SINE)."""
    return 2 * (wavelength_m / (2 * pitch_m)) ** 2 > MAX_SINE**2


def band_edge_m(wavelength_m: float, distance_m: float) -> float:
    """Return the width of the band limit's soft edge: a few Fresnel zones, in metres of sideways travel."""
    return 4 * math.sqrt(wavelength_m * distance_m)


def _check_lengths(pitch_m: float, wavelength_m: float, distance_m: float) -> None:
    limits: list[tuple[str, float, float, float, Any]] = [
        ("pitch_m", pitch_m, 1e-9, 1e-2, "2 um is 2e-6"),
        ("wavelength_m", wavelength_m, 1e-9, 1e-3, "532 nm is 532e-9"),
        ("distance_m", distance_m, 0.0, 1e3, "1.9 mm is 1.9e-3"),
    ]
    for name, value, low, high, hint in limits:
        if not low <= value <= high:
            raise InputError(name, f"got {value:g}, expected metres from {low:g} to {high:g} ({hint})")


# ---- transfer functions


class Transfer:
    """The transfer function of one grid and wavelength, evaluated for any distance at the price of one exponential.

    It is even in both frequencies, so only one quadrant is computed. Phases are computed in turns in float64 and reduced
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
        self, distance_m: Distance, reach_m: tuple[float, ...] | None = None, rows: slice = _ALL, columns: slice = _ALL
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
        self, shape: tuple[int, ...], pitch_m: float, wavelength_m: float, carrier: tuple[float, float], *, like: Array
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
        self, distance_m: Distance, reach_m: tuple[float, ...] | None = None, rows: slice = _ALL, columns: slice = _ALL
    ) -> Array:
        """Return rows and columns of the transfer function in FFT order; arguments as in ``Transfer.quadrant``."""
        sine_y, sine_x = self._sine_y[rows, None], self._sine_x[None, columns]
        return _transfer(sine_y, sine_x, self._carrier, as_strata(distance_m), self._wavelength_m, self._real, reach_m)

    def obliquity(self, distance_m: Distance, columns: slice = _ALL) -> Array:
        """Return sqrt(cos(theta_out) / cos(theta_in)) for columns in FFT order: |U|^2 of waves so weighted is irradiance.

        A plane wave of the sines s carries |U|^2 cos(theta) through a plane (the flux Im(U* dU/dz) / k of a scalar wave);
        theta is taken in the first layer, since layers do not reflect. Where waves of two directions meet, their product
        takes the geometric mean of both cosines, not the arithmetic one: 1 % less at 0.7 and 0.9.
        """
        xp = namespace(self._sine_x)
        carrier_x, carrier_y = self._carrier
        index_squared = as_strata(distance_m)[0][1] ** 2
        y, x = (xp.astype(part, self._real) for part in (self._sine_y[:, None], self._sine_x[None, columns]))
        cosine_squared = index_squared - (y + carrier_y) ** 2 - (x + carrier_x) ** 2
        return (xp.clip(cosine_squared, 0, None) / (index_squared - carrier_x**2 - carrier_y**2)) ** 0.25


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
    along = None if carrier_squared == 0 else carrier_y * offset_y + carrier_x * offset_x
    excess = offset_squared if along is None else offset_squared + 2 * along
    turns: Any = 0.0
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
    steepest = min(index for _, index in strata) ** 2 - carrier_squared
    if float(xp.max(excess)) > steepest:
        transfer *= xp.astype(excess <= steepest, real)  # evanescent waves end here
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


# ---- filters, a block of rows at a time

_BLOCK = 2**17  # samples: about a megabyte of complex64


def even_filter(field: Array, shape: tuple[int, ...], quadrant: Quadrant, *, overwrite: bool = False) -> Array:
    """Zero-pad a field, multiply its spectrum by an even function and return the field's own window.

    Rows of zeros on the way in and rows that the window does not keep on the way out are left out of the transforms.

    Args:
        field: complex ``(..., h, w)``.
        shape: H, W of the padded grid.
        quadrant: gives rows of the function, out of 0..H // 2, with columns 0..W // 2.
        overwrite: lets NumPy reuse the field's memory, which it can where h = H.
    """
    height, width = field.shape[-2:]
    columns = fft(field, shape[0], -2, overwrite=overwrite)

    def filter_rows(rows: slice, weights: Array) -> None:
        spectrum = fft(columns[..., rows, :], shape[1], -1)
        spectrum *= weights
        columns[..., rows, :] = ifft(spectrum, -1, overwrite=True)[..., :width]

    each_rows(field, shape, quadrant, filter_rows)
    return ifft(columns, -2, overwrite=True)[..., :height, :]


def each_rows(like: Array, shape: tuple[int, ...], quadrant: Quadrant, work: Callable[[slice, Array], None]) -> None:
    """Call ``work(rows, weights)`` once for every block of rows of a spectrum, with an even function's weights there.

    Args:
        like: an array of the spectrum's kind: torch gets blocks as large as possible.
        shape: H, W of the spectrum.
        quadrant: as in ``even_filter``.
        work: its weights are ``(rows, W)``.
    """
    height, width = shape
    xp = namespace(like)

    def both_signs(rows: slice) -> None:
        weights = quadrant(rows)
        weights = xp.concat([weights, xp.flip(weights[:, 1 : (width + 1) // 2], axis=1)], axis=1)
        work(rows, weights)
        # The negative frequencies repeat all rows but zero and, for an even height, Nyquist.
        first, stop = max(rows.start, 1), min(rows.stop, (height + 1) // 2)
        if first < stop:
            mirrored = xp.flip(weights[first - rows.start : stop - rows.start], axis=0)
            work(slice(height - stop + 1, height - first + 1), mirrored)

    in_threads(both_signs, blocks(like, height // 2 + 1, width))


def whole_even(quadrant: Array) -> Array:
    """Return an even function on a grid of even sizes H, W, in FFT order, from its quadrant ``(H // 2 + 1, W // 2 + 1)``."""
    xp = namespace(quadrant)
    half = xp.concat([quadrant, xp.flip(quadrant[1:-1], axis=0)], axis=0)
    return xp.concat([half, xp.flip(half[:, 1:-1], axis=1)], axis=1)


def blocks(like: Array, length: int, width: int, least: int = 8) -> list[slice]:
    """Cut a length into slices of which each, ``width`` samples wide, stays in the cache; torch gets one slice."""
    step = length if is_torch(like) else max(least, _BLOCK // width // 8 * 8)  # whole cache lines
    return [slice(start, min(start + step, length)) for start in range(0, length, step)]


def in_threads(work: Callable[[slice], None], parts: list[slice], threads: int | None = None) -> None:
    """Call ``work`` for every part, on as many threads as given or as FFTs may use; the parts do not depend on the number."""
    threads = min(threads or fft_threads(), len(parts))
    if threads == 1:
        for part in parts:
            work(part)
        return
    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(work, parts))


# ---- layers

_KNOTS = 4096
_STEEPEST = 0.98  # of the lowest index: where the table ends


def as_strata(distance_m: Distance) -> Strata:
    """Return a distance as layers: a plain number means air."""
    return distance_m if isinstance(distance_m, tuple) else ((distance_m, 1.0),)


def gap_strata(camera: CameraGeometry, wavelength_m: float) -> Strata:
    """Return the layers between mask and sensor at one wavelength; air alone where the camera has no layered gap."""
    if not camera.gap:
        return ((camera.mask_to_sensor_m, 1.0),)
    return tuple((layer.thickness_m, layer.material.index(wavelength_m)) for layer in camera.gap)


def air_equivalent_m(layers: Sequence[Layer], wavelength_m: float) -> float:
    """Return the distance in air at which paraxial rays arrive where they do behind the layers: sum of d / n, metres."""
    return sum(layer.thickness_m / layer.material.index(wavelength_m) for layer in layers)


def scaled(strata: Strata, factor: Any) -> Strata:
    """Return the layers with every thickness times a factor."""
    return tuple((thickness_m * factor, index) for thickness_m, index in strata)


def reduced_m(strata: Strata) -> Any:
    """Return the sum of thickness over index, metres: the distance in air with the same paraxial rays."""
    return sum(thickness_m / index for thickness_m, index in strata)


@dataclass(frozen=True)
class Fan:
    """Rays from one point through layers, at sideways distances rho.

    Attributes:
        path_m: optical path minus that of the straight ray at rho = 0, metres.
        inverse_m: s / rho, 1 / metres; 1 / r in air.
        spreading: sqrt(s ds / (rho d rho)), 1 / metres: the amplitude's fall; d / r^2 in air.
    """

    path_m: Array
    inverse_m: Array
    spreading: Array


def fan(strata: Strata, rho_squared: Array) -> Fan:
    """Trace the rays of one point to sideways distances.

    Args:
        strata: layers; one of index 1 is treated analytically, several through a table (NumPy only).
        rho_squared: squared sideways distances, square metres, float64.

    Raises:
        InputError: for torch arrays with several layers, or for rays too steep for them.
    """
    xp = namespace(rho_squared)
    if len(strata) == 1 and strata[0][1] == 1:
        d = strata[0][0]
        r = xp.sqrt(rho_squared + d**2)
        inverse = 1 / r
        return Fan(rho_squared / (r + d), inverse, inverse**2 * d)
    if is_torch(rho_squared):
        raise InputError("gap, window", "several layers are traced on NumPy only; use xp='numpy', or a gap of air")
    from scipy.interpolate import CubicHermiteSpline, CubicSpline

    thickness = np.array([number(t) for t, _ in strata])[:, None]
    index = np.array([n for _, n in strata])[:, None]
    # Even steps of the angle in the thinnest medium crowd no knots anywhere.
    sine = index.min() * np.sin(np.linspace(0, np.arcsin(_STEEPEST), _KNOTS))
    cosine = np.sqrt(index**2 - sine**2)
    per_sine = np.sum(thickness / cosine, axis=0)  # rho / s
    path = np.sum(thickness * index * sine**2 / (cosine * (index + cosine)), axis=0)  # minus the sum of t n
    slope = np.sum(thickness * index**2 / cosine**3, axis=0)  # d(rho) / ds
    rho, wanted = sine * per_sine, np.sqrt(rho_squared)
    if np.max(wanted) > rho[-1]:
        raise InputError(
            "mask",
            f"rays to {np.max(wanted):g} m sideways are steeper than the layers' {rho[-1]:g} m; use a narrower one",
        )
    return Fan(
        CubicHermiteSpline(rho, path, sine)(wanted),
        CubicSpline(rho, 1 / per_sine)(wanted),
        CubicSpline(rho, 1 / np.sqrt(per_sine * slope))(wanted),
    )
