"""How far the configured depth model is from its references: ``exact`` by pixel, the direct sum at random points."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from simulator.arrays import to_numpy
from simulator.optics.error_budget.direct_sum import reference_intensity
from simulator.optics.error_budget.sampling import compared, judged_crop
from simulator.optics.mask import Mask
from simulator.optics.psf import Progress, PsfConfig, depth_images, psf_lines, sampled_intensity, stack_size
from simulator.types import CameraGeometry

POINTS = 20  # per depth and wavelength: the error of an error of 20 points is a quarter of it
LEAST = 2  # oversampling with which models are compared
RIM_CROP_M = 1e-3
RIM = 0.63
"""Where the piece that stands for a mask lies on its diagonal, as a share of the way to the corner: there the distance
from the axis, to the fourth power, has its mean over a square."""


def pixel_error(
    mask: Mask,
    camera: CameraGeometry,
    psf_config: PsfConfig,
    wavelengths_m: list[float],
    *,
    threads: int = 1,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Measure the relative L2 difference of the model's PSFs from the exact ones, on the sensor's pixels.

    Both follow twice as many diffraction orders as the stack, at least: models part in the few that only one of them
    follows, and that belongs to the sampling error. ``progress`` is called with (done, total) after every PSF.

    Returns:
        ``error`` (the largest) and ``table``, one row per depth and wavelength; JSON-serialisable.
    """
    found = replace(psf_config, oversampling=max(psf_config.oversampling, LEAST))
    exact = replace(found, model="exact")
    size = max(stack_size(mask, camera, config) for config in (found, exact))
    table = compared(mask, camera, found, exact, wavelengths_m, size, threads=threads, progress=progress)
    return {
        "error": max(row["error"] for row in table),
        "model": psf_config.model,
        "oversampling": found.oversampling,
        "crop_m": max(mask.shape) * mask.pitch_m,
        "table": table,
    }


def rim_error(
    mask: Mask, camera: CameraGeometry, psf_config: PsfConfig, wavelength_m: float, *, crop_m: float = RIM_CROP_M
) -> dict[str, Any]:
    """Estimate ``pixel_error`` of a wide mask at the nearest depth, within a factor of two, from a piece ``crop_m`` wide.

    What a scaled model takes for parabolas is worst at the rim, which the source lights obliquely. Its error there grows
    with the square of the distance from the axis, so a piece where the fourth power of that has its mean stands for all.
    (PhlatCams of 2.5 mm at 7 mm, 3 and 7 mm at 3.6 cm: 3.0, 1.0, 5.2 %, where the whole masks err by 5.8, 1.6, 4.1 %.)

    Returns:
        As ``pixel_error``, with ``from_axis_m``, the piece's distance from the axis; the whole mask's error where it is no
        wider than the piece. Behind a window, where oblique rays land elsewhere, the middle of the mask is judged.
    """
    nearest = replace(psf_config, depths_m=psf_config.depths_m[:1])
    depth_m, samples = nearest.depths_m[0], max(round(crop_m / mask.pitch_m), 1)
    if camera.window or max(mask.shape) <= samples:
        return pixel_error(judged_crop(mask, crop_m), camera, nearest, [wavelength_m]) | {"from_axis_m": 0.0}
    starts = [round(max(n - samples, 0) * (1 + RIM) / 2) for n in mask.shape]
    rows, columns = (slice(start, start + samples) for start in starts)
    piece = replace(
        mask, height_m=to_numpy(mask.height_m[rows, columns]), amplitude=to_numpy(mask.amplitude[rows, columns])
    )
    if not np.any(piece.amplitude > 0):
        return pixel_error(judged_crop(mask, crop_m), camera, nearest, [wavelength_m]) | {"from_axis_m": 0.0}
    y_m, x_m = (
        (start + length / 2 - n / 2) * mask.pitch_m
        for start, length, n in zip(starts, piece.shape, mask.shape, strict=True)
    )
    found = replace(nearest, oversampling=max(psf_config.oversampling, LEAST))
    exact = replace(found, model="exact")
    size = max(stack_size(piece, camera, config) for config in (found, exact))
    (model,) = depth_images(piece, camera, found, wavelength_m, size)
    # Both magnify the piece's place alike. The wave's unit modulus is meant at the mask's middle, not at the piece's.
    (reference,) = depth_images(piece, camera, exact, wavelength_m, size, direction=(-x_m / depth_m, -y_m / depth_m))
    reference = reference / (1 + (x_m**2 + y_m**2) / depth_m**2)
    error = float(np.linalg.norm(model - reference) / np.linalg.norm(reference))
    return {
        "error": error,
        "model": psf_config.model,
        "oversampling": found.oversampling,
        "crop_m": max(piece.shape) * piece.pitch_m,
        "from_axis_m": math.hypot(x_m, y_m),
        "table": [{"wavelength_m": wavelength_m, "depth_m": depth_m, "error": error}],
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
    lines = psf_lines(camera.response, psf_config)
    ordered = sorted({line.wavelength_m for line in lines})
    return list(dict.fromkeys((ordered[0], ordered[len(ordered) // 2], ordered[-1])))
