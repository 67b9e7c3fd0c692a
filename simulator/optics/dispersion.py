"""Dispersion: the refractive index against the wavelength, by the formulas of refractiveindex.info or by a table.

Source of the forms: M. N. Polyanskiy, "Dispersion formulas" of refractiveindex.info (Sci. Data 11, 94, 2024).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

Formula = Literal["sellmeier", "sellmeier-2", "polynomial", "cauchy", "table"]


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
