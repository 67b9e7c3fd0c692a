"""What one PSF for all directions costs: the PSF off the axis, and the measurement of scenes, against exact oblique PSFs."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.optics.error_budget.sampling import judged_crop
from simulator.optics.mask import Mask
from simulator.optics.psf import Progress, PsfConfig, depth_images, stack_size
from simulator.types import CameraGeometry, View

CROP_M = 1e-3  # PHYSICS: errors of directions are quoted for a crop, since wide masks wash them out
PATCHES = 4
"""Per axis. Speckle of directions 0.2 apart in the tangent has nothing in common, so that a PSF in the middle of each patch
stands for the others there: 5 instead of 4 patches move none of the errors by more than a tenth of it."""
_AXIS = (
    1e-9,
    0.0,
)  # near enough; straight on it exact PSFs leave out the cosines of diffracted light, as all models do
_SCENES, _SHARE_LIT = 4, 0.01


def field_error(
    mask: Mask,
    camera: CameraGeometry,
    psf_config: PsfConfig,
    wavelength_m: float,
    view: View,
    *,
    crop_m: float | None = CROP_M,
    threads: int = 1,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Measure what is wrong when the PSF on the axis stands for all directions of a view, at the farthest depth.

    The PSFs are exact ones on pixels, placed as a convolution places them. A measurement is the sum over patches of the
    view, each convolved with the PSF of its middle; scenes darken towards the rim as real ones do, by cos^4.

    Args:
        mask: the mask; a crop ``crop_m`` wide is judged, or all of it.
        camera: distance or layers, binned pixel pitch.
        psf_config: depths, oversampling.
        wavelength_m: metres.
        view: the scene's directions.
        crop_m: metres, or None.
        threads: as in ``compute_psf_stack``.
        progress: called with (done, total) after every direction.

    Returns:
        Relative L2 errors: ``error`` of the PSF (rms over the field), ``texture`` and ``points`` of the measurement of 1/f
        textures and of scenes of which one pixel in a hundred shines; ``table``, a row per direction; JSON-serialisable.
    """
    crop = mask if crop_m is None else judged_crop(mask, crop_m)
    exact = replace(psf_config, depths_m=psf_config.depths_m[-1:], model="exact")
    size = stack_size(crop, camera, exact)
    tangents_y, tangents_x = ((np.arange(n) - (n - 1) / 2) * (view.pixel_pitch_m / view.distance_m) for n in view.shape)
    patches = [(rows, columns) for rows in _parts(view.shape[0]) for columns in _parts(view.shape[1])]
    middles = [(float(tangents_x[columns].mean()), float(tangents_y[rows].mean())) for rows, columns in patches]
    directions = [_AXIS, *middles]
    images = []
    for direction in directions:
        images += depth_images(crop, camera, exact, wavelength_m, size, threads=threads, direction=direction)
        if progress is not None:
            progress(len(images), len(directions))
    axis, *oblique = (np.asarray(image, np.float64) for image in images)
    table = [
        {
            "degrees": math.degrees(math.atan(math.hypot(*direction))),
            "direction": list(direction),
            "error": float(np.linalg.norm(axis - image) / np.linalg.norm(image)),
        }
        for direction, image in zip(middles, oblique, strict=True)
    ]
    vignetting = 1 / (1 + tangents_y[:, None] ** 2 + tangents_x[None, :] ** 2) ** 2
    psfs = list(zip(patches, oblique, strict=True))
    return {
        "error": math.sqrt(sum(row["error"] ** 2 for row in table) / len(table)),
        "texture": _measured(vignetting, axis, psfs, _texture),
        "points": _measured(vignetting, axis, psfs, _points),
        "wavelength_m": wavelength_m,
        "depth_m": exact.depths_m[0],
        "crop_m": max(crop.shape) * crop.pitch_m,
        "table": table,
    }


def _parts(pixels: int) -> list[slice]:
    edges = np.linspace(0, pixels, min(PATCHES, pixels) + 1).round().astype(int)
    return [slice(int(start), int(stop)) for start, stop in pairwise(edges)]


Image = NDArray[np.float64]


def _measured(
    vignetting: Image,
    axis: Image,
    psfs: list[tuple[tuple[slice, slice], Image]],
    scene: Callable[[tuple[int, ...], np.random.Generator], Image],
) -> float:
    """Return the error of measurements made with the axis's PSF against those made with each patch's own."""
    from scipy.signal import fftconvolve

    rng = np.random.default_rng(0)
    difference = total = 0.0
    for _ in range(_SCENES):
        light = scene(vignetting.shape, rng) * vignetting
        found = fftconvolve(light, axis)
        true = np.zeros_like(found)
        for (rows, columns), psf in psfs:
            part = fftconvolve(light[rows, columns], psf)
            true[rows.start : rows.start + part.shape[0], columns.start : columns.start + part.shape[1]] += part
        difference += float(np.sum((found - true) ** 2))
        total += float(np.sum(true**2))
    return math.sqrt(difference / total)


def _texture(shape: tuple[int, ...], rng: np.random.Generator) -> Image:
    """Return noise with an amplitude spectrum of 1/f, as natural images have it, from 0 to 1."""
    frequency = np.hypot(np.fft.fftfreq(shape[0])[:, None], np.fft.fftfreq(shape[1])[None, :])
    frequency[0, 0] = np.inf
    noise = np.fft.ifft2(np.fft.fft2(rng.standard_normal(shape)) / frequency).real
    return (noise - noise.min()) / max(float(np.ptp(noise)), 1e-12)


def _points(shape: tuple[int, ...], rng: np.random.Generator) -> Image:
    """Return single bright pixels at random places, at least one."""
    light = (rng.random(shape) < _SHARE_LIT).astype(np.float64)
    light[rng.integers(shape[0]), rng.integers(shape[1])] = 1
    return light
