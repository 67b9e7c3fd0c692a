"""PhlatCam: a phase mask that casts the contours of Perlin noise (Boominathan et al., IEEE TPAMI 42, 1618, 2020)."""

from __future__ import annotations

import os
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from simulator.optics.mask import Mask
from simulator.optics.materials import PHLATCAM_RESIST
from simulator.optics.noise import perlin
from simulator.optics.phase_retrieval import retrieve_phase

WAVELENGTH_M = 532e-9


def phlatcam(
    *,
    width_mm: Annotated[float, Field(gt=0.05, le=20)] = 7.01,
    pixel_um: Annotated[float, Field(ge=0.2, le=20)] = 2.0,
    distance_um: Annotated[float, Field(gt=50, le=1e5)] = 1869.0,
    cell_um: Annotated[float, Field(gt=1, le=1e4)] = 240.0,
    line_um: Annotated[float, Field(gt=0.2, le=500)] = 12.0,
    step_um: Annotated[float, Field(ge=0, le=1)] = 0.2,
    iterations: Annotated[int, Field(ge=1, le=1000)] = 20,
    seed: Annotated[int, Field(ge=0)] = 1,
) -> Mask:
    """Return the published recipe's mask: Perlin noise, Canny edges, near-field phase retrieval, quantised heights.

    Args:
        width_mm: side of the square mask.
        pixel_um: mask pixel.
        distance_um: mask to sensor in the design, where the contours are sharp.
        cell_um: cell of the Perlin noise: the scale of the contours.
        line_um: width of the contour lines.
        step_um: height step of the fabrication (heights are rounded down); 0 leaves them continuous.
        iterations: passes of the phase retrieval; published masks use 20 to 100.
        seed: of the noise.
    """
    samples = round(width_mm * 1e3 / pixel_um)
    target = contours(samples, cell_um / pixel_um, line_um / pixel_um, seed)
    phase = retrieve_phase(
        target, pixel_um * 1e-6, WAVELENGTH_M, distance_um * 1e-6, iterations, threads=os.cpu_count() or 1
    )
    turns = np.mod(phase / (2 * np.pi), 1).astype(np.float32)
    height_m = turns * np.float32(WAVELENGTH_M / (PHLATCAM_RESIST.index(WAVELENGTH_M) - 1))
    if step_um:
        height_m = np.floor(height_m / (step_um * 1e-6)).astype(np.float32) * np.float32(step_um * 1e-6)
    return Mask(
        height_m, np.ones_like(height_m), pixel_um * 1e-6, PHLATCAM_RESIST, profile="staircase", name="phlatcam"
    )


def contours(samples: int, cell: float, line: float, seed: int) -> NDArray[np.float32]:
    """Return the target PSF: contour lines of Perlin noise, float32 ``(samples, samples)`` of 0 and 1.

    Args:
        samples: side of the image.
        cell: cell of the noise, in samples.
        line: width of the lines, in samples.
        seed: of the noise.
    """
    from scipy.ndimage import binary_dilation
    from skimage.feature import canny

    noise = perlin((samples, samples), cell, seed)
    # The thresholds follow the gradients' quantiles, as the original Canny implementation chooses them.
    edges = canny(noise, sigma=cell / 60, low_threshold=0.28, high_threshold=0.7, use_quantiles=True)
    if not edges.any():
        edges[samples // 2] = True  # a mask smaller than a cell may hold no contour: one line keeps it a camera
    y, x = np.ogrid[-int(line / 2) : int(line / 2) + 1, -int(line / 2) : int(line / 2) + 1]
    return binary_dilation(edges, x**2 + y**2 <= (line / 2) ** 2).astype(np.float32)
