"""Shutters that users bring as a table, in a file or from a function of theirs: when each physical row opens and closes."""

from __future__ import annotations

import csv
import io
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.camera.shutter import RowShutter
from simulator.errors import InputError
from simulator.io.files import read_text
from simulator.io.measurements import read_npy

_UNITS_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6}


def read_row_shutter(path: Path, rows: int, binning: int) -> RowShutter:
    """Return the shutter of a file, for a picture of so many rows.

    Args:
        path: as `read_row_windows` takes it.
        rows: of the picture.
        binning: physical rows per row of the picture.

    Raises:
        InputError: naming the file, and the row: as `read_row_windows`; another number of rows, no times, or a row that
            closes before it opens.
    """
    return row_shutter(read_row_windows(path), rows, binning, f"{path}: ")


def row_shutter(windows: Any, rows: int, binning: int, label: str) -> RowShutter:
    """Return the shutter of a table, ``(rows * binning, 2)`` seconds, for a picture of so many rows.

    Raises:
        InputError: beginning with the label, and naming the row.
    """
    try:
        table = np.asarray(windows, np.float64)
    except (TypeError, ValueError) as error:
        msg = f"{label}got {type(windows).__name__}, expected opening and closing of every row, seconds (rows, 2): {error}"
        raise InputError(msg) from error
    try:
        shutter = RowShutter(table, binning)
        shutter.physical_windows_s(rows * binning)
    except InputError as error:
        raise InputError(label + str(error).removeprefix("table_s: ")) from error
    return shutter


def read_row_windows(path: Path) -> NDArray[np.float64]:
    """Read opening and closing of every physical row, top first.

    Args:
        path: ``.csv``: two numbers per row, parted by a comma: seconds, or what a first line says, such as
            ``open_ms,close_ms`` (s, ms or us); lines that begin with # are remarks. ``.npy``: ``(rows, 2)`` seconds.

    Returns:
        ``(rows, 2)`` seconds; see `RowShutter` for what they must be.

    Raises:
        InputError: naming the file, and of a CSV the line.
    """
    kind = path.suffix.lower()
    if kind not in (".csv", ".npy"):
        msg = f"{path} is of a kind that is not read; expected .csv or .npy with opening and closing of every row"
        raise InputError(msg)
    if kind == ".csv":
        return _read_csv(path)
    windows = read_npy(path)
    if windows.ndim != 2 or windows.shape[1] != 2 or windows.dtype.kind not in "fiu":
        msg = (
            f"{path}: got {windows.dtype} {windows.shape}, expected opening and closing of every row, seconds (rows, 2)"
        )
        raise InputError(msg)
    return windows.astype(np.float64)


def _read_csv(path: Path) -> NDArray[np.float64]:
    windows: list[tuple[float, float]] = []
    units_s: tuple[float, float] | None = None
    for line, text in enumerate(read_text(path, "a table of rows").splitlines(), 1):
        if not text.strip() or text.lstrip().startswith("#"):
            continue
        cells = [cell.strip() for cell in next(csv.reader(io.StringIO(text)))]
        if units_s is None:
            units_s = _header(path, line, cells)
            if units_s is not None:
                continue
            units_s = 1.0, 1.0
        if len(cells) != 2:
            msg = f"{path}:{line}: got {len(cells)} cells, expected two: when the row opens and when it closes"
            raise InputError(msg)
        try:
            windows.append((float(cells[0]) * units_s[0], float(cells[1]) * units_s[1]))
        except ValueError:
            msg = (
                f"{path}:{line}: got {text.strip()[:60]!r}, expected two numbers: when the row opens and when it closes"
            )
            raise InputError(msg) from None
    if not windows:
        msg = f"{path}: holds no rows; expected one line per physical row of the sensor: when it opens and closes"
        raise InputError(msg)
    return np.array(windows)


def _header(path: Path, line: int, cells: list[str]) -> tuple[float, float] | None:
    """Return the units of both columns, seconds, if these cells are the header.

    Raises:
        InputError: a header that does not say opening, closing and their units, in this order.
    """
    if any(_is_number(cell) for cell in cells):
        return None
    names = [cell.lower().partition("_") for cell in cells]
    if [name for name, _, _ in names] != ["open", "close"] or any(unit not in _UNITS_S for _, _, unit in names):
        msg = (
            f"{path}:{line}: got {','.join(cells)!r}, expected two numbers parted by a comma, seconds, or the header "
            "open_s,close_s (or _ms, _us)"
        )
        raise InputError(msg)
    opening, closing = (_UNITS_S[unit] for _, _, unit in names)
    return opening, closing


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
