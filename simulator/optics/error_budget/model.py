"""How far the configured depth model is from its references: the direct sum at random points, ``exact`` by pixel."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from simulator.optics.error_budget.direct_sum import reference_intensity
from simulator.optics.error_budget.sampling import compared, judged_crop
from simulator.optics.mask import Mask
from simulator.optics.psf import Progress, PsfConfig, sampled_intensity, stack_size
from simulator.optics.spectra import quantile_lines
from simulator.types import CameraGeometry

POINTS = 20  # per depth and wavelength: the error of an error of 20 points is a quarter of it
CROP_M = 1.5e-3


def pixel_error(
    mask: Mask,
    camera: CameraGeometry,
    psf_config: PsfConfig,
    wavelengths_m: list[float],
    *,
    crop_m: float | None = None,
    threads: int = 1,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Measure the relative L2 difference of the model's PSFs from the exact ones, on the sensor's pixels.

    A crop of the mask ``crop_m`` wide is judged, or all of it; ``progress`` is called with (done, total) after every PSF.

    Returns:
        ``error`` (the largest) and ``table``, one row per depth and wavelength; JSON-serialisable.
    """
    part = judged_crop(mask, max(mask.shape) * mask.pitch_m if crop_m is None else crop_m)
    exact = replace(psf_config, model="exact")
    size = max(stack_size(part, camera, config) for config in (psf_config, exact))
    table = compared(part, camera, psf_config, exact, wavelengths_m, size, threads=threads, progress=progress)
    return {
        "error": max(row["error"] for row in table),
        "model": psf_config.model,
        "crop_m": max(part.shape) * part.pitch_m,
        "table": table,
    }


def direct_error(
    mask: Mask,
    camera: CameraGeometry,
    psf_config: PsfConfig,
    wavelengths_m: list[float],
    *,
    points: int = POINTS,
    seed: int = 0,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Measure the relative L2 error of the model's intensity at random sensor points against the direct sum, in air.

    The points lie on the model's own grid and are not averaged over pixels, so this judges the wave itself: fine
    structure that a pixel would blur counts in full.

    Returns:
        ``error`` (the largest) and ``table``, one row per depth and wavelength with the reference's own ``uncertainty``;
        JSON-serialisable.
    """
    rng = np.random.default_rng(seed)
    table, total = [], len(wavelengths_m) * len(psf_config.depths_m)
    for wavelength_m in wavelengths_m:
        for depth_m in psf_config.depths_m:
            places_m, found = sampled_intensity(mask, camera, psf_config, wavelength_m, depth_m, points, rng)
            reference, off = reference_intensity(mask, wavelength_m, camera.mask_to_sensor_m, depth_m, places_m)
            error, uncertainty = (
                float(np.linalg.norm(x) / np.linalg.norm(reference)) for x in (found - reference, off)
            )
            row = {"wavelength_m": wavelength_m, "depth_m": depth_m, "error": error, "uncertainty": uncertainty}
            table.append(row)
            if progress is not None:
                progress(len(table), total)
    return {"error": max(row["error"] for row in table), "points": points, "table": table}


def three_depths(depths_m: tuple[float, ...]) -> tuple[float, ...]:
    """Return the nearest, the middle (in disparity) and the farthest depth, fewer when there are fewer.

    Example:
        >>> three_depths((0.1, 0.15, 0.2, 0.5, float("inf")))
        (0.1, 0.2, inf)
    """
    disparity = 1 / np.asarray(depths_m)
    middle = int(np.argmin(np.abs(disparity - (disparity[0] + disparity[-1]) / 2)))
    return tuple(dict.fromkeys((depths_m[0], depths_m[middle], depths_m[-1])))


def three_wavelengths(camera: CameraGeometry, psf_config: PsfConfig) -> list[float]:
    """Return the shortest, the middle and the longest wavelength of the configuration, metres."""
    lines = quantile_lines(camera.response, psf_config.wavelengths_per_channel)
    ordered = sorted({line.wavelength_m for line in lines})
    return list(dict.fromkeys((ordered[0], ordered[len(ordered) // 2], ordered[-1])))
