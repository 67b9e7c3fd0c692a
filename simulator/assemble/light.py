"""The light of a configuration: what the camera's channels see of it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from simulator.optics.curves import Led, curve_file
from simulator.optics.spectrum import NOMINAL_CAMERA, spectral_response
from simulator.types import SpectralResponse

if TYPE_CHECKING:
    from simulator.config import Config


def build_response(config: Config) -> SpectralResponse:
    """Return the relative photon weights of the camera's channels under the configuration's light.

    Raises:
        InputError: for an unknown illuminant or spectral response, or an unreadable file.
    """
    return spectral_response(_camera(config), _illuminant(config), config.base_dir)


def light_files(config: Config) -> list[Path]:
    """Return the files of the camera's curves and of the light's spectrum."""
    names = [name for name in (_camera(config), config.camera.illuminant) if isinstance(name, str)]
    return [file for name in names if (file := curve_file(name, config.base_dir)) is not None]


def _camera(config: Config) -> str:
    return config.camera.sensor.spectral_response or NOMINAL_CAMERA


def _illuminant(config: Config) -> str | tuple[Led, ...]:
    chosen = config.camera.illuminant
    if isinstance(chosen, str):
        return chosen
    leds = chosen if isinstance(chosen, tuple) else (chosen,)
    return tuple(Led(led.led_nm * 1e-9, led.fwhm_nm * 1e-9, led.power) for led in leds)
