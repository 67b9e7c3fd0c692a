"""Height maps and amplitudes that users bring as pictures or arrays: one grey map per file, in physical units.

The numbers of a file are read by ``measured_files``; here they become metres or amplitudes.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.measurements import read_measurement

_ROUNDING = 1e-6
MAX_RELIEF_M = 1e-2
"""Highest relief that is taken for a mask's, metres, as high as ``max_height_um`` may be; above it the unit is wrong."""


def read_height_map(path: Path, unit_m: float | None, max_height_m: float | None) -> NDArray[np.float32]:
    """Read a height map.

    Args:
        path: ``.png``, ``.tif``, ``.exr`` or ``.npy`` with one grey map, row 0 at the top.
        unit_m: metres per unit of a file of floats; None: its numbers are metres.
        max_height_m: height of the largest code (255 or 65535) of a file of integers, metres.

    Returns:
        ``(H, W)`` metres, as the file counts them.

    Raises:
        InputError: when the file is none of these, the scale is missing or of the other kind, or the relief is higher than
            ``MAX_RELIEF_M``.
    """
    numbers = _grey(path)
    if numbers.dtype.kind == "f":
        if max_height_m is not None:
            msg = (
                f"max_height_um: got {max_height_m * 1e6:g}, but {path} holds floats, whose height needs no largest code; "
                "use unit_um (micrometres per unit), or leave both out for metres"
            )
            raise InputError(msg)
        return _plausible(path, numbers * (1.0 if unit_m is None else unit_m))
    if unit_m is not None or max_height_m is None:
        msg = (
            f"max_height_um: missing for {path}, which holds integers of {8 * numbers.itemsize} bits; give the height of "
            f"the largest code, {_largest_code(numbers, path)}, in micrometres, in place of unit_um"
        )
        raise InputError(msg)
    return _plausible(path, numbers * (max_height_m / _largest_code(numbers, path)))


def read_unit_map(path: Path) -> NDArray[np.float32]:
    """Read a map of numbers from 0 to 1: floats as they are, integers as shares of their largest code (255 or 65535).

    Returns:
        ``(H, W)``, row 0 at the top.

    Raises:
        InputError: when the file is unreadable, in colour, or its numbers leave 0..1.
    """
    numbers = _grey(path)
    if numbers.dtype.kind != "f":
        return (numbers / _largest_code(numbers, path)).astype(np.float32)
    if numbers.min() < 0 or numbers.max() > 1:
        msg = f"{path} holds numbers from {numbers.min():g} to {numbers.max():g}; expected 0 (opaque) to 1 (open)"
        raise InputError(msg)
    return numbers.astype(np.float32)


def _plausible(path: Path, height_m: NDArray[Any]) -> NDArray[np.float32]:
    relief_m = float(np.ptp(height_m))
    if relief_m > MAX_RELIEF_M * (1 + _ROUNDING):
        msg = (
            f"{path} makes a relief of {relief_m * 1e3:.3g} mm, expected at most {MAX_RELIEF_M * 1e3:g} mm: give the unit "
            "of its numbers with unit_um (1 for micrometres, 0.001 for nanometres), or max_height_um for integers"
        )
        raise InputError(msg)
    return height_m.astype(np.float32)


def _grey(path: Path) -> NDArray[Any]:
    channels = read_measurement(path, ("R", "G", "B"))
    if any(not np.array_equal(channels[0], other) for other in channels[1:]):
        msg = f"{path} is in colour; expected one grey map: save it as grey, or as an .npy of shape (H, W)"
        raise InputError(msg)
    return channels[0]


def _largest_code(numbers: NDArray[Any], path: Path) -> int:
    if numbers.dtype not in (np.uint8, np.uint16):
        msg = f"{path} holds {numbers.dtype}; expected 8 or 16 bit unsigned integers, or floats"
        raise InputError(msg)
    return int(np.iinfo(numbers.dtype).max)
