"""Free-space propagation of a field by the angular spectrum, with a phase that stays accurate in float32.

The constant phase exp(ikd) is left out throughout: intensities do not need it, and without it the phase that remains
is small. U(d) = F^-1[F[U0] exp(i phase)], phase = -2 pi lambda d f^2 / (1 + sqrt(1 - lambda^2 f^2)), evanescent = 0.

Sources: Goodman, Introduction to Fourier Optics, section 3.10; band limit: Matsushima and Shimobaba,
Opt. Express 17, 19662 (2009).
"""

from __future__ import annotations

import math
from typing import Any

from simulator.arrays import Array, namespace, next_fast_len
from simulator.errors import InputError
from simulator.optics.even_filter import even_filter
from simulator.optics.transfer import Transfer, band_edge_m

MAX_SINE = 0.9  # steeper waves (64 degrees) do not reach a sensor behind a mask in any useful strength


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
    xp = namespace(field)
    if field.ndim < 2 or not xp.isdtype(field.dtype, "complex floating"):
        msg = f"field must be complex (..., H, W), got {field.dtype} {tuple(field.shape)}; use field.astype(complex)"
        raise InputError(msg)
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
    return even_filter(field, padded, lambda rows: transfer.quadrant(distance_m, reach, rows))


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


def _check_lengths(pitch_m: float, wavelength_m: float, distance_m: float) -> None:
    limits: list[tuple[str, float, float, float, Any]] = [
        ("pitch_m", pitch_m, 1e-9, 1e-2, "2 um is 2e-6"),
        ("wavelength_m", wavelength_m, 1e-9, 1e-3, "532 nm is 532e-9"),
        ("distance_m", distance_m, 0.0, 1e3, "1.9 mm is 1.9e-3"),
    ]
    for name, value, low, high, hint in limits:
        if not low <= value <= high:
            msg = f"{name}: got {value:g}, expected metres from {low:g} to {high:g} ({hint})"
            raise InputError(msg)
