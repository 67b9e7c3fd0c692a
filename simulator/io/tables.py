"""Reading tables of numbers (CSV), as data sheets, spectrometers, databases and spreadsheets export them."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.files import read_text
from simulator.text import show

NM, UM = 1e-9, 1e-6
_UNITS = (
    (r"\b(nm|nanomet(er|re)s?)\b", NM),
    (r"\b(um|µm|μm|micromet(er|re)s?|microns?)\b", UM),
    (r"\b(a|å|aa|angstroms?|ångströms?)\b", 1e-10),
)
_SHORTEST_M, _LONGEST_M = 10e-9, 10e-3


@dataclass(frozen=True)
class NumberTable:
    """A table's numbers and what its file says of them.

    Attributes:
        values: ``(rows, columns)``, finite.
        header: one name per column, or None for a table without a header.
        remarks: its comment lines.
    """

    values: NDArray[np.float64]
    header: tuple[str, ...] | None
    remarks: str


def read_number_table(path: Path, row: str, columns: int | None = None, least: int = 1) -> NumberTable:
    """Read a CSV file of numbers.

    Columns are parted by commas, semicolons, tabs or blanks; lines that begin with # are remarks. A first line that does not
    begin with a number is the header.

    Args:
        path: the file.
        row: what the numbers of a row are, for the messages, such as ``opening and closing``.
        columns: how many there are; None takes as many as the first row has, at least two.
        least: number of rows.

    Raises:
        InputError: naming the file and the line.
    """
    lines = [(n, line.strip()) for n, line in enumerate(read_text(path, "a table of numbers").splitlines(), 1)]
    remarks = " ".join(line.lstrip("# ") for _, line in lines if line.startswith("#"))
    rows = [(n, line, _cells(line)) for n, line in lines if line and not line.startswith("#")]
    header = tuple(rows.pop(0)[2]) if rows and np.isnan(_number(rows[0][2][0])) else None
    wanted = columns or max([2, *(len(cells) for _, _, cells in rows[:1])])
    values = [[_number(cell) for cell in cells] for _, _, cells in rows]
    for (n, line, _), numbers in zip(rows, values, strict=True):
        if len(numbers) != wanted or not np.all(np.isfinite(numbers)):
            raise InputError(f"{path}:{n}", f"got {show(line)}, expected {wanted} finite numbers: {row}")
    if len(values) < least:
        raise InputError(path, f"got {len(values)} rows of numbers, expected at least {least}: {row}")
    if header is not None and len(header) != wanted:
        raise InputError(path, f"its header names {len(header)} columns, but the rows hold {wanted}")
    return NumberTable(np.array(values, np.float64), header, remarks)


@dataclass(frozen=True)
class WavelengthTable:
    """Columns of numbers against the wavelength.

    Attributes:
        wavelengths_m: ``(N,)`` metres, strictly increasing.
        columns: ``(N, C)`` finite numbers.
        names: one per column, or None for a table without a header.
        remarks: its comment lines.
    """

    wavelengths_m: NDArray[np.float64]
    columns: NDArray[np.float64]
    names: tuple[str, ...] | None
    remarks: str


def read_wavelength_table(path: Path, unit_m: float | None = None) -> WavelengthTable:
    """Read a CSV file whose first column is the wavelength.

    The header, if there is one, may say the wavelength's unit: ``wavelength_nm``, ``lambda (um)``, ``Wavelength [Angstrom]``.

    Args:
        path: the file.
        unit_m: the wavelengths' unit where the header names none, metres; None refuses such a table.

    Raises:
        InputError: as `read_number_table`, and for wavelengths without a unit or that `ordered` refuses.
    """
    table = read_number_table(path, "a wavelength and its values", least=2)
    wavelengths_m = table.values[:, 0] * _unit_m(path, table.header[0] if table.header else "", unit_m)
    names = table.header[1:] if table.header else None
    return WavelengthTable(*ordered(path, wavelengths_m, table.values[:, 1:]), names, table.remarks)


def ordered(
    path: Path, wavelengths_m: NDArray[np.float64], columns: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return wavelengths and columns from the shortest wavelength on.

    Raises:
        InputError: naming the file, for a wavelength that comes twice or is of no optical order.
    """
    order = np.argsort(wavelengths_m, kind="stable")
    wavelengths_m, columns = wavelengths_m[order], columns[order]
    if wavelengths_m[0] < _SHORTEST_M or wavelengths_m[-1] > _LONGEST_M:
        raise InputError(
            path,
            f"got wavelengths of {wavelengths_m[0]:g} to {wavelengths_m[-1]:g} m; does the header name their unit?",
        )
    twice = np.flatnonzero(np.diff(wavelengths_m) <= 0)
    if len(twice):
        raise InputError(path, f"the wavelength {wavelengths_m[twice[0]]:g} m comes twice; keep one of the rows")
    return wavelengths_m, columns


def _cells(line: str) -> list[str]:
    parted = next((line.split(sign) for sign in (";", ",", "\t") if sign in line), line.split())
    return [cell.strip().strip('"') for cell in parted]


def _number(cell: str) -> float:
    """Return a cell's number, NaN for a word."""
    try:
        return float(cell)
    except ValueError:
        return math.nan


def _unit_m(path: Path, label: str, default: float | None) -> float:
    words = label.lower().replace("_", " ")
    for pattern, metres in _UNITS:
        if re.search(pattern, words):
            return metres
    if default is None:
        raise InputError(path, "the wavelengths have no unit; name it in the header, as in wavelength_nm,n")
    return default
