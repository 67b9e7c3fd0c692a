"""Height maps and amplitudes that users bring: images or arrays in physical units, or the upper surface of an STL body."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import require_mask_memory
from simulator.design.solid import MAX_SIDE, MAX_TRIANGLES
from simulator.errors import InputError
from simulator.io.measurements import read_measurement

# ---- images and arrays

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
            raise InputError(
                "max_height_um",
                f"got {max_height_m * 1e6:g}, but {path} holds floats; use unit_um (micrometres per unit), or neither "
                "for metres",
            )
        return _plausible(path, numbers * (1.0 if unit_m is None else unit_m))
    if unit_m is not None or max_height_m is None:
        raise InputError(
            "max_height_um",
            f"missing: {path} holds integers; give the height of code {_largest_code(numbers, path)}, in place of unit_um",
        )
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
        raise InputError(path, f"got {numbers.min():g} to {numbers.max():g}, expected 0 (opaque) to 1 (open)")
    return numbers.astype(np.float32)


def _plausible(path: Path, height_m: NDArray[Any]) -> NDArray[np.float32]:
    relief_m = float(np.ptp(height_m))
    if relief_m > MAX_RELIEF_M * (1 + _ROUNDING):
        raise InputError(
            path,
            f"makes a relief of {relief_m * 1e3:.3g} mm, expected at most {MAX_RELIEF_M * 1e3:g} mm: give the unit of "
            "its numbers with unit_um (1 is micrometres, 0.001 nanometres), or max_height_um for integers",
        )
    return height_m.astype(np.float32)


def _grey(path: Path) -> NDArray[Any]:
    channels = read_measurement(path, ("R", "G", "B"))
    if any(not np.array_equal(channels[0], other) for other in channels[1:]):
        raise InputError(path, "in colour; expected one grey map: save it as grey, or as an .npy of shape (H, W)")
    return channels[0]


def _largest_code(numbers: NDArray[Any], path: Path) -> int:
    if numbers.dtype not in (np.uint8, np.uint16):
        raise InputError(path, f"holds {numbers.dtype}; expected 8 or 16 bit unsigned integers, or floats")
    return int(np.iinfo(numbers.dtype).max)


# ---- STL bodies

Triangles = NDArray[np.float64]
_AREA_TOLERANCE = 1e-4  # of the rectangle: what single precision leaves between neighbouring triangles
_FLAT = 1e-5  # of the body's height: a bottom that is this level is flat
_EDGE = 1e-6  # of a sample: a sample on an edge belongs to both of its triangles
_SPANS = 200_000  # rows of triangles filled at a time


def read_stl_height(path: Path, pitch_m: float, unit_m: float) -> NDArray[np.float32]:
    """Read the upper surface of a body, sampled in the middle of mask pixels.

    Args:
        path: an STL file, binary or text; x right, y up, z along the height.
        pitch_m: mask pixel, metres; the pixels are centred on the body, a rest narrower than a pixel is left out.
        unit_m: metres per unit of the file.

    Returns:
        ``(H, W)`` metres above the lowest sample, row 0 at the top (largest y).

    Raises:
        InputError: naming why it is not a height map: an overhang, a hole, an outline that is not a rectangle, surfaces
            above each other; or a file that is not STL.
    """
    triangles = _triangles(path)
    triangles *= unit_m
    low, high = triangles.min((0, 1)), triangles.max((0, 1))
    area = _projected_area(triangles)
    _refuse_overhangs(path, triangles, area, low, high)
    _refuse_other_outlines(path, float(area[area > 0].sum()), low, high)
    upper = triangles[area > 0]
    del triangles  # bodies take gigabytes
    columns, rows = (int(extent / pitch_m + _EDGE) for extent in (high - low)[:2])
    if not (1 <= rows <= MAX_SIDE and 1 <= columns <= MAX_SIDE):
        size = " x ".join(f"{extent * 1e3:.3g}" for extent in (high - low)[:2])
        raise InputError(
            "pixel_um",
            f"got {pitch_m * 1e6:g} for {path} of {size} mm: {rows} x {columns} pixels, expected 1 to {MAX_SIDE} per "
            f"side; change pixel_um, or unit_um (one unit of the file is {unit_m * 1e6:g} um)",
        )
    require_mask_memory((rows, columns))
    middle = (low + high) / 2
    height = _rasterise(upper, middle, rows, columns, pitch_m)
    if not np.all(np.isfinite(height)):
        missing = int(np.count_nonzero(~np.isfinite(height)))
        raise InputError(path, f"not a height map: a hole over {missing} of {height.size} mask pixels; close it")
    return (height - height.min()).astype(np.float32)


def _triangles(path: Path) -> Triangles:
    """``(N, 3, 3)`` corners as the file holds them."""
    from trimesh.exchange.stl import load_stl

    try:
        if path.stat().st_size > 300 * MAX_TRIANGLES:  # a triangle takes 50 bytes, or about 250 as text
            raise InputError(path, f"larger than {MAX_TRIANGLES} triangles; simplify or crop it")
        with path.open("rb") as file:
            content = load_stl(file)  # not through a mesh, whose indices would take several times the memory
        # Corner by corner, in the order of the faces; a text file that holds several bodies lists them by name.
        bodies = list(content["geometry"].values()) if "geometry" in content else [content]
        corners = [np.empty((0, 3, 3)), *(body["vertices"].reshape(-1, 3, 3) for body in bodies)]
        triangles = np.concatenate(corners, dtype=np.float64)
    except InputError:
        raise
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}") from error
    # trimesh reports damage by many kinds of exceptions; whatever it is, the file cannot be used.
    except Exception as error:
        raise InputError(path, f"not readable as STL ({type(error).__name__}: {error}): export it again") from error
    if len(triangles) == 0 or not np.all(np.isfinite(triangles)):
        raise InputError(path, f"{len(triangles)} triangles, none or some non-finite: is it STL? Export it again")
    return triangles


def _projected_area(triangles: Triangles) -> NDArray[np.float64]:
    """Return each triangle's area seen from above, square metres, negative when it faces down."""
    first, second = triangles[:, 1, :2] - triangles[:, 0, :2], triangles[:, 2, :2] - triangles[:, 0, :2]
    return (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2


def _refuse_overhangs(
    path: Path, triangles: Triangles, area: NDArray[np.float64], low: NDArray[np.float64], high: NDArray[np.float64]
) -> None:
    raised = triangles[:, :, 2].max(1) > low[2] + _FLAT * (high[2] - low[2])
    hanging = float(-area[(area < 0) & raised].sum())
    if hanging > _AREA_TOLERANCE * np.prod((high - low)[:2]):
        raise InputError(
            path,
            f"not a height map: {hanging * 1e6:.3g} mm2 overhang (face down above a flat bottom); make the bottom flat "
            "and the surface single-valued in z, or turn the body or its normals over if it lies upside down",
        )


def _refuse_other_outlines(path: Path, area_m2: float, low: NDArray[np.float64], high: NDArray[np.float64]) -> None:
    rectangle_m2 = float(np.prod((high - low)[:2]))
    if area_m2 < (1 - _AREA_TOLERANCE) * rectangle_m2:
        missing = f"{(rectangle_m2 - area_m2) * 1e6:.3g} of {rectangle_m2 * 1e6:.3g} mm2"
        raise InputError(path, f"not a height map: it leaves out {missing} of its rectangle; fill holes and corners")
    if area_m2 > (1 + _AREA_TOLERANCE) * rectangle_m2 or rectangle_m2 == 0:
        raise InputError(
            path,
            f"not a height map: its upper surfaces cover {area_m2 * 1e6:.3g} mm2 of a rectangle of "
            f"{rectangle_m2 * 1e6:.3g} mm2, so some lie above each other; keep one surface z(x, y)",
        )


def _rasterise(
    triangles: Triangles, middle_m: NDArray[np.float64], rows: int, columns: int, pitch_m: float
) -> NDArray[np.float64]:
    """Return the highest surface at each sample ``(rows, columns)``, -inf where there is none; scanline by scanline."""
    # In samples: column and row of the first sample are zero, rows go down.
    column = (triangles[:, :, 0] - middle_m[0]) / pitch_m + (columns - 1) / 2
    row = (middle_m[1] - triangles[:, :, 1]) / pitch_m + (rows - 1) / 2
    first = np.clip(np.ceil(row.min(1) - _EDGE), 0, rows).astype(np.int64)
    last = np.clip(np.floor(row.max(1) + _EDGE), -1, rows - 1).astype(np.int64)
    height = np.full(rows * columns, -np.inf)
    crossed = np.maximum(last - first + 1, 0)
    ends = np.cumsum(crossed)
    for start in range(0, int(ends[-1]), _SPANS):
        span = np.arange(start, min(start + _SPANS, int(ends[-1])))
        owner = np.searchsorted(ends, span, side="right")
        at = first[owner] + span - (ends[owner] - crossed[owner])
        _fill_spans(height, columns, column[owner], row[owner], triangles[owner, :, 2], at)
    return height.reshape(rows, columns)


def _fill_spans(
    height: NDArray[np.float64],
    columns: int,
    column: NDArray[np.float64],
    row: NDArray[np.float64],
    z: NDArray[np.float64],
    at: NDArray[np.int64],
) -> None:
    """Raise the samples of row ``at`` inside each triangle (corners ``(N, 3)``) to the triangle's plane."""
    onto = at[:, None]
    rise = np.roll(row, -1, 1) - row
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (onto - row) / rise
        crossing = column + share * (np.roll(column, -1, 1) - column)
    meets = (rise != 0) & (share >= -_EDGE) & (share <= 1 + _EDGE)
    left = np.where(meets, crossing, np.inf).min(1)
    right = np.where(meets, crossing, -np.inf).max(1)
    first = np.clip(np.ceil(left - _EDGE), 0, columns)
    count = np.maximum(np.clip(np.floor(right + _EDGE), -1, columns - 1) - first + 1, 0).astype(np.int64)
    owner = np.repeat(np.arange(len(at)), count)
    sample = first[owner].astype(np.int64) + np.arange(len(owner)) - (np.cumsum(count) - count)[owner]
    # The plane z0 + slope_c (c - c0) + slope_r (r - r0) through the three corners, by Cramer's rule.
    c1, c2 = (column[:, k] - column[:, 0] for k in (1, 2))
    r1, r2 = (row[:, k] - row[:, 0] for k in (1, 2))
    z1, z2 = (z[:, k] - z[:, 0] for k in (1, 2))
    area = c1 * r2 - c2 * r1
    along_columns, along_rows = (z1 * r2 - z2 * r1) / area, (c1 * z2 - c2 * z1) / area
    value = (
        z[owner, 0] + along_columns[owner] * (sample - column[owner, 0]) + along_rows[owner] * (at - row[:, 0])[owner]
    )
    np.maximum.at(height, at[owner] * columns + sample, value)
