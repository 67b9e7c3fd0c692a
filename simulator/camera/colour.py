"""Scene colours as the camera's channels see them: a 3x3 matrix on linear light, fitted to curves and light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.tables import NM
from simulator.types import SpectralResponse

# 24 real surfaces, measured; the one set that nearly all colour calibration uses.
PATCHES = "ISO 17321-1"


@dataclass(frozen=True)
class CameraColour:
    """How linear sRGB becomes the camera's channels.

    Attributes:
        matrix: ``(C, 3)``; every row of a fitted one adds up to 1, so that a white surface is 1 in all channels.
        origin: where it comes from, JSON-serialisable; a fitted one with its error on the patches that it was fitted to.
    """

    matrix: NDArray[np.float64]
    origin: dict[str, object]


def fit_camera_colour(response: SpectralResponse) -> CameraColour:
    """Fit the matrix that takes linear sRGB to camera channels, for surfaces under the response's light.

    A surface of reflectance r has the sRGB that the standard observer sees under D65, and the camera's channel records
    sum w_c(l) r(l) / sum w_c(l), w_c being the photon weights: white is 1 in both. Of the matrices that keep white, it is
    the one with the least squared error over the 24 patches of the ColorChecker. Source: Finlayson and Drew, "Constrained
    least-squares regression in color spaces", J. Electron. Imaging 6, 484 (1997).

    Args:
        response: photon weights of the camera's channels under the light.
    """
    reflectances = _patch_reflectances(response.wavelengths_m)
    shares = response.weights / response.weights.sum(1, keepdims=True)
    seen, scene = reflectances @ shares.T, _patch_srgb()
    # A row (a, b, 1 - a - b) keeps white: what is left to fit are a and b, on differences to blue.
    red_green, blue = scene[:, :2] - scene[:, 2:], scene[:, 2:]
    free = np.linalg.lstsq(red_green, seen - blue, rcond=None)[0].T
    matrix = np.column_stack([free, 1 - free.sum(1)])
    error = np.sqrt(np.mean((scene @ matrix.T - seen) ** 2, axis=0) / np.mean(seen**2, axis=0))
    return CameraColour(
        matrix, {"from": f"fit to {PATCHES}", "response": response.label, "relative_rms_error": error.round(6).tolist()}
    )


def linear_srgb(reflectances: NDArray[np.float64], wavelengths_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return linear sRGB of surfaces under D65, 1 for perfect white; colours outside sRGB's gamut have negative parts.

    Args:
        reflectances: ``(S, N)``.
        wavelengths_m: ``(N,)`` metres; beyond their ends a reflectance stays as it was there.

    Returns:
        ``(S, 3)``.
    """
    from colour import MSDS_CMFS, RGB_COLOURSPACES, SDS_ILLUMINANTS, SpectralShape

    observer = MSDS_CMFS["CIE 1931 2 Degree Standard Observer"]
    shape = SpectralShape(380, 780, 1)
    at_m = np.asarray(shape.wavelengths) * NM
    weights = observer.copy().align(shape).values.T * SDS_ILLUMINANTS["D65"].copy().align(shape).values
    to_srgb = np.linalg.inv(RGB_COLOURSPACES["sRGB"].matrix_RGB_to_XYZ)
    surfaces = np.array([np.interp(at_m, wavelengths_m, surface) for surface in reflectances])
    white = to_srgb @ weights.sum(1)  # equal in R, G and B but for the rounding of sRGB's white point
    return (surfaces @ weights.T) @ to_srgb.T / white


def _patches() -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    from colour import SDS_COLOURCHECKERS

    spectra = list(SDS_COLOURCHECKERS[PATCHES].values())
    return np.asarray(spectra[0].wavelengths) * NM, np.array([spectrum.values for spectrum in spectra])


def _patch_reflectances(wavelengths_m: NDArray[np.float64]) -> NDArray[np.float64]:
    at_m, surfaces = _patches()
    return np.array([np.interp(wavelengths_m, at_m, surface) for surface in surfaces])


def _patch_srgb() -> NDArray[np.float64]:
    at_m, surfaces = _patches()
    return linear_srgb(surfaces, at_m)


def to_camera(rgb: NDArray[np.float32], matrix: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return the camera's channels of a linear RGB image; negative results become 0, since no channel sees less than dark.

    Args:
        rgb: ``(H, W, 3)`` linear light.
        matrix: ``(C, 3)``.

    Returns:
        ``(C, H, W)`` float32.

    Example:
        >>> to_camera(np.float32([[[1, 0, 0], [1, 1, 1]]]), np.array([[0.5, 0.25, 0.25], [-0.5, 1, 0.5]])).tolist()
        [[[0.5, 1.0]], [[0.0, 1.0]]]
    """
    return np.maximum(_mixed(rgb, matrix), 0)


def clipped_share(rgb: NDArray[np.float32], matrix: NDArray[np.floating]) -> float:
    """Return the share of the channels' values that :func:`to_camera` raises to 0.

    Args:
        rgb: ``(H, W, 3)``.
        matrix: ``(C, 3)``.
    """
    return float(np.mean(_mixed(rgb, matrix) < 0))


def _mixed(rgb: NDArray[np.float32], matrix: NDArray[np.floating]) -> NDArray[np.float32]:
    if matrix.ndim != 2 or matrix.shape[1] != 3:
        raise InputError("scene_to_camera", f"got shape {matrix.shape}, expected (C, 3): a row per camera channel")
    rows = matrix.astype(np.float32)[:, :, None, None]
    # Term by term, so that the bytes do not depend on how a library orders a product.
    return np.asarray(rows[:, 0] * rgb[..., 0] + rows[:, 1] * rgb[..., 1] + rows[:, 2] * rgb[..., 2], np.float32)
