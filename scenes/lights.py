"""Lamps, and surroundings that shine: rooms with a ceiling, a floor and bright windows, which coated things mirror."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from simulator.render import EnvironmentMap, SphereLight

_ROWS = 16  # coarse: it is light, not an image; windows are soft
_MOST_WINDOWS = 3


def draw_room(rng: np.random.Generator, radiance: float, warmth: float) -> EnvironmentMap:
    """Draw a room around a scene: contrast of ceiling and floor; number, place, size and strength of the windows.

    ``radiance`` is that of a white matt surface that faces the camera if nothing stood in the light's way; for ``warmth`` see
    `tint`.
    """
    down, across, weight = _grid()
    ceiling, floor = rng.uniform(0.8, 1.5), rng.uniform(0.3, 0.9)
    light = ceiling + (floor - ceiling) * down
    for _ in range(int(rng.integers(1, _MOST_WINDOWS + 1))):
        height, side = rng.uniform(0.15, 0.5), rng.uniform(0, 1)
        half = rng.uniform(0.05, 0.14, 2)
        around = np.abs((across - side + 0.5) % 1 - 0.5)
        light = light + rng.uniform(2, 8) * np.exp(-((np.abs(down - height) / half[0]) ** 4) - (around / half[1]) ** 4)
    light = light * (radiance / np.sum(weight * light))
    colours = light[..., np.newaxis] * tint(warmth + 0.1 * (0.5 - down)[..., np.newaxis])
    return EnvironmentMap(colours.astype(np.float32))


def tint(warmth: float | NDArray[np.float64]) -> NDArray[np.float64]:
    """Return R, G, B around white with mean 1: reddish for positive warmth, bluish for negative."""
    return 1 + warmth * np.array([1.0, 0.0, -1.0])


def lamp(
    middle_m: NDArray[np.float64],
    direction: NDArray[np.float64],
    distance_m: float,
    radius_m: float,
    exposure: float,
    warmth: float,
) -> SphereLight:
    """Return a lamp in a direction (a unit vector) from a place, behind the camera.

    It gives a white matt surface that faces the camera the radiance ``exposure``: a lamp of radiance L and radius r at a
    distance D gives pi L (r / D)^2 cos(angle) of irradiance.
    """
    radiance = exposure * (distance_m / radius_m) ** 2 / -direction[2]
    return SphereLight(middle_m + distance_m * direction, radius_m, radiance * tint(warmth))


@functools.cache
def _grid() -> tuple[NDArray[np.float64], ...]:
    """Heights 0 (above) to 1, turns 0 to 1, and each pixel's share in lighting a surface that faces the camera."""
    down = (np.arange(_ROWS)[:, np.newaxis] + 0.5) / _ROWS
    across = (np.arange(2 * _ROWS) + 0.5) / (2 * _ROWS)
    # Columns go once around the horizon with straight ahead (+z) in the middle; the surface looks along -z.
    towards = -np.sin(np.pi * down) * np.cos(2 * np.pi * (across - 0.5))
    weight = np.maximum(towards, 0) * np.sin(np.pi * down)
    return np.broadcast_arrays(down, across, weight / weight.sum())
