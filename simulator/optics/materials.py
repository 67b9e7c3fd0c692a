"""Refractive indices of mask materials and layers: the built-in ones by cited dispersion formulas, others from files.

Indices of solids are published relative to air, in which masks stand, so air has the index 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from simulator.errors import InputError
from simulator.optics.dispersion import Formula, refractive_index

_ROUNDING = 1e-9  # 0.4 um, 400 nm and 4e-7 m differ in their last digit
_LEAST_REFRACTIVITY = 1e-3  # below it a wave's delay takes more than half a millimetre of height


@dataclass(frozen=True)
class Material:
    """A transparent material.

    Attributes:
        name: how it is written in sim_config.yaml, or the name of its file.
        formula: see :func:`simulator.optics.dispersion.refractive_index`.
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
            msg = (
                f"wavelength_m: got {wavelength_m:g} m, but the dispersion of {self.name!r} is known from {low:g} to "
                f"{high:g} m; choose a wavelength inside it or another material (is the unit metres?)"
            )
            raise InputError(msg)
        return 1 + self.scale * (refractive_index(self.formula, self.coefficients, wavelength_m * 1e6) - 1)

    def refractivity(self, wavelength_m: float) -> float:
        """Return n - 1, by which a design divides the path that a height shall delay.

        Raises:
            InputError: outside the range of the data, or where the material delays no light.
        """
        refractivity = self.index(wavelength_m) - 1
        if abs(refractivity) < _LEAST_REFRACTIVITY:
            msg = (
                f"material: {self.name!r} delays no light (n - 1 = {refractivity:g} at {wavelength_m * 1e9:g} nm), so no "
                "height of it makes a phase; choose a solid, such as 'fused-silica'"
            )
            raise InputError(msg)
        return refractivity


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
    "su-8",
    "cauchy",
    (1.5525, 0.00629, -2, 0.0004, -4),
    (0.32e-6, 1.7e-6),
    "Microchem SU-8 3000 data sheet (2011)",
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
    """Return the file that a material's name stands for, or None where it is no file's name.

    Args:
        name: as in sim_config.yaml.
        base_dir: folder from which relative paths are taken; None is the current one.
    """
    if name in MATERIALS or not name.lower().endswith((".csv", ".yml", ".yaml")):
        return None
    return (base_dir or Path()) / Path(name).expanduser()


def load_material(name: str, base_dir: Path | None = None) -> Material:
    """Return a material by its name, or read the user's own from a file.

    Args:
        name: a built-in material's name, or the path of a table (.csv) or of a refractiveindex.info file (.yml).
        base_dir: folder from which relative paths are taken; None is the current one.

    Raises:
        InputError: for an unknown name (the message lists the known ones), or a file that is missing or holds no index.

    Example:
        >>> round(load_material("n-bk7").index(587.5618e-9), 4)
        1.5168
    """
    path = material_file(name, base_dir)
    if path is not None:
        from simulator.optics.material_files import read_material

        return read_material(path)
    if name not in MATERIALS:
        msg = (
            f"material: got {name!r}, expected one of {', '.join(sorted(MATERIALS))}, or a file: a table .csv or a "
            "refractiveindex.info .yml"
        )
        raise InputError(msg)
    return MATERIALS[name]
