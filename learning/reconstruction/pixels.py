"""Cropping and binning of pictures: one rule for measurements and for pictures of a PSF, which share a sensor."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError


def crop_window(crop: str, path: Path, shape: tuple[int, int], option: str = "crop") -> tuple[slice, slice]:
    """Return the rows and columns of a crop.

    Args:
        crop: ``ROWSxCOLUMNS`` about the centre, or ``ROWSxCOLUMNS+TOP+LEFT``.
        path: of the picture, for messages.
        shape: its rows and columns.
        option: the argument's name, for messages.

    Raises:
        InputError: another text, or a window beyond the picture.
    """
    found = re.fullmatch(r"(\d+)x(\d+)(?:\+(\d+)\+(\d+))?", crop.strip())
    if not found:
        msg = (
            f"{option}: got {crop!r}, expected ROWSxCOLUMNS (about the centre) or ROWSxCOLUMNS+TOP+LEFT, "
            "e.g. 1080x1440+60+80"
        )
        raise InputError(msg)
    sizes = (int(found[1]), int(found[2]))
    starts = [(whole - size) // 2 for whole, size in zip(shape, sizes, strict=True)]
    if found[3]:
        starts = [int(found[3]), int(found[4])]
    for start, size, whole in zip(starts, sizes, shape, strict=True):
        if size < 1 or start < 0 or start + size > whole:
            msg = (
                f"{option}: got {crop}, which reaches beyond {path} of {shape[0]} x {shape[1]} pixels; make it smaller"
            )
            raise InputError(msg)
    rows, columns = (slice(start, start + size) for start, size in zip(starts, sizes, strict=True))
    return rows, columns


def check_binning(binning: int, path: Path, shape: tuple[int, int], crop_option: str = "--crop") -> None:
    """Refuse a binning that leaves pixels over: dropped in silence, they would shift picture against PSF.

    Args:
        binning: pixels per side that become one.
        path: of the picture, for messages.
        shape: its rows and columns, cropped.
        crop_option: what cures it.

    Raises:
        InputError: it does not divide the size, or exceeds it.
    """
    rows, columns = shape
    if not 1 <= binning <= min(rows, columns):
        msg = f"binning: got {binning}, expected 1 to {min(rows, columns)} pixels per side for {path}"
        raise InputError(msg)
    if rows % binning or columns % binning:
        fitting = f"{rows // binning * binning}x{columns // binning * binning}"
        msg = (
            f"binning: got {binning}, which does not divide {path} of {rows} x {columns} pixels; "
            f"add {crop_option} {fitting}"
        )
        raise InputError(msg)


def binned(light: NDArray[np.floating[Any]], binning: int, path: Path) -> NDArray[np.float64]:
    """Return the mean of blocks, ``(C, H, W)`` to ``(C, H / binning, W / binning)``.

    Raises:
        InputError: see `check_binning`.
    """
    rows, columns = light.shape[-2:]
    check_binning(binning, path, (rows, columns))
    blocks = light.reshape(-1, rows // binning, binning, columns // binning, binning)
    return blocks.mean(axis=(2, 4), dtype=np.float64)
