"""Reading portable float maps (.pfm), the format of the SceneFlow data sets' disparities.

Source: Paul Debevec's PFM description: ``Pf`` (one channel) or ``PF`` (three), width and height, scale (negative means
little endian), then float32 rows from the bottom up.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError

MAX_PIXELS = 200_000_000
"""Largest map that is read; the header is judged before anything is allocated."""

_HEADER = re.compile(rb"(P[fF])\s+(\S+)\s+(\S+)\s+(\S+)\s")
_HEADER_BYTES = 256


def read_pfm(path: Path) -> NDArray[np.float32]:
    """Read one PFM file.

    The scale's sign gives the byte order; its magnitude, a display hint, is not applied.

    Args:
        path: the file.

    Returns:
        float32 ``(H, W)`` for ``Pf`` or ``(H, W, 3)`` for ``PF``, row 0 at the top, all finite.

    Raises:
        InputError: naming the file, when it is missing, is no PFM, has a bad header, the wrong length or values that
            are not finite.
    """
    try:
        content = _checked_bytes(path)
    except OSError as error:
        msg = f"{path} cannot be read: {error.strerror or error}"
        raise InputError(msg) from error
    (height, width, channels, order), data = content
    values = np.frombuffer(data, dtype=f"{order}f4").astype(np.float32).reshape(height, width, channels)
    if not np.all(np.isfinite(values)):
        bad = int(np.count_nonzero(~np.isfinite(values)))
        msg = f"{path} holds {bad} values that are NaN or infinite; expected finite numbers: leave this frame out"
        raise InputError(msg)
    upright = np.ascontiguousarray(values[::-1])
    return upright[..., 0] if channels == 1 else upright


def pfm_shape(path: Path) -> tuple[int, int]:
    """Rows and columns of a PFM file, from its header alone.

    Raises:
        InputError: when the header is not that of a PFM file.
    """
    try:
        with path.open("rb") as file:
            (height, width, _, _), _ = _parse_header(file.read(_HEADER_BYTES), path)
    except OSError as error:
        msg = f"{path} cannot be read: {error.strerror or error}"
        raise InputError(msg) from error
    return height, width


def _checked_bytes(path: Path) -> tuple[tuple[int, int, int, str], bytes]:
    """Header numbers and the data's bytes, whose count is right."""
    size = path.stat().st_size
    with path.open("rb") as file:
        header, start = _parse_header(file.read(_HEADER_BYTES), path)
        height, width, channels, _ = header
        expected = 4 * height * width * channels
        if size - start != expected:
            kind = "cut short" if size - start < expected else "too long"
            msg = (
                f"{path} is {kind}: {size - start} bytes of data for {height} x {width} x {channels} values, "
                f"expected {expected}: fetch it again"
            )
            raise InputError(msg)
        file.seek(start)
        return header, file.read(expected)


def _parse_header(head: bytes, path: Path) -> tuple[tuple[int, int, int, str], int]:
    """``(height, width, channels, byte order)`` and the offset of the data."""
    match = _HEADER.match(head)
    if match is None:
        msg = f"{path} is not a PFM file: expected 'Pf' or 'PF', a width, a height and a scale, got {head[:24]!r}"
        raise InputError(msg)
    magic, *numbers = (part.decode("ascii", "replace") for part in match.groups())
    try:
        width, height, scale = int(numbers[0]), int(numbers[1]), float(numbers[2])
    except ValueError:
        msg = f"{path} has a bad PFM header: expected width, height and scale as numbers, got {' '.join(numbers)!r}"
        raise InputError(msg) from None
    if width <= 0 or height <= 0 or width * height > MAX_PIXELS:
        msg = (
            f"{path} claims {height} x {width} pixels; expected positive sizes of at most {MAX_PIXELS} pixels together"
        )
        raise InputError(msg)
    if scale == 0 or not math.isfinite(scale):
        msg = f"{path} has a PFM scale of {numbers[2]}; expected a finite number, not zero (its sign is the byte order)"
        raise InputError(msg)
    return (height, width, 3 if magic == "PF" else 1, "<" if scale < 0 else ">"), match.end()
