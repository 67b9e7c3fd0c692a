"""The wave of a point source on the mask: spherical or plane, straight ahead or oblique, through a window or not.

Its carrier, the tilt of the ray through the mask's centre, is taken out analytically: only what is left has to fit on
the mask's grid.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from simulator.arrays import Array, namespace, unit_phasor
from simulator.errors import InputError
from simulator.optics.propagation import Strata, fan, reduced_m


@dataclass(frozen=True)
class Source:
    """A point source of one wavelength.

    Attributes:
        wavelength_m: vacuum wavelength, metres.
        depth_m: z from the mask plane, metres, or ``inf``.
        direction: tangents (x, y): the source lies at ``(x depth_m, y depth_m)``, or there at infinity.
        window: layers between the source's air and the mask, at this wavelength.
    """

    wavelength_m: float
    depth_m: float
    direction: tuple[float, float] = (0.0, 0.0)
    window: Strata = ()

    def __post_init__(self) -> None:
        if not self._air_m > 0:
            inside = sum(thickness_m for thickness_m, _ in self.window)
            raise InputError("depth_m", f"got {self.depth_m:g} m, inside the {inside:g} m of glass before the mask")

    @property
    def on_axis(self) -> bool:
        """Whether the source lies straight ahead: its wave is even in x and y."""
        return self.direction == (0.0, 0.0)

    @property
    def carrier(self) -> tuple[float, float]:
        """Transverse sines (x, y) of the ray through the mask's centre: the direction in which light travels on."""
        tangent = math.hypot(*self.direction)
        if tangent == 0:
            return 0.0, 0.0
        if self.window and math.isfinite(self.depth_m):
            away_m = tangent * self.depth_m
            sine = float(fan(self._strata, np.array(away_m**2)).inverse_m) * away_m
        else:
            sine = tangent / math.hypot(1, tangent)
        x, y = self.direction
        return -x / tangent * sine, -y / tangent * sine

    def residual_band(self, half_width_m: float) -> float:
        """Return the highest frequency (cycles per metre, per axis) that the wave has on a mask, its carrier taken out."""
        if math.isinf(self.depth_m):
            return 0.0
        z = self.effective_m
        centre = np.array(self.direction) * z
        chief = centre / math.hypot(z, *centre)
        places = np.array([[x, y] for x in (-1, 0, 1) for y in (-1, 0, 1)]) * half_width_m
        rays = (places - centre) / np.sqrt(np.sum((places - centre) ** 2, axis=1, keepdims=True) + z**2)
        return float(np.abs(rays + chief).max()) / self.wavelength_m

    def wave(self, y_m: Array, x_m: Array, dtype: object) -> Array:
        """Return the wave without its carrier, of unit modulus at the mask's centre.

        In air U = (r0 / r) exp(i k (r - r0)), r and r0 the distances from the source to the point and to the mask's centre.

        Args:
            y_m: rows' coordinates, float64 metres, broadcastable against ``x_m``.
            x_m: columns' coordinates.
            dtype: real type of the result: float32 or float64.
        """
        xp = namespace(x_m)
        if math.isinf(self.depth_m):
            return xp.ones_like(xp.astype(y_m + x_m, dtype)) + 0j
        turns, amplitude = self._through_window(y_m, x_m) if self.window else self._through_air(y_m, x_m)
        turns = turns / self.wavelength_m
        turns -= xp.round(turns)
        wave = unit_phasor(xp.astype(turns * (2 * np.pi), dtype))
        return wave * xp.astype(amplitude, dtype)

    @property
    def effective_m(self) -> float:
        """The depth in air alone at which paraxial rays would come from the same point, metres."""
        return float(reduced_m(self._strata))

    @property
    def _air_m(self) -> float:
        return self.depth_m - sum(thickness_m for thickness_m, _ in self.window)

    @property
    def _strata(self) -> Strata:
        return ((self._air_m, 1.0), *self.window)

    def _through_air(self, y_m: Array, x_m: Array) -> tuple[Array, Array]:
        xp, z = namespace(x_m), self.depth_m
        centre_x, centre_y = (z * tangent for tangent in self.direction)
        r0 = math.sqrt(z**2 + centre_x**2 + centre_y**2)
        lateral = y_m**2 + x_m**2
        if self.on_axis:
            r = xp.sqrt(lateral + z**2)
            return lateral / (r + r0), r0 / r
        towards = centre_x * x_m + centre_y * y_m
        r = xp.sqrt(lateral - 2 * towards + r0**2)
        difference = (lateral - 2 * towards) / (r + r0)  # r - r0 without cancellation
        return lateral / (r + r0) + towards * difference / (r0 * (r + r0)), r0 / r

    def _through_window(self, y_m: Array, x_m: Array) -> tuple[Array, Array]:
        centre_x, centre_y = (self.depth_m * tangent for tangent in self.direction)
        rays = fan(self._strata, (x_m - centre_x) ** 2 + (y_m - centre_y) ** 2)
        chief = fan(self._strata, np.array(centre_x**2 + centre_y**2))
        sine_x, sine_y = self.carrier
        path = rays.path_m - float(chief.path_m) - sine_x * x_m - sine_y * y_m
        # Spreading is per projected area on both sides; the wave's modulus is per its own front, oblique on both.
        rho_squared = (x_m - centre_x) ** 2 + (y_m - centre_y) ** 2
        cosine = np.sqrt(1 - rays.inverse_m**2 * rho_squared)
        chief_cosine = math.sqrt(1 - sine_x**2 - sine_y**2)
        return path, rays.spreading / cosine / (float(chief.spreading) / chief_cosine)
