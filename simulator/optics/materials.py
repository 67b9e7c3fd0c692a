"""Refractive indices of mask materials and layers: built in by cited dispersion formulas, or from files."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.files import expanded, read_text
from simulator.io.tables import UM, ordered, read_wavelength_table

Formula = Literal["sellmeier", "sellmeier-2", "polynomial", "cauchy", "table"]
_ROUNDING = 1e-9  # 0.4 um, 400 nm and 4e-7 m differ in their last digit
_LEAST_REFRACTIVITY = 1e-3  # below it a wave's delay takes more than half a millimetre of height


@dataclass(frozen=True)
class Material:
    """A transparent material.

    Attributes:
        name: how it is written in sim_config.yaml, or the name of its file.
        formula: see `refractive_index`.
        coefficients: of the formula; lengths in micrometres.
        range_m: shortest and longest wavelength of the data, metres.
        source: citation; ``nominal`` in it marks a stand-in, and an absorption that is left out is said.
        scale: factor on n - 1, for a fit that is rescaled to a known anchor.
    """

    name: str
    formula: Formula
    coefficients: tuple[float, ...]
    range_m: tuple[float, float]
    source: str
    scale: float = 1.0

    def index(self, wavelength_m: float) -> float:
        """Return the refractive index at a vacuum wavelength in metres.

        Raises:
            InputError: outside the range of the data.
        """
        low, high = self.range_m
        if not low * (1 - _ROUNDING) <= wavelength_m <= high * (1 + _ROUNDING):
            raise InputError(
                "wavelength_m",
                f"got {wavelength_m:g} m, but {self.name!r} is known from {low:g} to {high:g} m; choose another "
                "wavelength or material",
            )
        return 1 + self.scale * (refractive_index(self.formula, self.coefficients, wavelength_m * 1e6) - 1)

    def refractivity(self, wavelength_m: float) -> float:
        """Return n - 1, by which a design divides the path that a height shall delay.

        Raises:
            InputError: outside the range of the data, or where the material delays no light.
        """
        refractivity = self.index(wavelength_m) - 1
        if abs(refractivity) < _LEAST_REFRACTIVITY:
            raise InputError(
                "material",
                f"{self.name!r} delays no light (n - 1 = {refractivity:g} at {wavelength_m * 1e9:g} nm); choose a "
                "solid, such as 'fused-silica'",
            )
        return refractivity


# ---- dispersion formulas


def refractive_index(formula: Formula, coefficients: Sequence[float], wavelength_um: float) -> float:
    """Return the refractive index at a wavelength l in micrometres; no range is checked here.

    Args:
        formula: what the coefficients mean; in parentheses its number at refractiveindex.info.

            - ``sellmeier`` (1): n^2 = 1 + A + sum B_i l^2 / (l^2 - C_i^2), coefficients (A, B_1, C_1, B_2, C_2, ...);
            - ``sellmeier-2`` (2): n^2 = 1 + A + sum B_i l^2 / (l^2 - C_i), (A, B_1, C_1, ...);
            - ``polynomial`` (3): n^2 = A + sum B_i l^P_i, (A, B_1, P_1, ...);
            - ``cauchy`` (5): n = A + sum B_i l^P_i, (A, B_1, P_1, ...);
            - ``table``: (l_1, n_1, l_2, n_2, ...), between its points a monotone cubic (Fritsch and Carlson, SIAM J.
              Numer. Anal. 17, 238, 1980), which never overshoots.
        coefficients: as the formula says; lengths in micrometres.
        wavelength_um: vacuum wavelength, micrometres.

    Example:
        >>> round(refractive_index("cauchy", (1.5375, 0.00829045, -2, -0.000211046, -4), 0.589), 3)
        1.56
    """
    um = wavelength_um
    if formula == "table":
        return _interpolated(coefficients, um)
    constant, pairs = coefficients[0], list(zip(coefficients[1::2], coefficients[2::2], strict=True))
    if formula == "sellmeier":
        return float(np.sqrt(1 + constant + sum(b * um**2 / (um**2 - c**2) for b, c in pairs)))
    if formula == "sellmeier-2":
        return float(np.sqrt(1 + constant + sum(b * um**2 / (um**2 - c) for b, c in pairs)))
    value = constant + sum(b * um**power for b, power in pairs)
    return float(np.sqrt(value)) if formula == "polynomial" else float(value)


def _interpolated(coefficients: Sequence[float], um: float) -> float:
    from scipy.interpolate import PchipInterpolator

    wavelengths_um, index = np.asarray(coefficients[::2]), np.asarray(coefficients[1::2])
    # Four points each side decide the value; a long table costs no more than a short one.
    at = int(np.searchsorted(wavelengths_um, um))
    near = slice(max(at - 4, 0), at + 4)
    return float(PchipInterpolator(wavelengths_um[near], index[near])(um))


# ---- built in

AIR = Material(
    "air",
    "cauchy",
    (1.0,),
    (0.1e-6, 20e-6),
    "by definition: indices of solids are published relative to air (its own n - 1 is 2.8e-4)",
)
FUSED_SILICA = Material(
    "fused-silica",
    "sellmeier",
    (0.0, 0.6961663, 0.0684043, 0.4079426, 0.1162414, 0.8974794, 9.896161),
    (0.21e-6, 6.7e-6),
    "Malitson, J. Opt. Soc. Am. 55, 1205 (1965)",
)
N_BK7 = Material(
    "n-bk7",
    "sellmeier-2",
    (0.0, 1.03961212, 0.00600069867, 0.231792344, 0.0200179144, 1.01046945, 103.560653),
    (0.3e-6, 2.5e-6),
    "SCHOTT Zemax catalog 2017-01-20b",
)
PMMA = Material(
    "pmma",
    "polynomial",
    (2.1778, 6.1209e-3, 2, -1.5004e-3, 4, 2.3678e-2, -2, -4.2137e-3, -4, 7.3417e-4, -6, -4.5042e-5, -8),
    (0.42e-6, 1.62e-6),
    "Beadie et al., Appl. Opt. 54, F139 (2015), at 20.1 C",
)
PDMS = Material(
    "pdms",
    "sellmeier-2",
    (0.0, 1.0093, 0.013185),
    (0.35e-6, 0.70e-6),
    "Sylgard 184: Schneider et al., Sens. Actuators A 151, 95 (2009)",
)
POLYCARBONATE = Material(
    "polycarbonate",
    "sellmeier-2",
    (0.0, 1.4182, 0.021304),
    (0.4368e-6, 1.052e-6),
    "Sultanova et al., Acta Phys. Pol. A 116, 585 (2009), fit of refractiveindex.info, at 20 C",
)
NOA61 = Material(
    "noa61",
    "cauchy",
    (1.5375, 0.00829045, -2, -0.000211046, -4),
    (0.45e-6, 1.55e-6),
    "Norland Optical Adhesive 61 data sheet",
)
# The data sheet of SU-8 2000 speaks of the uncured film, and a mask is cured; the two differ by 0.016 in the visible.
SU8 = Material(
    "su-8", "cauchy", (1.5525, 0.00629, -2, 0.0004, -4), (0.32e-6, 1.7e-6), "Microchem SU-8 3000 data sheet (2011)"
)
_SU8_2000 = (1.566, 0.00796, -2, 0.00014, -4)
# Only n(532 nm) = 1.5103 is published for this resist, so a visible fit of another resist is rescaled to it.
PHLATCAM_RESIST = Material(
    "phlatcam-resist",
    "cauchy",
    _SU8_2000,
    (0.32e-6, 0.80e-6),
    "nominal: Microchem SU-8 2000 data sheet's Cauchy fit, n - 1 rescaled to 0.5103 at 532 nm (Boominathan et al. 2020)",
    scale=0.5103 / (refractive_index("cauchy", _SU8_2000, 0.532) - 1),
)
MATERIALS = {
    material.name: material
    for material in (AIR, FUSED_SILICA, N_BK7, NOA61, PDMS, PHLATCAM_RESIST, PMMA, POLYCARBONATE, SU8)
}


def material_file(name: str, base_dir: Path | None = None) -> Path | None:
    """Return the file that a material's name stands for, or None where it is not a file name.

    Args:
        name: as in sim_config.yaml.
        base_dir: folder from which relative paths are taken; None is the current one.
    """
    if name in MATERIALS or not name.lower().endswith((".csv", ".yml", ".yaml")):
        return None
    return expanded(name, base_dir)


def load_material(name: str, base_dir: Path | None = None) -> Material:
    """Return a material by its name, or read the user's own from a file.

    Args:
        name: a built-in material's name, or a file: ``.csv`` with a header that names the wavelength's unit and the column
            ``n`` (and perhaps ``k``), then a row per wavelength; ``.yml``, a page of refractiveindex.info with formula 1, 2,
            3 or 5, or with a table.
        base_dir: folder from which relative paths are taken; None is the current one.

    Raises:
        InputError: for an unknown name (the message lists the known ones), or a file that is missing or holds no index.

    Example:
        >>> round(load_material("n-bk7").index(587.5618e-9), 4)
        1.5168
    """
    path = material_file(name, base_dir)
    if path is not None:
        return _from_table(path) if path.suffix.lower() == ".csv" else _from_database(path)
    if name not in MATERIALS:
        raise InputError(
            "material",
            f"got {name!r}, expected one of {', '.join(sorted(MATERIALS))}, or a file: a table .csv, a "
            "refractiveindex.info .yml",
        )
    return MATERIALS[name]


# ---- from files

_FORMULAS: dict[str, Formula] = {
    "formula 1": "sellmeier",
    "formula 2": "sellmeier-2",
    "formula 3": "polynomial",
    "formula 5": "cauchy",
}
_TABLES = ("tabulated n", "tabulated nk")
_WITHOUT_INDEX = ("tabulated k",)


def _from_table(path: Path) -> Material:
    table = read_wavelength_table(path)
    names = [name.lower() for name in table.names or ()]
    if names not in (["n"], ["n", "k"]):
        raise InputError(path, f"got the columns {', '.join(names)} after the wavelength; expected n, or n and k")
    absorption = table.columns[:, 1] if len(names) > 1 else None
    return _tabulated(path, table.wavelengths_m, table.columns[:, 0], table.remarks or "user's table", absorption)


def _from_database(path: Path) -> Material:
    import yaml

    try:
        page = yaml.safe_load(read_text(path, "a table of wavelengths"))
    except (yaml.YAMLError, RecursionError) as error:
        raise InputError(path, f"not readable as YAML ({str(error).splitlines()[0]})") from error
    entries = page.get("DATA") if isinstance(page, dict) else None
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise InputError(path, "no DATA list; expected a page of refractiveindex.info")
    kinds = [str(entry.get("type")) for entry in entries]
    known = [(kind, entry) for kind, entry in zip(kinds, entries, strict=True) if kind in (*_FORMULAS, *_TABLES)]
    strange = [kind for kind in kinds if kind not in (*_FORMULAS, *_TABLES, *_WITHOUT_INDEX)]
    if len(known) != 1 or strange:
        raise InputError(
            path,
            f"its DATA are {', '.join(kinds) or 'empty'}; expected exactly one of {', '.join((*_FORMULAS, *_TABLES))}, "
            f"beside it at most {', '.join(_WITHOUT_INDEX)}: write a table .csv instead",
        )
    ((kind, chosen),) = known
    source = _citation(page.get("REFERENCES")) or "refractiveindex.info"
    absorption = [_rows(path, entry, 2)[:, 1] for k, entry in zip(kinds, entries, strict=True) if k == "tabulated k"]
    if kind in _TABLES:
        rows = _rows(path, chosen, 3 if kind == "tabulated nk" else 2)
        absorption += [rows[:, 2]] if kind == "tabulated nk" else []
        return _tabulated(path, rows[:, 0] * UM, rows[:, 1], source, *absorption)
    coefficients, span_um = _numbers(path, chosen, "coefficients"), _numbers(path, chosen, "wavelength_range")
    if len(coefficients) % 2 == 0 or len(span_um) != 2 or not 0 < span_um[0] < span_um[1]:
        raise InputError(path, f"{kind} with {len(coefficients)} coefficients over {span_um} um makes no sense")
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
        raise InputError(path, f"a refractive index of {bad.flat[0]:g}; expected 0.05 to 10, columns wavelength, n, k")


def _numbers(path: Path, entry: dict[str, Any], key: str) -> tuple[float, ...]:
    return tuple(_array(path, entry, key, str(entry.get(key)).replace("\n", " "))[0].tolist())


def _rows(path: Path, entry: dict[str, Any], columns: int) -> NDArray[np.float64]:
    rows = _array(path, entry, "data", str(entry.get("data")))
    if rows.shape[1] != columns or len(rows) < 2:
        raise InputError(
            path, f"{entry.get('type')} holds {len(rows)} rows of {rows.shape[1]}; expected {columns}, 2 rows"
        )
    return rows


def _array(path: Path, entry: dict[str, Any], key: str, text: str) -> NDArray[np.float64]:
    try:
        rows = np.array([line.split() for line in text.splitlines() if line.strip()], np.float64)
    except ValueError:
        rows = np.array([np.nan])
    if rows.ndim != 2 or not np.all(np.isfinite(rows)):
        raise InputError(path, f"{entry.get('type')} has {key} {text[:40]!r}, expected rows of finite numbers")
    return rows


def _citation(text: Any) -> str:
    return " ".join(re.sub(r"<[^>]*>", " ", str(text)).split()) if text else ""
