"""A phase vortex: light that winds around the axis and leaves it dark (Beijersbergen et al., Opt. Commun. 112, 321, 1994)."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from psf_library.designs.lens import focusing_path_m
from simulator.arrays import samples_across
from simulator.design.patterns import round_aperture, sample_positions_m
from simulator.optics.mask import Mask
from simulator.optics.materials import load_material


def vortex(
    *,
    charge: Annotated[int, Field(ge=-1000, le=1000)] = 24,
    width_mm: Annotated[float, Field(gt=0.01, le=20)] = 0.3,
    pixel_um: Annotated[float, Field(ge=0.1, le=20)] = 2.0,
    distance_um: Annotated[float, Field(gt=50, le=1e5)] | None = 1900.0,
    wavelength_nm: Annotated[float, Field(ge=300, le=2000)] = 532.0,
    material: str = "fused-silica",
) -> Mask:
    """Return a spiral phase plate of a whole charge that also focuses; its PSF is a doughnut.

    The phase is charge x the angle plus a lens of focal length ``distance_um``, where the sensor belongs. There the light
    of the rim, bent sideways by charge x lambda / (pi width), makes a bright ring a quarter wider than charge x lambda f /
    (pi width), 32 um in radius by default, and light from further in falls outside it; in the design colour the middle is
    dark at every depth. Charge 0 is a diffractive lens. Without a distance the spiral stands alone: at 2 mm a shadow of the
    aperture with a dark hole.

    Heights stay below one wave and jump at its end: a staircase. The spiral turns counter-clockwise as seen from the scene
    (clockwise from behind the sensor, where y points down) for a positive charge.

    Args:
        charge: turns of phase around the axis; its sign is the sense of rotation.
        width_mm: diameter of the aperture.
        pixel_um: mask pixel.
        distance_um: focal length of the lens, or null for none.
        wavelength_nm: design wavelength.
        material: of the mask.
    """
    samples = samples_across(width_mm * 1e3, pixel_um)
    pitch_m, wavelength_m, glass = pixel_um * 1e-6, wavelength_nm * 1e-9, load_material(material)
    x = sample_positions_m(samples, pitch_m)
    turns = charge * np.arctan2(x[:, None], x[None, :]) / (2 * np.pi)
    if distance_um is not None:
        turns += focusing_path_m(samples, pitch_m, distance_um * 1e-6) / wavelength_m
    height_m = (np.mod(turns, 1) * wavelength_m / glass.refractivity(wavelength_m)).astype(np.float32)
    amplitude = round_aperture(samples, width_mm * 1e3 / pixel_um)
    return Mask(height_m, amplitude, pitch_m, glass, profile="staircase", name="vortex")
