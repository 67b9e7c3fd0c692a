"""The light of a configuration: what the camera's channels see of it, and of the scene's colours."""

from __future__ import annotations

import hashlib
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from simulator.assemble.masks import optics_code
from simulator.camera.colour import CameraColour, fit_camera_colour
from simulator.errors import InputError
from simulator.io.cache import Entry, cached
from simulator.io.files import sha256_file
from simulator.optics.spectra import NOMINAL_CAMERA, Led, curve_file, electron_rates, spectral_response
from simulator.types import SpectralResponse

if TYPE_CHECKING:
    from simulator.config import Config


def build_response(config: Config) -> SpectralResponse:
    """Return the relative photon weights of the camera's channels under the configuration's light.

    Raises:
        InputError: for an unknown illuminant or spectral response, or an unreadable file.
    """
    return spectral_response(_camera(config), _illuminant(config), config.base_dir)


def build_camera_colour(config: Config, channels: tuple[str, ...]) -> CameraColour:
    """Return how the scene's linear sRGB becomes the camera's channels; a fitted matrix is cached.

    Args:
        config: the configuration.
        channels: names of the PSF stack's channels.

    Raises:
        InputError: when the matrix does not have a row per channel, or as :func:`build_response`.
    """
    chosen = config.camera.scene_to_camera
    if chosen == "identity":
        colour = CameraColour(np.eye(3), {"from": "identity"})
    elif chosen == "auto":
        colour = _fitted(config)
    else:
        colour = CameraColour(np.array(chosen, np.float64), {"from": "configuration"})
    if len(colour.matrix) != len(channels):
        msg = (
            f"camera.scene_to_camera: {chosen if isinstance(chosen, str) else 'the matrix'} has {len(colour.matrix)} rows, "
            f"but the PSF stack has the channels {', '.join(channels)}; give a list with a row of three numbers for each"
        )
        raise InputError(msg)
    return colour


def build_electron_rates(config: Config) -> dict[str, float]:
    """Return the electrons that white gives in each channel (cached); see `simulator.optics.spectra.electron_rates`.

    Raises:
        InputError: as :func:`build_response`, or for a light that the eye does not see.
    """

    def compute() -> Entry:
        rates = electron_rates(_camera(config), _illuminant(config), config.base_dir)
        return {"rates": np.array(list(rates.values()))}, {"channels": list(rates)}

    arrays, described = cached("photometry", _key(config), compute)
    return dict(zip(described["channels"], arrays["rates"].tolist(), strict=True))


def _fitted(config: Config) -> CameraColour:
    def compute() -> Entry:
        colour = fit_camera_colour(build_response(config))
        return {"matrix": colour.matrix}, {"origin": colour.origin}

    arrays, described = cached("colour", _key(config), compute)
    return CameraColour(arrays["matrix"], described["origin"])


def _key(config: Config) -> str:
    """Return a hash of the camera and its light, without colour-science, which every worker would import for a second."""
    hashes = [sha256_file(path) for path in light_files(config)]
    named = (_camera(config), _illuminant(config), hashes, metadata.version("colour-science"), optics_code())
    return hashlib.sha256(repr(named).encode()).hexdigest()


def light_files(config: Config) -> list[Path]:
    """Return the files of the camera's curves and of the light's spectrum."""
    captured = getattr(config.psf, "as_captured", None)
    calibration = None if captured is None else captured.illuminant
    names = [name for name in (_camera(config), config.camera.illuminant, calibration) if isinstance(name, str)]
    return [file for name in names if (file := curve_file(name, config.base_dir)) is not None]


def _camera(config: Config) -> str:
    return config.camera.sensor.spectral_response or NOMINAL_CAMERA


def _illuminant(config: Config) -> str | tuple[Led, ...]:
    chosen = config.camera.illuminant
    if isinstance(chosen, str):
        return chosen
    leds = chosen if isinstance(chosen, tuple) else (chosen,)
    return tuple(Led(led.led_nm * 1e-9, led.fwhm_nm * 1e-9, led.power) for led in leds)
