"""Reading a table of numbers against the wavelength (CSV), as data sheets, spectrometers and databases export it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.files import read_text

NM, UM = 1e-9, 1e-6
_UNITS = (
    (r"\b(nm|nanomet(er|re)s?)\b", NM),
    (r"\b(um|µm|μm|micromet(er|re)s?|microns?)\b", UM),
    (r"\b(a|å|aa|angstroms?|ångströms?)\b", 1e-10),
)
_SHORTEST_M, _LONGEST_M = 10e-9, 10e-3


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

    Columns are parted by commas, semicolons, tabs or blanks; lines that begin with # are remarks. The header, if there is
    one, may say the wavelength's unit: ``wavelength_nm``, ``lambda (um)``, ``Wavelength [Angstrom]``.

    Args:
        path: the file.
        unit_m: the wavelengths' unit where the header names none, metres; None refuses such a table.

    Raises:
        InputError: naming the file and the line.
    """
    lines = read_text(path, "a table of wavelengths").splitlines()
    remarks = " ".join(line.lstrip("# ").strip() for line in lines if line.lstrip().startswith("#"))
    rows = [(n, _cells(line)) for n, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith("#")]
    header = rows.pop(0)[1] if rows and _number(rows[0][1][0]) is None else None
    values = [[_number(cell) for cell in cells] for _, cells in rows]
    for (line, cells), numbers in zip(rows, values, strict=True):
        if len(cells) != len(rows[0][1]) or len(cells) < 2 or None in numbers:
            wanted = f"{max(len(rows[0][1]), 2)} finite numbers, the wavelength first"
            raise InputError(f"{path}:{line}", f"got {', '.join(cells)!r}; expected {wanted}")
    if len(values) < 2:
        raise InputError(path, f"got {len(values)} rows of numbers; expected at least two wavelengths")
    if header is not None and len(header) != len(values[0]):
        raise InputError(path, f"its header names {len(header)} columns, but the rows hold {len(values[0])}")
    table = np.array(values, np.float64)
    wavelengths_m = table[:, 0] * _unit_m(path, header[0] if header else "", unit_m)
    names = tuple(name.strip() for name in header[1:]) if header else None
    return WavelengthTable(*ordered(path, wavelengths_m, table[:, 1:]), names, remarks)


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


def _number(cell: str) -> float | None:
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if np.isfinite(value) else None


def _unit_m(path: Path, label: str, default: float | None) -> float:
    words = label.lower().replace("_", " ")
    for pattern, metres in _UNITS:
        if re.search(pattern, words):
            return metres
    if default is None:
        raise InputError(path, "the wavelengths have no unit; name it in the header, as in wavelength_nm,n")
    return default
