"""Disparity maps as they are used: unsigned, of one channel, and their range."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.importers.stereo.pfm import read_pfm


def read_disparity(path: Path) -> NDArray[np.float32]:
    """Read disparity without its sign; releases of the data sets differ in the sign, but never within a file.

    Returns:
        Pixels, ``(H, W)``, row 0 at the top; zero where no surface is seen.

    Raises:
        InputError: naming the file, when it is broken, has three channels or mixes both signs.
    """
    disparity = read_pfm(path)
    if disparity.ndim != 2:
        msg = f"{path} has three channels ('PF'); expected a disparity map with one ('Pf')"
        raise InputError(msg)
    if disparity.min() < 0 < disparity.max():
        msg = f"{path} mixes disparities of both signs ({disparity.min():g}..{disparity.max():g} px): expected one sign"
        raise InputError(msg)
    return np.abs(disparity)


def disparity_range(disparity: NDArray[np.float32], path: Path) -> tuple[float, float]:
    """Return the smallest and largest disparity that is not zero (zero means infinitely far: no surface).

    Raises:
        InputError: naming the file, when it is zero everywhere.
    """
    seen = disparity[disparity > 0]
    if seen.size == 0:
        msg = f"{path} is zero everywhere, so it says nothing about depth: leave this frame out"
        raise InputError(msg)
    return float(seen.min()), float(seen.max())
