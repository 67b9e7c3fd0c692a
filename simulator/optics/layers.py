"""Plane-parallel layers between two planes, such as air and a cover glass: how rays cross them, at one wavelength.

A ray keeps its transverse sine s = n sin(theta) through all layers. Its sideways travel rho(s) and its optical path L(s)
obey dL/d(rho) = s, so both the wave of a point behind layers and the kernel of free space through them follow from one
table (Born and Wolf, Principles of Optics, sections 3.1 and 3.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from simulator.arrays import Array, is_torch, namespace, number
from simulator.errors import InputError
from simulator.types import CameraGeometry, Layer

_KNOTS = 4096
_STEEPEST = 0.98  # of the lowest index: where the table ends

Strata = tuple[tuple[Any, float], ...]
"""Layers at one wavelength: (thickness in metres, refractive index); a thickness may be a torch scalar."""
Distance = Any
"""Metres of air (a torch scalar where gradients are wanted), or Strata."""


def as_strata(distance_m: Distance) -> Strata:
    """Return a distance as layers: a plain number means air."""
    return distance_m if isinstance(distance_m, tuple) else ((distance_m, 1.0),)


def air_equivalent_m(layers: Sequence[Layer], wavelength_m: float) -> float:
    """Return the distance in air at which paraxial rays arrive where they do behind the layers: sum of d / n, metres."""
    return sum(layer.thickness_m / layer.material.index(wavelength_m) for layer in layers)


def gap_strata(camera: CameraGeometry, wavelength_m: float) -> Strata:
    """Return the layers between mask and sensor at one wavelength; air alone where the camera has no layered gap."""
    if not camera.gap:
        return ((camera.mask_to_sensor_m, 1.0),)
    return tuple((layer.thickness_m, layer.material.index(wavelength_m)) for layer in camera.gap)


def scaled(strata: Strata, factor: Any) -> Strata:
    """Return the layers with every thickness times a factor."""
    return tuple((thickness_m * factor, index) for thickness_m, index in strata)


def reduced_m(strata: Strata) -> Any:
    """Return the sum of thickness over index, metres: the distance in air with the same paraxial rays."""
    return sum(thickness_m / index for thickness_m, index in strata)


@dataclass(frozen=True)
class Fan:
    """Rays from one point through layers, at sideways distances rho.

    Attributes:
        path_m: optical path minus that of the straight ray at rho = 0, metres.
        inverse_m: s / rho, 1 / metres; 1 / r in air.
        spreading: sqrt(s ds / (rho d rho)), 1 / metres: the amplitude's fall; d / r^2 in air.
    """

    path_m: Array
    inverse_m: Array
    spreading: Array


def fan(strata: Strata, rho_squared: Array) -> Fan:
    """Trace the rays of one point to sideways distances.

    Args:
        strata: layers; one of index 1 is reckoned analytically, several through a table (NumPy only).
        rho_squared: squared sideways distances, square metres, float64.

    Raises:
        InputError: for torch arrays with several layers, or for rays too steep for them.
    """
    xp = namespace(rho_squared)
    if len(strata) == 1 and strata[0][1] == 1:
        d = strata[0][0]
        r = xp.sqrt(rho_squared + d**2)
        inverse = 1 / r
        return Fan(rho_squared / (r + d), inverse, inverse**2 * d)
    if is_torch(rho_squared):
        msg = "gap, window: rays through several layers are traced on NumPy only; use xp='numpy', or a gap of air"
        raise InputError(msg)
    from scipy.interpolate import CubicHermiteSpline, CubicSpline

    thickness = np.array([number(t) for t, _ in strata])[:, None]
    index = np.array([n for _, n in strata])[:, None]
    # Even steps of the angle in the thinnest medium crowd no knots anywhere.
    sine = index.min() * np.sin(np.linspace(0, np.arcsin(_STEEPEST), _KNOTS))
    cosine = np.sqrt(index**2 - sine**2)
    per_sine = np.sum(thickness / cosine, axis=0)  # rho / s
    path = np.sum(thickness * index * sine**2 / (cosine * (index + cosine)), axis=0)  # minus the sum of t n
    slope = np.sum(thickness * index**2 / cosine**3, axis=0)  # d(rho) / ds
    rho, wanted = sine * per_sine, np.sqrt(rho_squared)
    if np.max(wanted) > rho[-1]:
        msg = f"rays to {np.max(wanted):g} m sideways are steeper than the layers' {rho[-1]:g} m; use a narrower mask"
        raise InputError(msg)
    return Fan(
        CubicHermiteSpline(rho, path, sine)(wanted),
        CubicSpline(rho, 1 / per_sine)(wanted),
        CubicSpline(rho, 1 / np.sqrt(per_sine * slope))(wanted),
    )
