"""Odd-symmetry spiral phase grating of ultra-miniature imagers (Gill, Opt. Lett. 38, 2074, 2013; Gill and Stork, 2013-14)."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from simulator.arrays import samples_across
from simulator.design.patterns import sample_positions_m
from simulator.optics.mask import Mask
from simulator.optics.materials import load_material


def spiral(
    *,
    width_mm: Annotated[float, Field(gt=0.01, le=20)] = 1.5,
    pixel_um: Annotated[float, Field(ge=0.1, le=20)] = 2.0,
    arms: Annotated[int, Field(ge=1, le=99)] = 9,
    pitch_degrees: Annotated[float, Field(gt=0, lt=90)] = 45.0,
    wavelength_nm: Annotated[float, Field(ge=300, le=2000)] = 532.0,
    material: str = "fused-silica",
) -> Mask:
    """Return a two-level grating of logarithmic spiral arms, every edge of which casts a dark line.

    Odd symmetry means that the field changes its sign across a line: light from both sides cancels below it, at any
    distance (Gill 2013). Here ``arms`` raised arms alternate with as many low ones, half a wave apart at the design
    wavelength: t = sign(sin(arms (angle - cot(pitch) ln r))). Each edge meets every circle around the axis at
    ``pitch_degrees``, and arms widen as pi r sin(pitch) / arms, so that the grating holds every scale from its pixel to its
    rim, the "visual chirp" of Stork and Gill (Sensorcomm 2013). Near an edge the field is odd to first order in the
    distance from it. An odd number of arms makes the whole mask odd, t(-x) = -t(x): its axis is dark at any distance and
    the PSF is symmetric under a half turn. The published gratings are of this family; the exact course of their arms is
    not tabulated in the papers, so the logarithmic spiral is this library's choice.

    At another wavelength the step is not half a wave and cos^2 of half the phase passes as if there were no grating: 9 %
    at 450 nm. Any short distance serves; dark lines are sqrt(lambda d) wide, 30 um at 1.9 mm.

    Args:
        width_mm: side of the square mask.
        pixel_um: mask pixel.
        arms: raised arms; odd for a dark axis.
        pitch_degrees: angle between an arm's edge and the circle around the axis; 90 would be straight spokes.
        wavelength_nm: wavelength at which the step is half a wave.
        material: of the mask.
    """
    samples = samples_across(width_mm * 1e3, pixel_um)
    samples += samples % 2  # no sample on the axis, where the arms meet
    pitch_m, wavelength_m, glass = pixel_um * 1e-6, wavelength_nm * 1e-9, load_material(material)
    x = sample_positions_m(samples, pitch_m)
    winding = np.log(np.hypot(x[:, None], x[None, :]) / pitch_m) / np.tan(np.radians(pitch_degrees))
    # Half the plane is computed and rotated by rule: rounding on an edge must not break the symmetry.
    half = samples // 2
    raised = np.sin(arms * (np.arctan2(x[:half, None], x[None, :]) - winding[:half])) >= 0
    rotated = raised[::-1, ::-1]
    raised = np.concatenate([raised, ~rotated if arms % 2 else rotated])
    height_m = (raised * (wavelength_m / 2 / glass.refractivity(wavelength_m))).astype(np.float32)
    return Mask(height_m, np.ones_like(height_m), pitch_m, glass, profile="staircase", name="spiral")
