"""Refocuses one measurement of a data set: Wiener-filtered with the PSFs of four depths, other things are sharp in each.

Called with the folder of a data set and the number of a training sample, it writes scene, depth, PSF and measurement
(``capture.png``) and the four images (``refocus.png``).
"""

import sys

import numpy as np
from PIL import Image

from psf_library import load_psf_stack
from simulator.colour import linear_to_srgb
from simulator.dataset import open_dataset
from simulator.plots.drawing import depth_colours

HEIGHT, GAP, NOISE_TO_SIGNAL = 256, 8, 3e-4


def wiener(measurement: np.ndarray, psf: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return the image ``(h, w)`` that a Wiener filter finds in one channel of a measurement.

    Half the sensor's size is added on every side, fading to black: no light wraps around, no border rings.
    """
    border = tuple(size // 2 for size in measurement.shape)
    image = np.pad(measurement, [(size, size) for size in border], mode="linear_ramp")
    kernel = np.zeros(image.shape)
    kernel[: psf.shape[0], : psf.shape[1]] = psf
    kernel = np.fft.rfft2(np.roll(kernel, (-(psf.shape[0] // 2), -(psf.shape[1] // 2)), (0, 1)))
    power = np.abs(kernel) ** 2
    filtered = np.fft.rfft2(image) * kernel.conj() / (power + NOISE_TO_SIGNAL * power.max())
    found = np.fft.irfft2(filtered, image.shape)
    top, left = ((have - want) // 2 for have, want in zip(found.shape, shape, strict=True))
    return found[top : top + shape[0], left : left + shape[1]]


def encode(linear: np.ndarray) -> np.ndarray:
    """Return linear light, its 99th percentile as white, as 8-bit sRGB."""
    scaled = np.clip(linear / np.percentile(linear, 99), 0, 1).astype(np.float32)
    return (linear_to_srgb(scaled) * 255).round().astype(np.uint8)


def save(pictures: list[np.ndarray], name: str) -> None:
    """Save images side by side."""
    tiles = [
        Image.fromarray(p).resize((round(p.shape[1] * HEIGHT / p.shape[0]), HEIGHT), Image.Resampling.LANCZOS)
        for p in pictures
    ]
    sheet = Image.new("RGB", (sum(t.width + GAP for t in tiles) - GAP, HEIGHT), "white")
    left = 0
    for tile in tiles:
        sheet.paste(tile, (left, 0))
        left += tile.width + GAP
    sheet.save(name, optimize=True)


folder, index = sys.argv[1], int(sys.argv[2])
stack, sample = load_psf_stack(folder), open_dataset(folder, "train")[index]
planes = np.linspace(1, len(stack.depths_m) - 5, 4).astype(int)
scene, depth_m, valid = sample.rgb[0], sample.depth_m[0], sample.valid[0]
depth = depth_colours(depth_m, valid, float(depth_m.min()), float(depth_m.max()))
psf = np.moveaxis(stack.values[planes[1]], 0, -1)
save([encode(scene), depth, encode(psf), encode(np.moveaxis(sample.measurement, 0, -1))], "capture.png")
focused = [
    np.stack([wiener(m, h, depth_m.shape) for m, h in zip(sample.measurement, stack.values[k], strict=True)], -1)
    for k in planes
]
save([encode(np.clip(picture, 0, None)) for picture in focused], "refocus.png")
print("depths in cm:", [round(float(stack.depths_m[k]) * 100, 1) for k in planes])
