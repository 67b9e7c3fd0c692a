"""The light path: a scene, the PSFs of a mask, what reaches the sensor, and what it measures."""

from dataclasses import replace

import numpy as np
from PIL import Image

from simulator.assembly import Assembly
from simulator.colour import linear_to_srgb
from simulator.config import load_config

config = load_config("sim_config.yaml", ["psf.depths=3", "psf.shared_wavelengths=3", "camera.mask.width_mm=1.5"])
assembly = Assembly(config, backend="scalar_rgb")
stack = assembly.psf_stack  # values (K, C, H, W); its provenance holds the measured sampling error
clip = assembly.source.clip(0, np.random.default_rng(7))  # linear RGB and depth in metres
exposure = assembly.forward_model.forward_clip(clip)  # (C, H, W), physical units; clips of any length
sensor = replace(assembly.sensor, full_scale=exposure.max() / 0.8)
measurement = sensor.expose(exposure, np.random.default_rng(0))  # DN / 2^bits

pictures = []
for linear in (clip.rgb[0], np.moveaxis(stack.values[1], 0, -1), np.moveaxis(measurement, 0, -1)):
    shown = linear_to_srgb(np.clip(linear / np.percentile(linear, 99.5), 0, 1).astype(np.float32))
    image = Image.fromarray((255 * shown).round().astype(np.uint8))
    pictures.append(image.resize((300 * image.width // image.height, 300)))
sheet = Image.new("RGB", (sum(picture.width for picture in pictures) + 20, 300), "white")
for i, picture in enumerate(pictures):
    sheet.paste(picture, (sum(earlier.width + 10 for earlier in pictures[:i]), 0))
sheet.save("light_path.png")
