"""Near-field phase retrieval: the phase mask that casts a wanted pattern on the sensor.

Source: Boominathan et al., "PhlatCam: designed phase-mask based thin lensless camera", IEEE TPAMI 42, 1618 (2020),
algorithm 1: Gerchberg-Saxton between the mask plane (|U| = 1) and the sensor plane (|U| = sqrt(target)).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import crop2d, fft2, ifft2, next_fast_len, pad2d
from simulator.errors import InputError
from simulator.optics.even_filter import multiply_even
from simulator.optics.propagation import Transfer, spread_samples


def retrieve_phase(
    target: NDArray[np.float32],
    pitch_m: float,
    wavelength_m: float,
    distance_m: float,
    iterations: int,
) -> NDArray[np.float32]:
    """Find the mask phase whose intensity at the sensor plane comes close to a target.

    Args:
        target: wanted intensity, float32 ``(H, W)``, not negative; its scale does not matter.
        pitch_m: sample pitch of mask and target, metres.
        wavelength_m: design wavelength, metres.
        distance_m: mask to sensor, metres.
        iterations: forward-and-back passes; the published masks use 20 to 100.

    Returns:
        float32 ``(H, W)`` phase in -pi..pi.

    Raises:
        InputError: for a target that is dark, negative or not finite, or fewer than 1 iteration.
    """
    if target.ndim != 2 or not np.all(np.isfinite(target)) or target.min() < 0 or not target.max() > 0:
        msg = f"target must be a finite, not negative, not dark 2-D image, got shape {target.shape}"
        raise InputError(msg)
    if iterations < 1:
        msg = f"iterations: got {iterations}, expected a whole number from 1"
        raise InputError(msg)
    window = (target.shape[0], target.shape[1])
    spread = spread_samples(pitch_m, wavelength_m, distance_m)
    padded = tuple(next_fast_len(n + min(spread, n)) for n in window)
    # Of one mean intensity with the mask plane, so that neither plane outweighs the other.
    amplitude = np.sqrt(target / target.mean(), dtype=np.float32)
    sensor = amplitude.astype(np.complex64)
    forward = Transfer(padded, pitch_m, wavelength_m, like=sensor)
    there = forward.quadrant(distance_m)
    back = np.conj(there)
    for _ in range(iterations):
        mask = crop2d(ifft2(multiply_even(fft2(pad2d(sensor, padded)), back)), window)
        _set_modulus(mask, 1)
        sensor = crop2d(ifft2(multiply_even(fft2(pad2d(mask, padded)), there)), window)
        _set_modulus(sensor, amplitude)
    mask = crop2d(ifft2(multiply_even(fft2(pad2d(sensor, padded)), back)), window)
    return np.angle(mask)


def _set_modulus(field: NDArray[np.complex64], modulus: NDArray[np.float32] | float) -> None:
    """Give the field a modulus and keep its phase, in place; a zero stays zero."""
    scale = np.abs(field)
    np.divide(modulus, scale, out=scale, where=scale > 0)
    field *= scale
