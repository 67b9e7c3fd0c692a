"""Refractive indices of mask materials by cited dispersion formulas."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from simulator.errors import InputError


@dataclass(frozen=True)
class Material:
    """A transparent material.

    Attributes:
        name: how it is written in sim_config.yaml.
        formula: ``sellmeier``: n^2 - 1 = sum B_i l^2 / (l^2 - C_i^2); ``cauchy``: n = sum A_i l^(-2 i); l in micrometres.
        coefficients: (B_1, C_1, B_2, C_2, ...) with C in micrometres, or (A_0, A_1, ...).
        range_m: shortest and longest wavelength of the fit, metres.
        source: citation; ``nominal`` in it marks a stand-in.
        scale: factor on n - 1, for a fit that is rescaled to a known anchor.
    """

    name: str
    formula: Literal["sellmeier", "cauchy"]
    coefficients: tuple[float, ...]
    range_m: tuple[float, float]
    source: str
    scale: float = 1.0

    def index(self, wavelength_m: float) -> float:
        """Return the refractive index at a vacuum wavelength in metres.

        Raises:
            InputError: outside the range of the fit.
        """
        low, high = self.range_m
        if not low <= wavelength_m <= high:
            msg = (
                f"wavelength_m: got {wavelength_m:g} m, but the dispersion of {self.name!r} is known from {low:g} to "
                f"{high:g} m; choose a wavelength inside it or another material (is the unit metres?)"
            )
            raise InputError(msg)
        um = wavelength_m * 1e6
        if self.formula == "sellmeier":
            terms = zip(self.coefficients[::2], self.coefficients[1::2], strict=True)
            n = float(np.sqrt(1 + sum(b * um**2 / (um**2 - c**2) for b, c in terms)))
        else:
            n = sum(a * um ** (-2 * i) for i, a in enumerate(self.coefficients))
        return 1 + self.scale * (n - 1)


FUSED_SILICA = Material(
    "fused-silica",
    "sellmeier",
    (0.6961663, 0.0684043, 0.4079426, 0.1162414, 0.8974794, 9.896161),
    (0.21e-6, 6.7e-6),
    "Malitson, J. Opt. Soc. Am. 55, 1205 (1965)",
)

_SU8 = (1.566, 0.00796, 0.00014)
_SU8_AT_532 = sum(a * 0.532 ** (-2 * i) for i, a in enumerate(_SU8))

# Only n(532 nm) = 1.5103 is published for this resist, so a visible fit of another resist is rescaled to it.
PHLATCAM_RESIST = Material(
    "phlatcam-resist",
    "cauchy",
    _SU8,
    (0.32e-6, 0.80e-6),
    "nominal: Microchem SU-8 2000 data sheet's Cauchy fit, n - 1 rescaled to 0.5103 at 532 nm (Boominathan et al. 2020)",
    scale=0.5103 / (_SU8_AT_532 - 1),
)

MATERIALS = {material.name: material for material in (FUSED_SILICA, PHLATCAM_RESIST)}


def load_material(name: str) -> Material:
    """Return a material by its name in sim_config.yaml.

    Raises:
        InputError: for an unknown name; the message lists the known ones.
    """
    if name not in MATERIALS:
        msg = f"material: got {name!r}, expected one of {', '.join(sorted(MATERIALS))}"
        raise InputError(msg)
    return MATERIALS[name]
