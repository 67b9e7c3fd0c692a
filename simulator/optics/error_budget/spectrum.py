"""How much a few wavelengths per channel cost: the PSF of the configured lines against many more, on a crop of the mask."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.optics.error_budget.sampling import judged_crop
from simulator.optics.mask import Mask
from simulator.optics.psf import PsfConfig, depth_images, psf_lines, stack_size
from simulator.types import CameraGeometry, SpectralResponse

CROP_M = 0.75e-3  # wavelengths part by angle, not by place on the mask: a crop of 1.5 mm gives the same within a tenth
MANY = 40  # wavelengths that all channels share; 80 of them move the answer by less than a tenth
_TAIL = 1e-3  # photons beyond the reference's first and last wavelength, per channel


def spectral_error(mask: Mask, camera: CameraGeometry, psf_config: PsfConfig, many: int = MANY) -> dict[str, Any]:
    """Measure the relative L2 error that the configured number of wavelengths causes, at the nearest depth.

    Returns:
        ``error`` (the largest) and ``channels``, the error per channel; ``lines`` of the reference; ``better``, a number of
        shared wavelengths that errs less: as many as there are, where channels have their own; JSON-serialisable.
    """
    crop = judged_crop(mask, CROP_M)
    # The quadrature does not know the depth model, so the fast one stands for all.
    nearest = replace(psf_config, depths_m=psf_config.depths_m[:1], model="scaled_distance")
    lines = psf_lines(camera.response, psf_config)
    size = stack_size(crop, camera, nearest)

    def image(wavelength_m: float) -> NDArray[np.floating]:
        return next(iter(depth_images(crop, camera, nearest, wavelength_m, size)))

    few: list[Any] = [0.0] * len(camera.response.channels)
    shown = {wavelength_m: image(wavelength_m) for wavelength_m in {line.wavelength_m for line in lines}}
    for line in lines:
        few[line.channel] = few[line.channel] + line.weight * shown[line.wavelength_m]
    reference: list[Any] = [0.0] * len(camera.response.channels)
    wavelengths_m, weights = _known(mask, camera, *common_lines(camera.response, many))
    for wavelength_m, shares in zip(wavelengths_m, weights.T, strict=True):
        one = image(float(wavelength_m))
        reference = [total + share * one for total, share in zip(reference, shares, strict=True)]
    errors = {
        channel: float(np.linalg.norm(a - b) / np.linalg.norm(b))
        for channel, a, b in zip(camera.response.channels, few, reference, strict=True)
    }
    return {
        "error": max(errors.values()),
        "channels": errors,
        "lines": len(wavelengths_m),
        "better": len(shown) + (2 if psf_config.shared_wavelengths is not None or len(errors) == 1 else 0),
        "crop_m": max(crop.shape) * crop.pitch_m,
    }


def _known(
    mask: Mask, camera: CameraGeometry, wavelengths_m: NDArray[np.float64], weights: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Leave out wavelengths at which a material has no data: a channel's far tail need not stop the budget."""
    materials = [mask.material, *(layer.material for layer in (*camera.gap, *camera.window))]
    kept = np.ones(len(wavelengths_m), bool)
    for number, wavelength_m in enumerate(wavelengths_m):
        try:
            for material in materials:
                material.index(float(wavelength_m))
        except InputError:
            kept[number] = False
    weights = weights[:, kept]
    return wavelengths_m[kept], weights / weights.sum(1, keepdims=True)


def common_lines(response: SpectralResponse, count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return wavelengths that all channels share and each channel's weights on them: a quadrature unlike the lines'.

    Every wavelength stands for an equal interval, weighted by the photons that the channel (linear between its samples)
    holds in it, and lies at the interval's middle.

    Returns:
        ``(count,)`` wavelengths, metres, and ``(C, count)`` weights; each channel's add up to 1.

    Example:
        >>> flat = SpectralResponse(np.array([400e-9, 500e-9]), np.ones((1, 2)), ("Y",), "flat")
        >>> wavelengths_m, weights = common_lines(flat, 2)
        >>> weights.round(3).tolist()
        [[0.5, 0.5]]
    """
    at = response.wavelengths_m
    fine = np.linspace(at[0], at[-1], 200 * len(at))
    photons = np.array([np.cumsum(np.interp(fine, at, weights)) for weights in response.weights])
    photons /= photons[:, -1:]
    first = min(fine[np.searchsorted(row, _TAIL)] for row in photons)
    last = max(fine[np.searchsorted(row, 1 - _TAIL)] for row in photons)
    edges = np.linspace(first, last, count + 1)
    shares = np.array([np.diff(np.interp(edges, fine, row)) for row in photons])
    return (edges[1:] + edges[:-1]) / 2, shares / shares.sum(1, keepdims=True)
