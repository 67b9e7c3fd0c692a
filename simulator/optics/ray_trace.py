"""A geometric PSF as a cross-check of the wave optics: rays through a smooth height map by Snell's law.

Every ray stands for a small patch of the mask; it enters the flat side, is refracted where it leaves the surface, by
the slope of the same cubic interpolation that the wave engine sees, and drops its power into the pixel that it hits.
The thin element takes no part of the path inside it, just as the thin element of the wave optics.

Sources: vector form of Snell's law, Glassner, An Introduction to Ray Tracing (1989), section 2.4; cubic convolution,
Keys, IEEE Trans. ASSP 29, 1153 (1981); places of the rays, Roberts' R2 sequence (a two-dimensional golden ratio).
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import to_numpy
from simulator.errors import InputError
from simulator.optics.error_budget.drjit_process import run_kernel
from simulator.optics.mask import Mask

_R2 = (0.7548776662466927, 0.5698402909980532)  # 1 / g and 1 / g^2, g^3 = g + 1
_CHUNK = 2**18  # rays at a time on NumPy


class Rays(NamedTuple):
    """Geometry of one trace; numbers of NumPy or Dr.Jit.

    Attributes:
        pitch_m: pitch of the mask's samples, metres.
        distance_m: mask to sensor, metres.
        index: refractive index of the mask's material.
        depth_m: z of the source on the axis, metres, or ``inf``.
        pixel_m: pitch of the sensor's pixels, metres.
    """

    pitch_m: Any
    distance_m: Any
    index: Any
    depth_m: Any
    pixel_m: Any


def geometric_psf(
    mask: Mask,
    wavelength_m: float,
    distance_m: float,
    depth_m: float,
    pixel_pitch_m: float,
    size: int,
    *,
    rays_per_sample: int = 4,
) -> NDArray[np.float64]:
    """Return the PSF of rays from an on-axis point, in the units and the frame of ``psf.depth_images``.

    Args:
        mask: a smooth mask.
        wavelength_m: wavelength, metres; it decides the index alone.
        distance_m: mask to sensor, metres.
        depth_m: z of the source from the mask plane, metres, or ``inf``.
        pixel_pitch_m: pitch of the pixels, metres.
        size: rows and columns of the result; rays that land outside are lost.
        rays_per_sample: rays per mask sample and axis.

    Returns:
        ``(size, size)`` irradiance per irradiance at the mask's centre, stored frame (turned by 180 degrees).

    Raises:
        InputError: for a staircase, whose light leaves by diffraction, not by refraction, or implausible numbers.
    """
    if mask.profile != "smooth":
        msg = (
            f"mask {mask.name!r}: its profile is {mask.profile!r}, and rays see no slope on flat steps; trace the smooth "
            "surface that it approximates (profile 'smooth')"
        )
        raise InputError(msg)
    if min(mask.shape) < 4:
        msg = f"mask {mask.name!r}: has {mask.shape} samples; the slope of the surface needs at least 4 per axis"
        raise InputError(msg)
    for name, value in (("distance_m", distance_m), ("depth_m", depth_m), ("pixel_pitch_m", pixel_pitch_m)):
        if not value > 0:
            msg = f"{name}: got {value!r}, expected positive metres"
            raise InputError(msg)
    if rays_per_sample < 1 or size < 1:
        msg = f"rays_per_sample and size must be at least 1, got {rays_per_sample} and {size}"
        raise InputError(msg)
    rays = Rays(mask.pitch_m, distance_m, mask.material.index(wavelength_m), depth_m, pixel_pitch_m)
    height, amplitude = (np.ascontiguousarray(to_numpy(part)) for part in (mask.height_m, mask.amplitude))
    job = {"height_m": height, "amplitude": amplitude, "rays_per_sample": rays_per_sample, "size": size}
    power = run_kernel("simulator.optics.ray_trace_drjit", **job, **rays._asdict())
    if power is None:
        power = trace_numpy(rays, **job)
    return np.flip(power) / pixel_pitch_m**2


def trace(
    m: Any, rays: Rays, plane: bool, shape: tuple[int, int], row: Any, column: Any, take: Any
) -> tuple[Any, Any, Any]:
    """Return where rays land, x and y in metres, and their intensity, on NumPy or Dr.Jit.

    Args:
        m: the module that brings sqrt and floor: ``numpy`` or ``drjit``.
        rays: geometry.
        plane: whether the source lies at infinity.
        shape: rows and columns of the mask.
        row: place of the rays on the mask, in samples.
        column: the same along x.
        take: function of (part, row index, column index) that reads part 0, the height, or part 1, the amplitude.
    """
    height, width = shape
    y, x = (row - (height - 1) / 2) * rays.pitch_m, (column - (width - 1) / 2) * rays.pitch_m
    first_row, first_column = m.floor(row), m.floor(column)
    weights_y, slopes_y = _keys(row - first_row)
    weights_x, slopes_x = _keys(column - first_column)
    slope_y = slope_x = amplitude = 0.0
    for i in range(4):
        for j in range(4):
            at = first_row + (i - 1), first_column + (j - 1)
            surface = take(0, *at)
            slope_y = slope_y + slopes_y[i] * weights_x[j] * surface
            slope_x = slope_x + weights_y[i] * slopes_x[j] * surface
            amplitude = amplitude + weights_y[i] * weights_x[j] * take(1, *at)
    slope_y, slope_x = slope_y / rays.pitch_m, slope_x / rays.pitch_m
    intensity = amplitude * amplitude
    if plane:
        inside_x = inside_y = 0.0
    else:
        to_source = m.sqrt(x * x + y * y + rays.depth_m * rays.depth_m)
        inside_x, inside_y = x / to_source / rays.index, y / to_source / rays.index
        intensity = intensity * (rays.depth_m / to_source) * (rays.depth_m / to_source)
    inside_z = m.sqrt(1 - inside_x * inside_x - inside_y * inside_y)
    # The surface w = h(x, y) along the light's way w; its normal points out of the material.
    length = m.sqrt(1 + slope_x * slope_x + slope_y * slope_y)
    cosine = (inside_z - inside_x * slope_x - inside_y * slope_y) / length
    along = m.sqrt(1 - rays.index * rays.index * (1 - cosine * cosine)) - rays.index * cosine
    out_x = rays.index * inside_x - along * slope_x / length
    out_y = rays.index * inside_y - along * slope_y / length
    out_z = rays.index * inside_z + along / length
    return x + rays.distance_m * out_x / out_z, y + rays.distance_m * out_y / out_z, intensity


def place(m: Any, index: Any, across: Any, per_sample: Any) -> tuple[Any, Any]:
    """Return row and column, in samples, of the rays with these indices, ``across`` of them per row of rays."""
    number_row = m.floor((index + 0.5) / across)
    places = []
    for number, step in ((number_row, _R2[0]), (index - number_row * across, _R2[1])):
        turns = index * step
        places.append((number + turns - m.floor(turns)) / per_sample - 0.5)
    return places[0], places[1]


def trace_numpy(
    rays: Rays, height_m: NDArray[np.floating], amplitude: NDArray[np.floating], rays_per_sample: int, size: int
) -> NDArray[np.float64]:
    """Return the power per pixel ``(size, size)``, square metres per unit irradiance, physical frame, by NumPy."""
    parts, (height, width) = (height_m, amplitude), height_m.shape

    def take(part: int, row: NDArray[np.float64], column: NDArray[np.float64]) -> NDArray[np.float64]:
        at = np.clip(row, 0, height - 1).astype(np.intp), np.clip(column, 0, width - 1).astype(np.intp)
        return parts[part][at].astype(np.float64)

    across, total = width * rays_per_sample, height * width * rays_per_sample**2
    power = np.zeros(size * size)
    for start in range(0, total, _CHUNK):
        index = np.arange(start, min(start + _CHUNK, total), dtype=np.float64)
        row, column = place(np, index, across, rays_per_sample)
        x, y, intensity = trace(np, rays, math.isinf(rays.depth_m), (height, width), row, column, take)
        pixel_x, pixel_y = (np.floor(part / rays.pixel_m + 0.5) + size // 2 for part in (x, y))
        # A ray that is reflected inside (NaN) fails every comparison and is lost.
        inside = (pixel_x >= 0) & (pixel_x < size) & (pixel_y >= 0) & (pixel_y < size)
        at = (pixel_y[inside] * size + pixel_x[inside]).astype(np.intp)
        power += np.bincount(at, intensity[inside], size * size)
    return power.reshape(size, size) * (rays.pitch_m / rays_per_sample) ** 2


def _keys(t: Any) -> tuple[list[Any], list[Any]]:
    """Return the weights of four neighbours for the value and for its derivative at a fraction ``t`` of a sample."""
    t2 = t * t
    t3 = t2 * t
    values = [(-t3 + 2 * t2 - t) / 2, (3 * t3 - 5 * t2 + 2) / 2, (-3 * t3 + 4 * t2 + t) / 2, (t3 - t2) / 2]
    slopes = [(-3 * t2 + 4 * t - 1) / 2, (9 * t2 - 10 * t) / 2, (-9 * t2 + 8 * t + 1) / 2, (3 * t2 - 2 * t) / 2]
    return values, slopes
