"""Calibrations as a laboratory makes them: frames of a simulated camera as files, with the truth beside them."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import tifffile

from psf_library import load_mask
from simulator.camera.calibration import CalibrationSource, SourcePlaces, captured_light
from simulator.camera.noise import PhysicalNoise
from simulator.camera.sensor import Sensor
from simulator.optics.psf import PsfConfig, compute_psf_stack
from simulator.types import CameraGeometry, SpectralResponse

# Design, its parameters, mask to sensor, pixel pitch, distances. A random phase mask's mean power errs by what its few
# hills have: smaller ones than these have focal lengths that pass for 2 % of the distance.
CAMERAS = {
    "phlatcam": ({"width_mm": 2.0}, 1.9e-3, 9.6e-6, (0.036, 0.045, 0.06, 0.08, 0.12, 0.2)),
    "diffusercam": ({}, 8.9e-3, 13e-6, (0.08, 0.1, 0.13, 0.18, 0.3, 0.6)),
    "flatcam": ({"order": 6}, 2e-3, 9.6e-6, (0.036, 0.045, 0.06, 0.08, 0.12, 0.2)),
}


@dataclass(frozen=True)
class Truth:
    """What a simulated calibration hides: light ``(K, 1, N, N)``, where sources were, and the camera."""

    light: np.ndarray
    places: SourcePlaces
    distance_m: float
    pitch_m: float
    depths_m: tuple[float, ...]


@pytest.fixture(scope="session")
def truth() -> Callable[[str], Truth]:
    """Return a function: a camera's name to a set whose source was moved by hand, 0.3 mm about a rail 0.3 degrees off."""
    known: dict[str, Truth] = {}

    def of(name: str) -> Truth:
        if name not in known:
            parameters, d, pitch, depths = CAMERAS[name]
            mask = load_mask(name, **parameters)
            response = SpectralResponse(np.array([531e-9, 532e-9, 533e-9]), np.array([[0.0, 1, 0]]), ("G",), "532 nm")
            camera, config = CameraGeometry(d, pitch, response), PsfConfig(depths, wavelengths_per_channel=1)
            size = compute_psf_stack(mask, camera, config).values.shape[-1]
            source = CalibrationSource(25e-6, 0.0, 5e-5, 3e-4, (np.radians(0.3), np.radians(-0.2)))
            places = source.place(depths, d, np.random.default_rng(3))
            known[name] = Truth(captured_light(mask, camera, config, places, size), places, d, pitch, depths)
        return known[name]

    return of


def record(folder: Path, light: np.ndarray, names: list[str], brightness: list[float], frames=2, dark="dark") -> Path:
    """Write frames of 12 bits in 16, in the physical frame, each plane's peak at a share of full scale, and dark frames."""
    rng, size = np.random.default_rng(1), light.shape[-1]
    electrons = {
        "full_well_e": 15000,
        "read_noise_e": 2.7,
        "row_noise_e": 0.3,
        "dark_current_e_per_s": 0.1,
        "prnu": 0.006,
    }
    numbers = {"black_level_dn": 64.0, "bit_depth": 12, "noise": PhysicalNoise()}
    sensor = Sensor("imx183", 2.4e-6, (size, size), 1, (size, size), **electrons, **numbers)
    stray = np.broadcast_to(0.005 + 0.003 * np.exp(-np.arange(size) / (0.25 * size)), (1, size, size))
    folder.mkdir()

    def write(name: str, signal: np.ndarray) -> None:
        numbers = np.round(sensor.expose(signal, rng) * 2**12).astype(np.uint16)
        tifffile.imwrite(folder / f"{name}.tif", numbers[0])

    for number in range(frames):
        write(f"{dark}_{number}", stray)
        for plane, name, peak in zip(light, names, brightness, strict=True):
            write(f"{name}_{number}", plane[:, ::-1, ::-1] * (peak / plane.max()) + stray)
    return folder


@pytest.fixture(scope="session")
def recorded() -> Callable[..., Path]:
    """The function `record`."""
    return record
