"""From a data set's camera to the view's pinhole: every ray of the view is looked up in the image.

Colour is the mean over each view pixel's footprint, in linear light; depth is that of the image's nearest pixel, so that
fore- and background never mix.

The black border of endoscopes' images, the circle that the lens fills, is found where all frames are dark.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from simulator.errors import InputError
from simulator.importers.camera_models import Lens, Pinhole
from simulator.types import View

Field: TypeAlias = Literal["fill", "angles"]
Circle: TypeAlias = tuple[float, float, float]
WIDEST_DEG = 70.0
"""Angle between the axis and the view's corners at which ``fill`` stops: a fisheye may see farther than any pinhole."""
_FINEST = 64
"""Most samples per side of a view pixel; images that shrink by more are read with gaps."""


@dataclass(frozen=True)
class Lookup:
    """Where a view's pixels are found in an image.

    Attributes:
        weights: ``(h w, H W)``: the mean over a view pixel's footprint; rows add up to the share of it that is seen. Where
            that is a rectangle of image pixels, ``(h, H)`` and ``(w, W)``, whose product it is.
        nearest: ``(h, w)`` index into the image's pixels of the one nearest to each view pixel's centre.
        seen: ``(h, w)`` whether the centre of a view pixel lies in the image.
        cosine: ``(h, w)`` of the angle between the image's ray and its optical axis.
        scale: tangents of the image's rays over those of the view's; 1 keeps angles.
        samples: per side of a view pixel.
    """

    weights: csr_array | tuple[csr_array, csr_array]
    nearest: NDArray[np.intp]
    seen: NDArray[np.bool_]
    cosine: NDArray[np.float64]
    scale: float
    samples: int

    def colour(self, linear: NDArray[np.float32]) -> NDArray[np.float32]:
        """Resample linear light ``(H, W, 3)`` -> ``(h, w, 3)``; black where nothing is seen."""
        if isinstance(self.weights, tuple):
            down, across = self.weights
            strips = (down @ linear.reshape(len(linear), -1)).reshape(self.seen.shape[0], -1, 3)
            flat = across @ strips.swapaxes(0, 1).reshape(strips.shape[1], -1)
            return flat.reshape(-1, len(strips), 3).swapaxes(0, 1).astype(np.float32)
        flat = self.weights @ linear.reshape(-1, 3).astype(np.float64)
        return flat.reshape(*self.seen.shape, 3).astype(np.float32)


@lru_cache(maxsize=4)
def build_lookup(lens: Lens, shape: tuple[int, int], view: View, field: Field, circle: Circle | None) -> Lookup:
    """Work out where each view pixel is found; kept for the next clip, since all of a source share it.

    Args:
        lens: the image's camera.
        shape: rows and columns of the image.
        view: the view to fill.
        field: ``angles`` keeps each ray's direction; ``fill`` multiplies all tangents by the largest number at which every
            pixel of the view is seen, as if the image had been taken with another focal length; at most 70 degrees.
        circle: column, row and radius in pixels of the part of the image that shows anything; None is all of it.

    Raises:
        InputError: when the view's axis is not in the image.
    """
    if not _seen(*lens.pixels(np.zeros(1), np.zeros(1)), shape, circle)[0]:
        column, row = lens.centre
        raise InputError(
            "intrinsics",
            f"the axis, column {column:g}, row {row:g}, is outside the image of {shape}",
        )
    scale = 1.0 if field == "angles" else _fill_scale(lens, shape, view, circle)
    x, y = (scale * tangents for tangents in _tangents(view, 1))
    columns, rows = lens.pixels(x, y)
    samples = _samples(columns, rows)
    seen = _seen(columns, rows, shape, circle)
    column, row = (
        np.clip(np.rint(np.where(seen, values, 0)), 0, size - 1).astype(np.intp)
        for values, size in ((columns, shape[1]), (rows, shape[0]))
    )
    nearest = row * shape[1] + column
    x_fine, y_fine = (scale * tangents for tangents in _tangents(view, samples))
    if circle is None and isinstance(lens, Pinhole) and not any(lens.distortion):  # a thousandth of the entries
        columns, rows = (
            lens.pixels(x_fine[0], np.zeros(x_fine.shape[1]))[0],
            lens.pixels(np.zeros(len(y_fine)), y_fine[:, 0])[1],
        )
        weights = _weights_along(rows, shape[0], samples), _weights_along(columns, shape[1], samples)
    else:
        weights = _weights(*lens.pixels(x_fine, y_fine), shape, circle, samples)
    return Lookup(weights, nearest, seen, 1 / np.sqrt(1 + x**2 + y**2), scale, samples)


def _tangents(view: View, samples: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Tangents to the right and downwards at ``samples x samples`` points in each pixel of the view."""
    pitch = view.pixel_pitch_m / view.distance_m / samples
    height, width = (size * samples for size in view.shape)
    rows, columns = np.indices((height, width), dtype=np.float64)
    return (columns - (width - 1) / 2) * pitch, (rows - (height - 1) / 2) * pitch


def _seen(
    columns: NDArray[np.float64], rows: NDArray[np.float64], shape: tuple[int, int], circle: Circle | None
) -> NDArray[np.bool_]:
    """Whether points lie on a pixel of the image, and inside the circle."""
    with np.errstate(invalid="ignore"):  # NaN, where the lens sees no such ray, compares as false
        inside = (np.abs(columns - (shape[1] - 1) / 2) <= shape[1] / 2) & (
            np.abs(rows - (shape[0] - 1) / 2) <= shape[0] / 2
        )
        if circle is not None:
            inside &= np.hypot(columns - circle[0], rows - circle[1]) <= circle[2]
    return inside


def _fill_scale(lens: Lens, shape: tuple[int, int], view: View, circle: Circle | None) -> float:
    """The largest factor at which the view's outline, corners of its outer pixels included, is seen."""
    half_width, half_height = view.tan_half_width, view.tan_half_height
    along = np.linspace(-1, 1, 257)
    x = half_width * np.concatenate([along, along, np.full(257, -1.0), np.full(257, 1.0)])
    y = half_height * np.concatenate([np.full(257, -1.0), np.full(257, 1.0), along, along])
    radii = np.linspace(0, 1, 65)[1:]

    def filled(scale: float) -> bool:
        # All of the way from the axis to the outline: a circle or a lens may be seen again farther out.
        columns, rows = lens.pixels(scale * np.outer(radii, x), scale * np.outer(radii, y))
        return bool(_seen(columns, rows, shape, circle).all())

    low, high = 0.0, np.tan(np.radians(WIDEST_DEG)) / np.hypot(half_width, half_height)
    if filled(high):
        return float(high)
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if filled(middle) else (low, middle)
    return low


def _samples(columns: NDArray[np.float64], rows: NDArray[np.float64]) -> int:
    """Samples per side of a view pixel at which neighbouring ones are at most an image pixel apart."""
    steps = [np.nanmax(np.hypot(np.diff(columns, axis=axis), np.diff(rows, axis=axis)), initial=0.0) for axis in (0, 1)]
    return int(np.clip(np.ceil(max(steps) - 1e-6), 1, _FINEST))


def _weights(
    columns: NDArray[np.float64], rows: NDArray[np.float64], shape: tuple[int, int], circle: Circle | None, samples: int
) -> csr_array:
    """The mean of bilinear samples in each view pixel, as a matrix; samples that see nothing are black."""
    height, width = rows.shape[0] // samples, rows.shape[1] // samples
    pixel = np.repeat(np.repeat(np.arange(height * width).reshape(height, width), samples, 0), samples, 1)
    seen = _seen(columns, rows, shape, circle)
    pixel, column, row = pixel[seen], columns[seen], rows[seen]
    # The outermost half pixel has its light from the one pixel beside it.
    column, row = np.clip(column, 0, shape[1] - 1), np.clip(row, 0, shape[0] - 1)
    left = np.minimum(column.astype(np.intp), max(shape[1] - 2, 0))
    top = np.minimum(row.astype(np.intp), max(shape[0] - 2, 0))
    right_share, lower_share = column - left, row - top
    entries = [
        (share, (top + down) * shape[1] + left + across)
        for down, vertical in ((0, 1 - lower_share), (1, lower_share))
        for across, horizontal in ((0, 1 - right_share), (1, right_share))
        for share in (vertical * horizontal / samples**2,)
    ]
    shares = np.concatenate([share for share, _ in entries])
    sources = np.concatenate([source for _, source in entries])
    size = (height * width, shape[0] * shape[1])
    return csr_array((shares, (np.tile(pixel, 4), sources)), shape=size)


def _weights_along(places: NDArray[np.float64], size: int, samples: int) -> csr_array:
    """The same along one axis of the image: ``(n samples,)`` places -> ``(n, size)``."""
    pixel = np.arange(places.size) // samples
    seen = np.abs(places - (size - 1) / 2) <= size / 2
    pixel, place = pixel[seen], np.clip(places[seen], 0, size - 1)
    first = np.minimum(place.astype(np.intp), max(size - 2, 0))
    second = np.minimum(first + 1, size - 1)
    shares = np.concatenate([1 - (place - first), place - first]) / samples
    where = np.tile(pixel, 2), np.concatenate([first, second])
    return csr_array((shares, where), shape=(places.size // samples, size))


DARK_CODE = 12
"""Highest 8 bit sRGB code that counts as black: 0.4 % of white, where compression leaves its traces."""
_LEAST_SHARE = 0.005
_MARGIN_PX = 1.5
_RESIDUAL_PX = 1.5


def find_circle(images: Sequence[NDArray[np.uint8] | NDArray[np.uint16]], name: str) -> Circle | None:
    """Find the circle outside which all images of one camera, sRGB codes ``(H, W, 3)``, are black.

    Returns:
        Column, row and radius in pixels, 1.5 pixels within the edge, since the lens fades out there; None when less than
        0.5 % of the image is black from its rim inwards.

    Raises:
        InputError: when what is black is not bounded by a circle.
    """
    from scipy.ndimage import label

    brightest = np.max([image.max(axis=-1) / np.iinfo(image.dtype).max for image in images], axis=0)
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
        # A straight rim is an arc of a huge circle, whose centre lies outside the image.
        centred = abs(column / dark.shape[1] - 0.5) < 0.5 and abs(row / dark.shape[0] - 0.5) < 0.5
        if centred and np.median(np.abs(miss)) <= _RESIDUAL_PX:
            return column, row, radius - _MARGIN_PX
    raise InputError(
        "border",
        f"the black rim of {name} is not bounded by a circle: give [column, row, radius] in pixels, or none",
    )


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
