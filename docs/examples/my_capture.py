"""Writes what your camera would give you: the image of a point source, and a capture, both as read from the sensor."""

import numpy as np
import tifffile
from PIL import Image

from simulator.assembly import Assembly
from simulator.config import load_config

changes = [
    "psf={depths_cm: [20]}",
    "camera.mask={design: diffusercam, width_mm: 3}",
    "camera.mask_to_sensor_mm=10",
    "scene.near_cm=19",
    "scene.far_cm=22",
    "scene.margin=0",
]
assembly = Assembly(load_config("sim_config.yaml", changes), backend="scalar_rgb")
exposure = assembly.forward_model.forward_clip(assembly.source.clip(3, np.random.default_rng(3)))
capture = np.random.default_rng(0).normal(exposure / exposure.max() * 3200, 4)
psf = assembly.psf_stack.values[0]


def save(name: str, channels: np.ndarray) -> None:
    """Save a 12 bit image, dark level 100, in the sensor's own frame: the stored one rotated by 180 degrees."""
    numbers = np.moveaxis(np.clip(channels + 100, 0, 4095).round().astype(np.uint16), 0, -1)
    tifffile.imwrite(name, numbers[::-1, ::-1])


save("psf.tif", psf / psf.max() * 3900)
save("capture.tif", capture)
shown = np.moveaxis(capture[:, ::-1, ::-1] / capture.max(), 0, -1)
Image.fromarray((255 * np.clip(shown, 0, 1) ** 0.45).astype(np.uint8)).save("capture.png")
