"""Near-field phase retrieval: the phase mask that casts a wanted pattern on the sensor.

Source: Boominathan et al., "PhlatCam: designed phase-mask based thin lensless camera", IEEE TPAMI 42, 1618 (2020),
algorithm 1: Gerchberg-Saxton between the mask plane (|U| = 1) and the sensor plane (|U| = sqrt(target)).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import next_fast_len, require_memory
from simulator.errors import InputError
from simulator.optics.propagation import Transfer, blocks, even_filter, in_threads, spread_samples

# Of the padded grid at the peak, as tracemalloc counts them: 22 where little is padded, 17 where both sides double.
_BYTES_PER_SAMPLE = 22


@dataclass(frozen=True)
class Retrieval:
    """A retrieved phase and how well it fits.

    Attributes:
        phase: float32 ``(H, W)``, -pi..pi.
        overlap: after each pass, sum |U| sqrt(target) over the window, 1 if all the mask's light lay in the target as asked
            for. It never falls: half the squared error of Gerchberg-Saxton is 1 - overlap, up to the scale (Fienup, Appl.
            Opt. 21, 2758, 1982, section III).
    """

    phase: NDArray[np.float32]
    overlap: tuple[float, ...]


def retrieve_phase(
    target: NDArray[np.float32],
    pitch_m: float,
    wavelength_m: float,
    distance_m: float,
    iterations: int,
    *,
    tolerance: float = 0.0,
    threads: int = 1,
) -> Retrieval:
    """Find the mask phase whose intensity at the sensor plane comes close to a target.

    Args:
        target: wanted intensity, float32 ``(H, W)``, not negative; its scale does not matter.
        pitch_m: sample pitch of mask and target, metres.
        wavelength_m: design wavelength, metres.
        distance_m: mask to sensor, metres.
        iterations: most forward-and-back passes; the published masks use 20 to 100.
        tolerance: stop when a pass raises the overlap by less than this; 0 makes all the passes.
        threads: they do not change the result.

    Raises:
        InputError: for a target that is dark, negative or not finite, fewer than 1 iteration, a negative tolerance,
            or a grid that exceeds the machine's memory.
    """
    import scipy.fft

    if target.ndim != 2 or not np.all(np.isfinite(target)) or target.min() < 0 or not target.max() > 0:
        raise InputError("target", f"expected a finite, not negative, not dark 2-D image, got shape {target.shape}")
    if iterations < 1:
        raise InputError("iterations", f"got {iterations}, expected a whole number from 1")
    if not tolerance >= 0:
        raise InputError("tolerance", f"got {tolerance:g}, expected a gain of overlap from 0 up, such as 1e-3")
    height, width = target.shape
    spread = spread_samples(pitch_m, wavelength_m, distance_m)
    padded = tuple(next_fast_len(n + min(spread, n)) for n in (height, width))
    require_memory("pixel_um", padded, 1, _BYTES_PER_SAMPLE, "use a coarser pixel, a narrower mask or a nearer sensor")
    # Of one mean intensity with the mask plane, so that neither plane outweighs the other.
    amplitude = np.sqrt(target / target.mean(), dtype=np.float32)
    # One array goes back and forth, with room below the window for what spreads: fresh memory costs time.
    wave = np.zeros((padded[0], width), np.complex64)
    wave[:height] = amplitude
    there = Transfer(padded, pitch_m, wavelength_m, like=wave).quadrant(distance_m)
    back = np.conj(there)
    overlap: list[float] = []
    with scipy.fft.set_workers(threads):
        for _ in range(iterations):
            wave = even_filter(wave, padded, back.__getitem__, overwrite=True)
            _set_modulus(wave, np.broadcast_to(np.float32(1), target.shape))
            wave = even_filter(wave, padded, there.__getitem__, overwrite=True)
            overlap.append(_set_modulus(wave, amplitude) / target.size)
            if tolerance and len(overlap) > 1 and overlap[-1] - overlap[-2] < tolerance:
                break
        mask = even_filter(wave, padded, back.__getitem__, overwrite=True)
    return Retrieval(np.angle(mask[:height]), tuple(overlap))


def _set_modulus(wave: NDArray[np.complex64], modulus: NDArray[np.float32]) -> float:
    """Give the window, at the top of the wave, a modulus and keep its phase, in place; a zero stays zero, the rest ends.

    Returns:
        The sum of the old modulus times the new one.
    """
    height, width = modulus.shape
    parts = blocks(wave, height, width)
    overlap = dict.fromkeys((part.start for part in parts), 0.0)

    def rows(part: slice) -> None:
        window = wave[part]
        scale = np.sqrt(window.real**2 + window.imag**2)  # np.abs guards against overflow at three times the price
        overlap[part.start] = float(np.einsum("ij,ij->", scale, modulus[part]))  # not BLAS: its threads would change it
        np.divide(modulus[part], scale, out=scale, where=scale > 0)
        window *= scale

    in_threads(rows, parts)
    wave[height:] = 0
    return sum(overlap.values())
