"""Automatic exposure: one number for a whole data set, never one per image."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError

PILOTS = 16
PERCENTILE = 99.9
TARGET = 0.8


def full_scale_from_pilots(exposures: Sequence[NDArray[np.floating]]) -> float:
    """Return the exposure at full scale that puts the pilots' 99.9th percentile at 80 % of it.

    Args:
        exposures: noiseless exposures ``(C, H, W)`` of the pilot samples.

    Raises:
        InputError: when the pilots are dark.
    """
    bright = float(np.percentile(np.concatenate([np.ravel(e) for e in exposures]), PERCENTILE))
    if not bright > 0:
        msg = (
            "camera.exposure.full_scale: 'auto' found no light in the pilot samples; check the scene's light and the mask's "
            "amplitude, or give a number"
        )
        raise InputError(msg)
    return bright / TARGET
