"""What denoising gains and costs on flying_things: error against 1024 light paths per pixel, beside more light paths.

``python benchmarks/denoise.py [--scenes 4]``; needs ``flatlight[denoise]`` and, for its figures, a libLLVM.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from common import relative_error, versions

from scenes.flying_things import draw_scene
from simulator.render import Renderer, Scene, choose_backend
from simulator.render.denoise import denoiser_name
from simulator.types import View

VIEW = View((128, 128), 19.2e-6, 1.9e-3, 0.036, 0.2)
REFERENCE_SAMPLES = 1024
CONTENDERS = [(4, False), (4, True), (16, False), (16, True), (64, False), (64, True)]


def srgb_psnr_db(found: np.ndarray, truth: np.ndarray) -> float:
    """PSNR of the pictures as a display shows them: clipped to 0..1 and sRGB-encoded."""
    shown = [np.clip(picture, 0, 1).astype(np.float64) for picture in (found, truth)]
    encoded = [np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055) for x in shown]
    return float(-10 * np.log10(np.mean((encoded[0] - encoded[1]) ** 2)))


def render(variant: str, scene: Scene, samples: int, seed: int, denoise: bool = False) -> tuple[np.ndarray, float]:
    """A still and the CPU seconds that it took."""
    renderer = Renderer(variant, denoise=denoise)
    start = time.process_time()
    clip = renderer.still(scene, VIEW, samples_per_pixel=samples, seed=seed, source={})
    return clip.rgb[0], time.process_time() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=4, help="how many scenes the figures are means over")
    arguments = parser.parse_args()
    variant = choose_backend().variant
    found: dict[tuple[int, bool], list[tuple[float, float, float, float]]] = {key: [] for key in CONTENDERS}
    for number in range(-1, arguments.scenes):  # the first round compiles kernels and does not count
        scene = draw_scene(VIEW, 30, np.random.default_rng(max(number, 0)))
        truth = np.ones((*VIEW.shape, 3))
        if number >= 0:
            truth, _ = render(variant, scene, REFERENCE_SAMPLES, seed=99)
        for samples, denoised in CONTENDERS:
            picture, seconds = render(variant, scene, samples, 1, denoised)
            figures = (
                seconds,
                relative_error(picture, truth),
                srgb_psnr_db(picture, truth),
                float(picture.mean() / truth.mean()) - 1,
            )
            if number >= 0:
                found[samples, denoised].append(figures)
    print(f"{versions('mitsuba', 'drjit', 'pyoidn')}, {variant}, {denoiser_name()}")
    print(f"flying_things 128 x 128, means over {arguments.scenes} scenes, against {REFERENCE_SAMPLES} paths per pixel")
    print(f"  {'paths per pixel':22} {'CPU s':>7} {'relative L2':>12} {'sRGB PSNR':>10} {'mean light':>11}")
    for (samples, denoised), rows in found.items():
        seconds, error, psnr, bias = np.mean(rows, axis=0)
        name = f"{samples}{' + denoise' if denoised else ''}"
        print(f"  {name:22} {seconds:7.3f} {error:12.4f} {psnr:7.2f} dB {100 * bias:+9.2f} %")


if __name__ == "__main__":
    main()
