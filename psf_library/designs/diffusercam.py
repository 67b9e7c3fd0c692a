"""DiffuserCam: a smooth random phase that focuses caustics (Antipa et al., Optica 5, 1, 2018)."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from simulator.arrays import samples_across
from simulator.design.patterns import gaussian_surface
from simulator.optics.mask import Mask
from simulator.optics.materials import load_material


def diffusercam(
    *,
    width_mm: Annotated[float, Field(gt=0.05, le=20)] = 5.0,
    pixel_um: Annotated[float, Field(ge=0.2, le=20)] = 2.0,
    correlation_um: Annotated[float, Field(gt=1, le=5000)] = 140.0,
    slope_degrees: Annotated[float, Field(gt=0, lt=20)] = 0.7,
    wavelength_nm: Annotated[float, Field(ge=300, le=2000)] = 532.0,
    material: str = "fused-silica",
    seed: Annotated[int, Field(ge=0)] = 1,
) -> Mask:
    """Return a smooth random surface; its PSF is a net of caustics, bright lines where the surface's hills focus.

    The published diffuser lies about 10 mm from its sensor: set ``mask_to_sensor_mm: 10``. The hills' focal lengths spread
    around correlation / (sqrt(6) slope), 5 mm by default; nearer to the mask than about half of that the light is only
    mottled, and far beyond it the caustics of many hills overlap. It is Gaussian noise of a Gaussian autocorrelation, the
    usual model of such diffusers; a real one's surface is not published.

    Args:
        width_mm: side of the square aperture.
        pixel_um: sample of the height map.
        correlation_um: 1/e half-width of the surface's autocorrelation.
        slope_degrees: angle by which the surface bends light (standard deviation per axis); 0.5-0.7 degrees is the
            strength of the published 0.5 degree diffuser.
        wavelength_nm: wavelength of ``slope_degrees``.
        material: of the diffuser.
        seed: of the surface.
    """
    glass = load_material(material)
    samples = samples_across(width_mm * 1e3, pixel_um)
    surface = gaussian_surface((samples, samples), correlation_um / pixel_um, seed)
    # exp(-x^2 / c^2) has the slope's standard deviation sqrt(2) / c; light bends by (n - 1) times the slope.
    slope = np.tan(np.radians(slope_degrees)) / glass.refractivity(wavelength_nm * 1e-9)
    height_m = surface * np.float32(slope * correlation_um * 1e-6 / np.sqrt(2))
    height_m -= height_m.min()
    return Mask(height_m, np.ones_like(height_m), pixel_um * 1e-6, glass, profile="smooth", name="diffusercam")
