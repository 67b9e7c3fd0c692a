"""How steep a smooth mask's phase is: the frequencies up to which its light has to be followed."""

from __future__ import annotations

import numpy as np

from simulator.arrays import to_numpy
from simulator.optics.mask import Mask


def steepest_frequency(mask: Mask, wavelength_m: float) -> float:
    """Return the steepest phase gradient between neighbouring open samples, along either axis, cycles per metre."""
    height, open_ = to_numpy(mask.height_m), to_numpy(mask.amplitude) > 0
    steps = [
        float(np.abs(np.diff(height, axis=axis))[both].max(initial=0))
        for axis in (0, 1)
        for both in [np.delete(open_, 0, axis) & np.delete(open_, -1, axis)]
    ]
    return max(steps) * (mask.material.index(wavelength_m) - 1) / wavelength_m / mask.pitch_m


def followed_frequency(mask: Mask, wavelength_m: float, oversampling: int) -> float:
    """Return the frequency per axis (cycles per metre) up to which a smooth mask's light is followed.

    The mask's own samples hold their Nyquist frequency. A finer grid holds more, but only a phase that is steeper than the
    mask's own samples can tell puts light there: else all that it would add is the waves of a hard aperture edge.
    """
    nyquist = 1 / (2 * mask.pitch_m)
    if oversampling == 1:
        return nyquist
    return min(max(nyquist, steepest_frequency(mask, wavelength_m)), oversampling * nyquist)
