"""FlatCam: a separable amplitude mask from maximum-length sequences (Asif et al., IEEE TCI 3, 384, 2017)."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from simulator.design import patterns as amplitude_mask
from simulator.optics.mask import Mask


def flatcam(
    *,
    order: Annotated[int, Field(ge=2, le=10)] = 7,
    feature_um: Annotated[float, Field(ge=0.5, le=500)] = 30.0,
    pixel_um: Annotated[float, Field(ge=0.1, le=20)] = 2.0,
    cyclic: bool = False,
) -> Mask:
    """Return open squares where the outer product of a maximum-length sequence with itself is +1.

    The mask is (1 + a b^T) / 2 of two sequences of +1 and -1, so that a scene is recovered row by row and column by column.
    The published prototype has features of 30 um, half a millimetre from its sensor: set ``mask_to_sensor_mm: 0.5``.

    Args:
        order: of the sequence, whose length is 2^order - 1 features.
        feature_um: side of a square.
        pixel_um: sample of the grid; a feature is a whole number of them. 2 um keeps the sampling error near 2 % on sensor
            pixels of 9.6 um and more.
        cyclic: repeat the sequence to twice its length less one, as in the prototype, so that each direction of the scene
            sees a whole period.
    """
    signs = sequence(order)
    pattern = (1 + np.outer(signs, signs)) / 2
    pattern = amplitude_mask.cyclic(pattern) if cyclic else pattern
    return amplitude_mask.amplitude_mask(pattern, feature_um * 1e-6, pixel_um * 1e-6, "flatcam")


def sequence(order: int) -> np.ndarray:
    """Return the maximum-length sequence ``(2^order - 1,)`` of +1 and -1; its sum is +1.

    Example:
        >>> sequence(3)
        array([ 1,  1,  1, -1,  1, -1, -1])
    """
    from scipy.signal import max_len_seq

    return 2 * max_len_seq(order)[0].astype(int) - 1
