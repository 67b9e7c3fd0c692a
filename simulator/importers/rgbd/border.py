"""The black border of endoscopes' pictures: the circle that the lens fills, found where all frames are dark."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.importers.rgbd.undistort import Circle

DARK_CODE = 12
"""Highest 8 bit sRGB code that counts as black: 0.4 % of white, where compression leaves its traces."""
_LEAST_SHARE = 0.005
_MARGIN_PX = 1.5
_RESIDUAL_PX = 1.5


def find_circle(pictures: Sequence[NDArray[np.uint8] | NDArray[np.uint16]], name: str) -> Circle | None:
    """Find the circle outside which all pictures are black.

    Args:
        pictures: sRGB codes ``(H, W, 3)`` of one camera.
        name: the sequence, for the message.

    Returns:
        Column, row and radius in pixels, 1.5 pixels within the edge, since the lens fades out there; None when less than
        0.5 % of the picture is black from its rim inwards.

    Raises:
        InputError: when what is black is not bounded by a circle.
    """
    from scipy.ndimage import label

    brightest = np.max([picture.max(axis=-1) / np.iinfo(picture.dtype).max for picture in pictures], axis=0)
    dark = brightest <= DARK_CODE / 255
    regions = np.empty(dark.shape, np.int32)
    label(dark, output=regions)
    rim = np.concatenate([regions[0], regions[-1], regions[:, 0], regions[:, -1]])
    border = np.isin(regions, np.unique(rim[rim > 0]))
    if border.mean() < _LEAST_SHARE:
        return None
    columns, rows = _edge_points(border)
    circle = _fit(columns, rows) if columns.size >= 8 else None
    if circle is not None:
        column, row, radius = circle
        miss = np.hypot(columns - column, rows - row) - radius
        # A straight rim is an arc of a huge circle, whose centre lies outside the picture.
        centred = abs(column / dark.shape[1] - 0.5) < 0.5 and abs(row / dark.shape[0] - 0.5) < 0.5
        if centred and np.median(np.abs(miss)) <= _RESIDUAL_PX:
            return column, row, radius - _MARGIN_PX
    msg = (
        f"border: the black rim of {name}'s pictures ({100 * border.mean():.1f} % of them) is bounded by no circle: give "
        "border: [column, row, radius] in pixels, or border: none"
    )
    raise InputError(msg)


def _edge_points(border: NDArray[np.bool_]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Columns and rows half-way between border pixels and the neighbours that show something."""
    points = []
    for axis in (0, 1):
        rows, columns = np.nonzero(np.diff(border, axis=axis))
        points.append(np.stack([columns + 0.5 * (axis == 1), rows + 0.5 * (axis == 0)]))
    columns, rows = np.concatenate(points, axis=1)
    return columns, rows


def _fit(columns: NDArray[np.float64], rows: NDArray[np.float64]) -> Circle:
    """Algebraic circle fit, twice: x^2 + y^2 = 2 a x + 2 b y + c; points far from the first fit are left out."""
    keep = np.ones(columns.size, bool)
    column = row = radius = 0.0
    for _ in range(2):
        matrix = np.stack([2 * columns[keep], 2 * rows[keep], np.ones(int(keep.sum()))], axis=1)
        (column, row, constant), *_ = np.linalg.lstsq(matrix, columns[keep] ** 2 + rows[keep] ** 2)
        radius = np.sqrt(max(constant + column**2 + row**2, 0.0))
        miss = np.abs(np.hypot(columns - column, rows - row) - radius)
        keep = miss <= max(3 * float(np.median(miss)), 1.0)
    return float(column), float(row), float(radius)
