"""PhlatCam: a phase mask that casts the contours of Perlin noise (Boominathan et al., IEEE TPAMI 42, 1618, 2020)."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from simulator.arrays import samples_across
from simulator.design.fabrication import fabricate
from simulator.design.patterns import contours, contours_of_image
from simulator.design.phase_retrieval import retrieve_phase
from simulator.optics.mask import Mask
from simulator.optics.materials import load_material


def phlatcam(
    *,
    width_mm: Annotated[float, Field(gt=0.05, le=20)] = 7.01,
    pixel_um: Annotated[float, Field(ge=0.2, le=20)] = 2.0,
    distance_um: Annotated[float, Field(gt=50, le=1e5)] = 1869.0,
    image: Path | None = None,
    cell_um: Annotated[float, Field(gt=1, le=1e4)] = 240.0,
    line_um: Annotated[float, Field(gt=0.2, le=500)] = 12.0,
    iterations: Annotated[int, Field(ge=1, le=1000)] = 20,
    tolerance: Annotated[float, Field(ge=0, lt=1)] = 1e-4,
    wavelength_nm: Annotated[float, Field(ge=300, le=2000)] = 532.0,
    material: str = "phlatcam-resist",
    seed: Annotated[int, Field(ge=0)] = 1,
    step_um: Annotated[float, Field(ge=0, le=1)] = 0.2,
    height_error_percent: Annotated[float, Field(gt=-100, le=100)] = 0.0,
    roughness_nm: Annotated[float, Field(ge=0, le=1000)] = 0.0,
    rounding_um: Annotated[float, Field(ge=0, le=100)] = 0.0,
    fabrication_seed: Annotated[int, Field(ge=0)] = 0,
) -> Mask:
    """Return the published recipe's mask: Perlin noise, Canny edges, near-field phase retrieval, quantised heights.

    Its PSF is a net of sharp contour lines as large as the mask, seen at the design distance and blurred within about 0.1
    mm of it. With ``image`` the lines are those of the image: one of two grey levels is the pattern itself, any other
    gives its edges.

    The profile is a staircase of mask pixels. The tolerances (see ``simulator.design.fabrication``) are those of one
    fabricated piece: rounding divides the mask pixels and makes the profile smooth, at the price of a finer grid. How many
    passes the retrieval made, and the overlap that it reached, are recorded with the mask.

    Args:
        width_mm: side of the square mask.
        pixel_um: mask pixel.
        distance_um: mask to sensor in the design, where the contours are sharp.
        image: square image file (PNG, TIFF, EXR, npy) whose lines take the place of Perlin noise.
        cell_um: cell of the Perlin noise: the scale of the contours.
        line_um: width of the contour lines.
        iterations: most passes of the phase retrieval; published masks use 20 to 100.
        tolerance: gain of overlap with the target, per pass, below which the phase retrieval stops; 0 makes all passes.
        wavelength_nm: design wavelength.
        material: of the mask.
        seed: of the noise.
        step_um: height step of the fabrication (heights are rounded down); 0 leaves them continuous.
        height_error_percent: by how much all heights come out too high.
        roughness_nm: standard deviation of each mask pixel's own height error.
        rounding_um: standard deviation of the Gaussian that rounds the edges; 0 leaves them sharp.
        fabrication_seed: of the roughness.
    """
    samples = samples_across(width_mm * 1e3, pixel_um)
    pitch_m, wavelength_m, resist = pixel_um * 1e-6, wavelength_nm * 1e-9, load_material(material)
    wave_m = wavelength_m / resist.refractivity(wavelength_m)
    if image is None:
        target = contours(samples, cell_um / pixel_um, line_um / pixel_um, seed)
    else:
        target = contours_of_image(image, samples, line_um / pixel_um)
    retrieved = retrieve_phase(
        target, pitch_m, wavelength_m, distance_um * 1e-6, iterations, tolerance=tolerance, threads=os.cpu_count() or 1
    )
    turns = np.mod(retrieved.phase / (2 * np.pi), 1).astype(np.float32)
    height_m = turns * np.float32(wave_m)
    notes = {"retrieval": {"passes": len(retrieved.overlap), "overlap": retrieved.overlap[-1]}}
    return fabricate(
        Mask(height_m, np.ones_like(height_m), pitch_m, resist, profile="staircase", name="phlatcam", notes=notes),
        step_m=step_um * 1e-6,
        height_error=height_error_percent * 1e-2,
        roughness_m=roughness_nm * 1e-9,
        rounding_m=rounding_um * 1e-6,
        seed=fabrication_seed,
    )
