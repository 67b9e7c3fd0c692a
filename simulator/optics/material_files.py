"""Materials from files: tables (CSV) and pages of the refractiveindex.info database (YAML).

Only the refractive index is used. Absorption (k) is left out, and the material's source says so with its greatest value.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.files import read_text
from simulator.io.tables import UM, ordered, read_wavelength_table
from simulator.optics.dispersion import Formula
from simulator.optics.materials import Material

_FORMULAS: dict[str, Formula] = {
    "formula 1": "sellmeier",
    "formula 2": "sellmeier-2",
    "formula 3": "polynomial",
    "formula 5": "cauchy",
}
_TABLES = ("tabulated n", "tabulated nk")
_WITHOUT_INDEX = ("tabulated k",)


def read_material(path: Path) -> Material:
    """Read a material.

    Args:
        path: ``.csv``: a header that names the wavelength's unit and the column ``n`` (and perhaps ``k``), then a row per
            wavelength. ``.yml`` or ``.yaml``: a page of refractiveindex.info with formula 1, 2, 3 or 5, or with a table.

    Raises:
        InputError: naming the file, and what in it is not understood.
    """
    return _from_table(path) if path.suffix.lower() == ".csv" else _from_database(path)


def _from_table(path: Path) -> Material:
    table = read_wavelength_table(path)
    names = [name.lower() for name in table.names or ()]
    if names not in (["n"], ["n", "k"]):
        msg = f"{path}: got the columns {', '.join(names)} after the wavelength; expected n, or n and k"
        raise InputError(msg)
    absorption = table.columns[:, 1] if len(names) > 1 else None
    return _tabulated(path, table.wavelengths_m, table.columns[:, 0], table.remarks or "user's table", absorption)


def _from_database(path: Path) -> Material:
    import yaml

    try:
        page = yaml.safe_load(read_text(path, "a table of wavelengths"))
    except (yaml.YAMLError, RecursionError) as error:
        msg = f"{path}: no YAML that can be read ({str(error).splitlines()[0]})"
        raise InputError(msg) from error
    entries = page.get("DATA") if isinstance(page, dict) else None
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        msg = f"{path}: no DATA list; expected a page of refractiveindex.info, such as main/SiO2/nk/Malitson.yml"
        raise InputError(msg)
    kinds = [str(entry.get("type")) for entry in entries]
    known = [(kind, entry) for kind, entry in zip(kinds, entries, strict=True) if kind in (*_FORMULAS, *_TABLES)]
    strange = [kind for kind in kinds if kind not in (*_FORMULAS, *_TABLES, *_WITHOUT_INDEX)]
    if len(known) != 1 or strange:
        msg = (
            f"{path}: its DATA are {', '.join(kinds) or 'empty'}; expected exactly one of "
            f"{', '.join((*_FORMULAS, *_TABLES))}, beside it at most {', '.join(_WITHOUT_INDEX)}: write a table .csv instead"
        )
        raise InputError(msg)
    ((kind, chosen),) = known
    source = _citation(page.get("REFERENCES")) or "refractiveindex.info"
    absorption = [_rows(path, entry, 2)[:, 1] for k, entry in zip(kinds, entries, strict=True) if k == "tabulated k"]
    if kind in _TABLES:
        rows = _rows(path, chosen, 3 if kind == "tabulated nk" else 2)
        absorption += [rows[:, 2]] if kind == "tabulated nk" else []
        return _tabulated(path, rows[:, 0] * UM, rows[:, 1], source, *absorption)
    coefficients, span_um = _numbers(path, chosen, "coefficients"), _numbers(path, chosen, "wavelength_range")
    if len(coefficients) % 2 == 0 or len(span_um) != 2 or not 0 < span_um[0] < span_um[1]:
        msg = f"{path}: {kind} with {len(coefficients)} coefficients over {span_um} um makes no sense"
        raise InputError(msg)
    range_m = (span_um[0] * UM, span_um[1] * UM)
    material = Material(path.name, _FORMULAS[kind], coefficients, range_m, _with_absorption(source, *absorption))
    for wavelength_m in np.linspace(*range_m, 32):
        with np.errstate(invalid="ignore", divide="ignore"):
            _check_index(path, np.array([material.index(float(wavelength_m))]))
    return material


def _tabulated(
    path: Path,
    wavelengths_m: NDArray[np.float64],
    index: NDArray[np.float64],
    source: str,
    *absorption: NDArray[np.float64] | None,
) -> Material:
    wavelengths_m, columns = ordered(path, wavelengths_m, index[:, None])
    _check_index(path, columns)
    pairs = np.column_stack([wavelengths_m / UM, columns])
    return Material(
        path.name,
        "table",
        tuple(pairs.ravel().tolist()),
        (float(wavelengths_m[0]), float(wavelengths_m[-1])),
        _with_absorption(source, *absorption),
    )


def _with_absorption(source: str, *absorption: NDArray[np.float64] | None) -> str:
    greatest = max((float(k.max()) for k in absorption if k is not None), default=0.0)
    return f"{source}; its absorption (k up to {greatest:g}) is left out" if greatest > 0 else source


def _check_index(path: Path, index: NDArray[np.float64]) -> None:
    bad = index[~((index > 0.05) & (index < 10))]  # also catches NaN
    if len(bad):
        msg = f"{path}: a refractive index of {bad.flat[0]:g}; expected 0.05 to 10: are the columns wavelength, n, k?"
        raise InputError(msg)


def _numbers(path: Path, entry: dict[str, Any], key: str) -> tuple[float, ...]:
    return tuple(_array(path, entry, key, str(entry.get(key)).replace("\n", " "))[0].tolist())


def _rows(path: Path, entry: dict[str, Any], columns: int) -> NDArray[np.float64]:
    rows = _array(path, entry, "data", str(entry.get("data")))
    if rows.shape[1] != columns or len(rows) < 2:
        msg = f"{path}: {entry.get('type')} holds {rows.shape[0]} rows of {rows.shape[1]}; expected {columns} a row, 2 rows"
        raise InputError(msg)
    return rows


def _array(path: Path, entry: dict[str, Any], key: str, text: str) -> NDArray[np.float64]:
    try:
        rows = np.array([line.split() for line in text.splitlines() if line.strip()], np.float64)
    except ValueError:
        rows = np.array([np.nan])
    if rows.ndim != 2 or not np.all(np.isfinite(rows)):
        msg = f"{path}: {entry.get('type')} has {key} {text[:40]!r}, expected rows of finite numbers parted by blanks"
        raise InputError(msg)
    return rows


def _citation(text: Any) -> str:
    return " ".join(re.sub(r"<[^>]*>", " ", str(text)).split()) if text else ""
