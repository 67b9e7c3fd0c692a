"""Fresnel zone aperture: rings whose shadow encodes direction as a fringe (Shimano et al., Appl. Opt. 57, 2841, 2018)."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from simulator.arrays import samples_across
from simulator.design.patterns import sample_positions_m
from simulator.optics.mask import Mask

_SUBPIXELS = 8


def fresnel_zone(
    *,
    width_mm: Annotated[float, Field(gt=0.01, le=20)] = 2.4,
    pixel_um: Annotated[float, Field(ge=0.1, le=20)] = 2.0,
    first_zone_um: Annotated[float, Field(gt=0.5, le=5000)] = 320.0,
    phase_degrees: Annotated[float, Field(ge=-360, le=360)] = 0.0,
    binary: bool = True,
) -> Mask:
    """Return a Fresnel zone aperture; its PSF is its own shadow, rings that grow finer outwards.

    It transmits the share 1/2 (1 + cos(beta r^2 + phase)) of the light, beta = pi / r_1^2 (Shimano et al., eq. 1), or
    binary, as it is fabricated, all light where that exceeds one half (Wu et al., Light Sci. Appl. 9, 53, 2020, use
    r_1 = 0.32 mm). The rings repeat with the area 2 pi r_1^2; at the rim a light and a dark ring together are 2 r_1^2 /
    width wide, and the shadow is a shadow only where that is well above sqrt(lambda d): the default's 85 um want a sensor
    about 2 mm away. Four masks of phases 0, 90, 180 and 270 degrees make the fringe scan that removes the twin image.

    As a zone plate it focuses at r_1^2 / lambda, 19 cm by default: far behind the sensor. With small first zones (31.8 um
    for 1.9 mm) it is a diffractive lens.

    Edges are weighted by area and stand for sharp ones, hence the smooth profile of a mask without height.

    Args:
        width_mm: side of the square aperture.
        pixel_um: sample of the grid.
        first_zone_um: r_1, where the cosine has gone through half a turn.
        phase_degrees: phase of the cosine on the axis.
        binary: open or shut, or the grey cosine.
    """
    samples = samples_across(width_mm * 1e3, pixel_um)
    fine_m = sample_positions_m(samples * _SUBPIXELS, pixel_um * 1e-6 / _SUBPIXELS)
    angle = np.pi * (fine_m / (first_zone_um * 1e-6)) ** 2
    # cos(a + b) from products of what each axis needs once, a sub-pixel of all samples at a time.
    x = np.exp(1j * angle).astype(np.complex64).reshape(samples, _SUBPIXELS)
    y = x * np.complex64(np.exp(1j * np.radians(phase_degrees)))
    amplitude = np.zeros((samples, samples), np.float32)
    for row, column in np.ndindex(_SUBPIXELS, _SUBPIXELS):
        cosine = np.outer(y[:, row].real, x[:, column].real) - np.outer(y[:, row].imag, x[:, column].imag)
        amplitude += cosine > 0 if binary else np.sqrt(np.clip((1 + cosine) / 2, 0, 1))
    amplitude /= _SUBPIXELS**2
    return Mask(np.zeros_like(amplitude), amplitude, pixel_um * 1e-6, profile="smooth", name="fresnel_zone")
