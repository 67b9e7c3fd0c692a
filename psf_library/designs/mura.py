"""MURA: a modified uniformly redundant array, half open (Gottesman and Fenimore, Appl. Opt. 28, 4344, 1989)."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from simulator.design import patterns as amplitude_mask
from simulator.errors import InputError
from simulator.optics.mask import Mask


def mura(
    *,
    rank: Annotated[int, Field(ge=3, le=997)] = 101,
    feature_um: Annotated[float, Field(ge=0.5, le=500)] = 30.0,
    pixel_um: Annotated[float, Field(ge=0.1, le=20)] = 2.0,
    cyclic: bool = False,
) -> Mask:
    """Return the square array of a prime rank: its periodic correlation with its decoding array is a delta, exactly.

    Args:
        rank: features per side, an odd prime.
        feature_um: side of a feature.
        pixel_um: sample of the grid; a feature is a whole number of them. 2 um keeps the sampling error near 2 % on sensor
            pixels of 9.6 um and more.
        cyclic: repeat the array to twice its size less one feature, so that each direction of the scene sees a whole
            period: then the correlation is periodic.
    """
    pattern = coded_array(rank)
    pattern = amplitude_mask.cyclic(pattern) if cyclic else pattern
    return amplitude_mask.amplitude_mask(pattern, feature_um * 1e-6, pixel_um * 1e-6, "mura")


def coded_array(rank: int) -> NDArray[np.int64]:
    """Return the array of 1 (open) and 0, ``(rank, rank)``; Gottesman and Fenimore, eq. 5.

    Example:
        >>> coded_array(5)
        array([[0, 0, 0, 0, 0],
               [1, 1, 0, 0, 1],
               [1, 0, 1, 1, 0],
               [1, 0, 1, 1, 0],
               [1, 1, 0, 0, 1]])

    Raises:
        InputError: when the rank is not an odd prime.
    """
    if rank < 3 or any(rank % divisor == 0 for divisor in range(2, int(rank**0.5) + 1)):
        raise InputError("rank", f"got {rank}, expected an odd prime (for example 31, 61, 101, 127 or 251)")
    residue = np.full(rank, -1)
    residue[np.arange(1, rank) ** 2 % rank] = 1
    array = (np.outer(residue, residue) == 1).astype(np.int64)
    array[:, 0] = 1
    array[0] = 0
    return array


def decoding_array(rank: int) -> NDArray[np.int64]:
    """Return what to correlate with, +1 and -1, ``(rank, rank)``; Gottesman and Fenimore, eq. 6.

    Raises:
        InputError: when the rank is not an odd prime.
    """
    array = 2 * coded_array(rank) - 1
    array[0, 0] = 1
    return array
