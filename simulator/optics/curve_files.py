"""Spectral curves from files: CSV tables, and the JSON of rawtoaces-data."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.files import read_text
from simulator.io.tables import NM, ordered, read_wavelength_table
from simulator.optics.curves import COLOURS, MONOCHROME, SpectralCurves

_NAMES = {"r": "R", "red": "R", "g": "G", "green": "G", "b": "B", "blue": "B"}
_FORGIVEN = 0.01  # of the peak: a digitised or measured zero may lie a little below


def read_curves(path: Path) -> SpectralCurves:
    """Read one curve, or R, G and B.

    Only ratios count later, so curves may be absolute or relative; percent become fractions where the file says percent.

    Args:
        path: ``.csv``: the wavelength (nm unless the header says um or angstrom) and one column, or three: red, green and
            blue, in this order if there is no header that names them. ``.json``: as in rawtoaces-data.

    Raises:
        InputError: naming the file and what in it is not understood.
    """
    if path.suffix.lower() == ".json":
        wavelengths_m, columns, names = _read_json(path)
        said = ""
    else:
        table = read_wavelength_table(path, unit_m=NM)
        wavelengths_m, columns, names = table.wavelengths_m, table.columns, table.names
        said = " ".join([table.remarks, *(names or ())]).lower()
    channels, columns = _in_order(path, names, columns)
    peak = columns.max()
    if not peak > 0 or columns.min() < -_FORGIVEN * peak:
        msg = f"{path}: values from {columns.min():g} to {peak:g}; a spectral curve is positive"
        raise InputError(msg)
    scale = 0.01 if re.search(r"percent|%", said) else 1.0
    return SpectralCurves(wavelengths_m, np.clip(columns.T, 0, None) * scale, channels, path.name)


def _read_json(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[str, ...]]:
    """Return wavelengths, columns and names of a rawtoaces file (its schema 0.1 and 1.0: nanometres as keys)."""
    text = read_text(path, "a table of wavelengths")
    try:
        content: Any = json.loads(text)["spectral_data"]
        names = tuple(str(name) for name in content["index"]["main"])
        rows = content["data"]["main"]
        table = np.array([[float(wavelength), *map(float, row)] for wavelength, row in rows.items()])
        if table.ndim != 2 or len(table) < 2 or table.shape[1] != len(names) + 1 or not np.all(np.isfinite(table)):
            msg = f"{len(rows)} rows for the columns {', '.join(names)}"
            raise ValueError(msg)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        msg = (
            f"{path}: not a rawtoaces file ({type(error).__name__}: {error}); expected spectral_data with index.main (names) "
            "and data.main (wavelength in nm: values), or write a .csv"
        )
        raise InputError(msg) from error
    return *ordered(path, table[:, 0] * NM, table[:, 1:]), names


def _in_order(
    path: Path, names: tuple[str, ...] | None, columns: NDArray[np.float64]
) -> tuple[tuple[str, ...], NDArray[np.float64]]:
    if columns.shape[1] == 1:
        return MONOCHROME, columns
    found = [_NAMES.get(re.split(r"[^a-z]", name.lower())[0], name) for name in names or COLOURS]
    if columns.shape[1] != 3 or sorted(found) != sorted(COLOURS):
        msg = f"{path}: columns {', '.join(found)}; expected one (a monochrome sensor, a light), or red, green and blue"
        raise InputError(msg)
    return COLOURS, columns[:, [found.index(colour) for colour in COLOURS]]
