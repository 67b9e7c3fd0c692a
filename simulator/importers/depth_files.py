"""One number for each pixel from any file: depth, disparity or code, those that are unknown as they are stored."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.importers.disparity import read_pfm
from simulator.io.exr import read_exr
from simulator.io.images import read_image
from simulator.io.measurements import read_npy, read_tiff

DEPTH_SUFFIXES = frozenset((".exr", ".npy", ".pfm", ".pgm", ".png", ".tif", ".tiff"))
"""Endings of files without loss, by which depth charts are found in folders."""


def read_chart(path: Path) -> NDArray[Any]:
    """Read a chart of depths, disparities or codes without loss.

    Of colour images all channels must be the same, alpha is ignored. Of an EXR file it is the only channel, or the one named
    Z, as renderers do, or the same R, G and B.

    Returns:
        ``(H, W)``, whole numbers, or floating point in which NaN and inf stay what they are.

    Raises:
        InputError: naming the file, when it is missing, broken or holds anything else.
    """
    readers = {".exr": _read_exr, ".npy": read_npy, ".pfm": read_pfm, ".tif": read_tiff, ".tiff": read_tiff}
    values = one_channel(readers.get(path.suffix.lower(), read_image)(path), path)
    if values.ndim != 2 or values.dtype.kind not in "iuf" or not values.size:
        what = f"{values.dtype} {' x '.join(map(str, values.shape))}"
        raise InputError(path, f"got {what}; expected one number for each pixel, rows x columns")
    return values


def one_channel(values: NDArray[Any], path: Path) -> NDArray[Any]:
    """Return the one channel that colour channels repeat, ``(H, W, 1 to 4)`` -> ``(H, W)``.

    The second of two, and a fourth, is alpha.

    Raises:
        InputError: naming the file, when channels differ.
    """
    if values.ndim != 3:
        return values
    first = values[..., 0]
    others = (1, 2) if values.shape[2] > 2 else ()
    if not all(np.array_equal(first, values[..., channel], equal_nan=True) for channel in others):
        raise InputError(path, "it has coloured pixels; expected a depth chart in grey, with red = green = blue")
    return first


def _read_exr(path: Path) -> NDArray[np.float32]:
    channels, _ = read_exr(path, finite=False)
    if len(channels) == 1:
        return next(iter(channels.values()))
    of_depth = [name for name in channels if name.rpartition(".")[2] == "Z"]
    if len(of_depth) == 1:
        return channels[of_depth[0]]
    if set("RGB") <= channels.keys():
        return np.stack([channels[name] for name in "RGB"], axis=-1)
    raise InputError(path, f"its channels are {', '.join(channels)}; expected a single one, Z, or the same R, G and B")
