"""A PSF stack with its error budget: a quick one that comes with every proven stack, and a full one on request.

Quick, on crops, in seconds: the sampling error (before the stack is computed), wavelengths per channel against many, the
depth model against ``exact``. Full, in minutes: the model on the whole mask against ``exact`` on
pixels and against the direct Rayleigh-Sommerfeld sum at random points, and the field angle.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from simulator.arrays import number
from simulator.optics.error_budget.direct_sum import llvm_works
from simulator.optics.error_budget.field import field_angle_error
from simulator.optics.error_budget.model import CROP_M, direct_error, pixel_error, three_depths, three_wavelengths
from simulator.optics.error_budget.sampling import judged_crop, prove_sampling
from simulator.optics.error_budget.spectrum import spectral_error
from simulator.optics.mask import Mask
from simulator.optics.psf import Progress, PsfConfig, compute_psf_stack
from simulator.optics.stack import PsfStack
from simulator.types import CameraGeometry

PLAIN_CROP_M = 0.5e-3  # of the mask in the direct sum without LLVM: 20 points take a second per depth and wavelength


def proven_psf_stack(
    mask: Mask,
    camera: CameraGeometry,
    psf_config: PsfConfig,
    *,
    xp: str = "numpy",
    threads: int = 1,
    progress: Progress | None = None,
) -> PsfStack:
    """Prove the sampling, compute a stack and measure its other errors; arguments as for ``compute_psf_stack``.

    Returns:
        The stack; ``provenance["sampling"]`` holds the measured sampling error, which sees twice as many diffraction orders
        as the stack follows; ``provenance["errors"]`` the others.

    Raises:
        InputError: when the sampling error is above 5 % (or ``accept_error``), or the mask and camera do not fit.
    """
    plain = replace(camera, mask_to_sensor_m=number(camera.mask_to_sensor_m))  # it may be a tensor with a gradient
    sampling = prove_sampling(mask, plain, psf_config)
    stack = compute_psf_stack(mask, camera, psf_config, xp=xp, threads=threads, progress=progress)
    errors = quick_errors(mask, plain, psf_config)
    return replace(stack, provenance=stack.provenance | {"sampling": sampling, "errors": errors})


def quick_errors(mask: Mask, camera: CameraGeometry, psf_config: PsfConfig) -> dict[str, Any]:
    """Return what a stack records of its errors beside the sampling error; JSON-serialisable.

    ``spectrum``: see ``spectral_error``; ``model``: the nearest and the farthest depth at the middle wavelength against
    ``exact``, on a crop, absent where the model is ``exact``.
    """
    errors: dict[str, Any] = {"check": "quick", "spectrum": spectral_error(mask, camera, psf_config)}
    if psf_config.model != "exact":
        ends = replace(psf_config, depths_m=tuple(dict.fromkeys((psf_config.depths_m[0], psf_config.depths_m[-1]))))
        wavelengths_m = three_wavelengths(camera, psf_config)
        errors["model"] = pixel_error(mask, camera, ends, [wavelengths_m[len(wavelengths_m) // 2]], crop_m=CROP_M)
    return errors


def full_errors(
    mask: Mask,
    camera: CameraGeometry,
    psf_config: PsfConfig,
    corner: tuple[float, float] | None = None,
    *,
    threads: int = 1,
    progress: dict[str, Progress] | None = None,
) -> dict[str, Any]:
    """Return the full error budget; JSON-serialisable.

    Three depths and three wavelengths each: ``model`` (against ``exact`` by pixel, the whole mask) and ``direct_sum``
    (against the Rayleigh-Sommerfeld sum at random points; a crop of the mask where there is no LLVM, and absent where
    light crosses layers, since the sum knows air only); ``field_angle`` up to the ``corner`` of the scene's field (tangents
    x, y); ``spectrum``. ``progress`` holds functions called with (done, total), by the name of the part.
    """
    told = progress or {}
    some = replace(psf_config, depths_m=three_depths(psf_config.depths_m))
    wavelengths_m = three_wavelengths(camera, psf_config)
    errors: dict[str, Any] = {"check": "full", "spectrum": spectral_error(mask, camera, psf_config)}
    if psf_config.model != "exact":
        errors["model"] = pixel_error(mask, camera, some, wavelengths_m, threads=threads, progress=told.get("model"))
    if not camera.gap and not camera.window:
        part = mask if llvm_works() else judged_crop(mask, PLAIN_CROP_M)
        errors["direct_sum"] = direct_error(part, camera, some, wavelengths_m, progress=told.get("direct_sum"))
        errors["direct_sum"]["crop_m"] = max(part.shape) * part.pitch_m
    errors["field_angle"] = field_angle_error(
        mask, camera, psf_config, wavelengths_m[len(wavelengths_m) // 2], corner, progress=told.get("field_angle")
    )
    return errors
