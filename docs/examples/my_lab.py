"""Writes what your laboratory would give you: pictures of a point source at six distances, and dark frames, 12 bits each."""

from pathlib import Path

import numpy as np
import tifffile

from simulator.assembly import Assembly
from simulator.camera.calibration import CalibrationSource, SourcePlaces, captured_light
from simulator.camera.noise import PhysicalNoise
from simulator.config import load_config

changes = [
    "psf={depths_cm: [3.6, 4.5, 6, 8, 12, 20], wavelengths_per_channel: 1}",
    "camera.mask={design: flatcam, order: 6}",
    "camera.sensor={model: imx183, binning: 4, shape: [330, 330]}",
    "scene.size=[32, 32]",
]
assembly, rng = Assembly(load_config("sim_config.yaml", changes)), np.random.default_rng(0)
assert assembly.mask is not None

# A source of 25 um, moved by hand along a rail that is 0.3 degrees off the axis; at 8 cm it stood 2 mm farther than stated.
places = CalibrationSource(25e-6, shift_std_m=2e-4, tilt_rad=(0.005, -0.003)).place(
    assembly.depths_m, assembly.mask_to_sensor_m, rng
)
places = SourcePlaces(places.depths_m + np.array([0, 0, 0, 2e-3, 0, 0]), places.shifts_m, places.blurs_m)
light = captured_light(assembly.mask, assembly.geometry, assembly.psf_config, places, 329)

sensor = assembly.config.camera.sensor.sensor(PhysicalNoise())
stray = np.full((3, 330, 330), 0.004)
Path("lab").mkdir()


def save(name: str, signal: np.ndarray) -> None:
    """Save two frames of a signal (shares of full scale, stored frame) as the sensor reads them: rotated by 180 degrees."""
    for frame in range(2):
        numbers = np.round(sensor.expose(stray + signal, rng) * 2**12).astype(np.uint16)
        tifffile.imwrite(f"lab/{name}_{frame}.tif", np.moveaxis(numbers, 0, -1)[::-1, ::-1], photometric="rgb")


for depth_m, psf in zip(assembly.depths_m, light, strict=True):
    # The lamp is set anew at each distance, the exposure time stays, so that names need not tell it.
    save(f"{depth_m * 100:g}cm", np.pad(psf / psf.max() * 0.7, ((0, 0), (1, 0), (1, 0))))
save("dark", np.zeros(1))
