"""Sampling is proven, not assumed: the PSF at oversampling s against 2 s, on a crop of the mask, and the error bar.

A guard on neighbouring phase steps would be wrong for staircase masks: steps of 2 pi are no error, and published
PhlatCam designs are full of large steps. What counts is whether the image on the sensor still changes.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from simulator.arrays import to_numpy
from simulator.errors import InputError
from simulator.optics.mask import Mask, steepest_frequency
from simulator.optics.psf import Progress, PsfConfig, depth_images, psf_lines, stack_size
from simulator.types import CameraGeometry


class SamplingWarning(UserWarning):
    """A PSF's measured sampling error is above 1 %."""


CROP_M = 1.5e-3  # enough mask for its statistics, little enough to cost under a second
WARN, REFUSE = 0.01, 0.05
MOST = 16  # the oversampling that a configuration may ask for
# With errors that fall like 1 / s or faster, |I(s) - I(2 s)| >= |I(s) - I| / 2: twice the difference holds the whole error.
BAR = 2.0


def sampling_error(mask: Mask, camera: CameraGeometry, psf_config: PsfConfig) -> dict[str, Any]:
    """Measure the relative L2 error of the pixel-integrated PSF that the grid causes.

    Returns:
        ``error`` (the largest) and ``table``: the relative L2 difference between oversampling s and 2 s per depth (nearest
        and farthest; the farthest for ``exact``), at the shortest wavelength, where phases are steepest; ``error_bar``, which
        contains the distance from any finer sampling; JSON-serialisable.
    """
    crop = judged_crop(mask, CROP_M)
    # Between its grid's own samples ``exact`` leaves out light alone, at all depths alike: one of them tells.
    ends = (
        psf_config.depths_m[-1:] if psf_config.model == "exact" else (psf_config.depths_m[0], psf_config.depths_m[-1])
    )
    depths = tuple(dict.fromkeys(ends))
    coarse = replace(psf_config, depths_m=depths)
    fine = replace(coarse, oversampling=2 * psf_config.oversampling)
    wavelength = min(line.wavelength_m for line in psf_lines(camera.response, psf_config))
    table = compared(crop, camera, coarse, fine, [wavelength], stack_size(crop, camera, fine))
    return {
        "error": max(row["error"] for row in table),
        "error_bar": BAR * max(row["error"] for row in table),
        "oversampling": [coarse.oversampling, fine.oversampling],
        "crop_m": max(crop.shape) * crop.pitch_m,
        "table": table,
    }


def compared(
    mask: Mask,
    camera: CameraGeometry,
    psf_config: PsfConfig,
    reference: PsfConfig,
    wavelengths_m: list[float],
    size: int,
    *,
    threads: int = 1,
    progress: Progress | None = None,
) -> list[dict[str, float]]:
    """Return the relative L2 difference of two settings' PSFs of ``size`` pixels, a row per wavelength and depth."""
    table: list[dict[str, float]] = []
    for wavelength_m in wavelengths_m:
        found, expected = (
            depth_images(mask, camera, settings, wavelength_m, size, threads=threads)
            for settings in (psf_config, reference)
        )
        for depth_m, a, b in zip(psf_config.depths_m, found, expected, strict=True):
            error = float(np.linalg.norm(a - b) / np.linalg.norm(b))
            table.append({"wavelength_m": wavelength_m, "depth_m": depth_m, "error": error})
            if progress is not None:
                progress(len(table), len(wavelengths_m) * len(psf_config.depths_m))
    return table


def judged_crop(mask: Mask, width_m: float) -> Mask:
    """Return the middle of a mask as NumPy arrays; where the middle is dark, a part around its most open place."""
    samples = max(round(width_m / mask.pitch_m), 1)
    amplitude = to_numpy(mask.amplitude)
    middle = tuple(slice(max((n - samples) // 2, 0), (n + samples) // 2) for n in mask.shape)
    if not np.any(amplitude[middle] > 0):
        row = int(np.argmax(np.sum(amplitude, axis=1)))
        column = int(np.argmax(amplitude[row]))
        middle = tuple(
            slice(start, start + samples)
            for at, n in zip((row, column), mask.shape, strict=True)
            for start in [min(max(at - samples // 2, 0), max(n - samples, 0))]
        )
    return replace(mask, height_m=to_numpy(mask.height_m)[middle], amplitude=amplitude[middle])


def prove_sampling(mask: Mask, camera: CameraGeometry, psf_config: PsfConfig) -> dict[str, Any]:
    """Measure the sampling error; warn above 1 %, refuse above 5 % or ``accept_error``."""
    if mask.profile == "smooth":
        _refuse_steep_phase(mask, camera, psf_config)
    report = sampling_error(mask, camera, psf_config)
    limit = REFUSE if psf_config.accept_error is None else psf_config.accept_error
    if report["error"] > limit:
        cure = _cure(report["oversampling"][1])
        raise InputError(
            "oversampling",
            f"{psf_config.oversampling} gives a sampling error of {report['error']:.3f} (on pixels, against "
            f"{report['oversampling'][1]}), above the limit of {limit:g}; {cure}, or set accept_error to allow it",
        )
    if report["error"] > WARN:
        warnings.warn(
            f"the PSF's sampling error is {report['error']:.3f} (oversampling {psf_config.oversampling} against "
            f"{report['oversampling'][1]}); it is recorded with the stack",
            SamplingWarning,
            stacklevel=3,
        )
    return report


def _refuse_steep_phase(mask: Mask, camera: CameraGeometry, psf_config: PsfConfig) -> None:
    """Refuse a smooth mask whose phase turns by more than half a turn per sample: beyond Nyquist it is another mask."""
    shortest = min(line.wavelength_m for line in psf_lines(camera.response, psf_config))
    turns = steepest_frequency(mask, shortest) * mask.pitch_m / psf_config.oversampling
    if turns > 0.5:
        needed = int(np.ceil(2 * turns * psf_config.oversampling))
        raise InputError(
            "oversampling",
            f"the smooth mask's phase turns by up to {turns:.2f} turns per sample at {shortest * 1e9:.0f} nm, expected "
            f"at most 0.5; {_cure(needed)}, or profile 'staircase' for a fabricated mask",
        )


def _cure(oversampling: int) -> str:
    return f"use oversampling {oversampling}" if oversampling <= MOST else "give the mask finer samples (pixel_um)"
