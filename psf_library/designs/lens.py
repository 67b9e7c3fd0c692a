"""A thin lens: the camera that lensless ones are compared with, and its flat, wrapped kin, the diffractive lens."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from simulator.arrays import samples_across
from simulator.design.patterns import radius_squared_m2, round_aperture
from simulator.optics.mask import Mask
from simulator.optics.materials import load_material


def lens(
    *,
    width_mm: Annotated[float, Field(gt=0.01, le=20)] = 0.4,
    pixel_um: Annotated[float, Field(ge=0.1, le=20)] = 1.0,
    distance_um: Annotated[float, Field(gt=50, le=1e5)] = 1900.0,
    wavelength_nm: Annotated[float, Field(ge=300, le=2000)] = 532.0,
    material: str = "fused-silica",
    wrap: bool = False,
) -> Mask:
    """Return a round lens without spherical aberration; its PSF is an Airy pattern of radius 1.22 lambda f / width.

    The sensor lies at the focal length, ``mask_to_sensor_mm`` = ``distance_um`` / 1000. The thin element's height delays
    each ray by as much as its way to the focus is shorter than the rim's: (n - 1) h = sqrt(R^2 + f^2) - sqrt(r^2 + f^2)
    (Goodman, Introduction to Fourier Optics, section 6.1, without the paraxial step).

    A lens as high as it is has a smooth profile, and its light must not turn by more than half a turn per sample at the
    rim: pixel <= lambda f / width. Wrapped at one wave it is a kinoform (Lesem, Hirsch and Jordan, IBM J. Res. Dev. 13,
    150, 1969): its height jumps, so it is a staircase that diffracts some light elsewhere and focuses other colours at
    f lambda_design / lambda.

    Args:
        width_mm: diameter of the lens.
        pixel_um: sample of the height map.
        distance_um: focal length at the design wavelength.
        wavelength_nm: design wavelength.
        material: of the lens.
        wrap: keep heights below one wave.
    """
    samples = samples_across(width_mm * 1e3, pixel_um)
    pitch_m, wavelength_m, glass = pixel_um * 1e-6, wavelength_nm * 1e-9, load_material(material)
    height_m = focusing_path_m(samples, pitch_m, distance_um * 1e-6)
    if wrap:
        height_m = np.mod(height_m, wavelength_m)
    height_m = (height_m / glass.refractivity(wavelength_m)).astype(np.float32)
    amplitude = round_aperture(samples, width_mm * 1e3 / pixel_um)
    return Mask(height_m, amplitude, pitch_m, glass, profile="staircase" if wrap else "smooth", name="lens")


def focusing_path_m(samples: int, pitch_m: float, focal_m: float) -> np.ndarray:
    """Return the optical path, metres, that a lens adds so that a plane wave meets at its focus; zero at the corners.

    Args:
        samples: side of the square grid.
        pitch_m: of the grid, metres.
        focal_m: focal length, metres.
    """
    way = np.sqrt(radius_squared_m2(samples, pitch_m) + focal_m**2)
    return way.max() - way
