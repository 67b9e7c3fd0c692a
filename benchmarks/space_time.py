"""The forward model over time against convolving frame by frame with padded FFTs: CPU time, largest difference, memory.

A dual rolling shutter on a sensor of 320 x 384, three channels, PSFs of 225 x 225, float32: 60 and 140 frames of flat scenes
of 160 x 160 and of the sensor's own size, and 20 frames of 12 depth planes with every pixel on one surface. The contenders
keep the PSFs' spectra between calls, as ours does; each takes one frame and plane at a time unless it says batched:

- complex, padded to twice the sensor: the form of published code for rolling-shutter lensless video (untrained networks,
  Monakhova et al., Opt. Express 29, 20913, 2021);
- complex, tight: the same with the shortest fast length that holds the linear convolution;
- batched rfft2: all frames of float32 at once, tight lengths.

The truth is the tight one in complex128. Last, the peak of memory that our forward_clip takes for more and more frames.

Run: uv run --group bench python benchmarks/space_time.py [--quick]
"""

from __future__ import annotations

import argparse
import sys
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from common import measure, rows, show, single_threaded, versions
from scipy.fft import next_fast_len

from simulator.camera.forward import ForwardModel
from simulator.camera.planes import split_planes
from simulator.camera.shutter import DualRollingShutter
from simulator.optics.stack import PsfStack, depth_planes
from simulator.types import Clip

SENSOR, PSF = (320, 384), (225, 225)
SMALL = (160, 160)  # the scene of the thesis
FRAME_S = 5e-4
OURS = "flatlight"


@dataclass
class Plain:
    """Convolution in torch, a frame and a plane at a time or all frames at once."""

    spectra: torch.Tensor  # (K, C, rows, columns)
    lengths: tuple[int, int]

    def complex_frames(self, volume: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
        """Sum over frames and planes, each transformed and back on its own."""
        total = torch.zeros((3, *SENSOR), dtype=volume.dtype)
        for frame, weight in zip(volume, weights, strict=True):
            for plane, spectrum in zip(frame, self.spectra, strict=True):
                padded = torch.zeros((3, *self.lengths), dtype=spectrum.dtype)
                padded[:, : plane.shape[1], : plane.shape[2]] = plane
                image = torch.fft.ifft2(torch.fft.fft2(padded) * spectrum).real
                total += weight[:, None] * crop(image, volume.shape[-2:])
        return total

    def real_batch(self, volume: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
        """All frames at once; the sum over planes is taken in the Fourier domain."""
        spectrum = sum(
            torch.fft.rfft2(volume[:, k], s=self.lengths) * self.spectra[k] for k in range(len(self.spectra))
        )
        images = crop(torch.fft.irfft2(spectrum, s=self.lengths), volume.shape[-2:])
        return (weights[:, None, :, None] * images).sum(0)


def prepared(psfs: np.ndarray, lengths: tuple[int, int], dtype: torch.dtype, real: bool = False) -> Plain:
    """Transform the PSFs once."""
    transform = torch.fft.rfft2 if real else torch.fft.fft2
    return Plain(transform(torch.from_numpy(psfs).to(dtype), s=lengths), lengths)


def crop(full: torch.Tensor, scene_shape: tuple[int, ...]) -> torch.Tensor:
    """Cut the sensor out of a full convolution that begins at sample 0, or put it into the middle of a larger sensor."""
    out = full.new_zeros((*full.shape[:-2], *SENSOR))
    target, source = [...], [...]
    for psf, scene, sensor in zip(PSF, scene_shape, SENSOR, strict=True):
        first = (sensor - scene) // 2 - psf // 2
        begin, end = max(first, 0), min(first + psf + scene - 1, sensor)
        target.append(slice(begin, end))
        source.append(slice(begin - first, end - first))
    out[tuple(target)] = full[tuple(source)]
    return out


def psf_stack(planes: int, rng: np.random.Generator) -> PsfStack:
    """Sharp random PSFs under a smooth envelope; their content does not change the cost."""
    y, x = np.ogrid[-1 : 1 : PSF[0] * 1j, -1 : 1 : PSF[1] * 1j]
    values = rng.exponential(size=(planes, 3, *PSF)) * np.exp(-((x**2 + y**2) ** 3))
    values /= values.sum((-2, -1), keepdims=True)
    return PsfStack(values.astype(np.float32), depth_planes(0.036, 0.2, planes), 1.0, ("R", "G", "B"), "benchmark")


def shutter(frames: int) -> DualRollingShutter:
    """Open for a fifth of the clip, pairs of rows spread over the rest of it."""
    clip_s = frames * FRAME_S
    return DualRollingShutter(0.2 * clip_s, 0.8 * clip_s / (SENSOR[0] // 2))


def clip(frames: int, scene_shape: tuple[int, int], rng: np.random.Generator) -> Clip:
    shape = (frames, *scene_shape)
    depth = (1 / rng.uniform(1 / 0.2, 1 / 0.036, shape)).astype(np.float32)
    light = rng.uniform(size=(*shape, 3)).astype(np.float32)
    return Clip(light, depth, np.ones(shape, bool), np.arange(frames + 1) * FRAME_S)


def compare(frames: int, planes: int, scene: tuple[int, int], rounds: int, rng: np.random.Generator) -> None:
    stack, film = psf_stack(planes, rng), clip(frames, scene, rng)
    model = ForwardModel(stack, SENSOR, scene, shutter(frames))
    volume = np.stack(
        [
            split_planes(np.moveaxis(rgb, -1, 0), z, stack.depths_m)
            for rgb, z in zip(film.rgb, film.depth_m, strict=True)
        ]
    )
    weights = model.row_weights(frames, film.frame_edges_s)
    torch_stack = PsfStack(torch.from_numpy(stack.values), stack.depths_m, 1.0, stack.channels, "benchmark")
    torch_model = ForwardModel(torch_stack, SENSOR, scene, shutter(frames))
    tensor, row_weights = torch.from_numpy(volume), torch.from_numpy(weights.astype(np.float32))
    tight = (next_fast_len(PSF[0] + scene[0] - 1), next_fast_len(PSF[1] + scene[1] - 1))
    double = prepared(stack.values, (2 * SENSOR[0], 2 * SENSOR[1]), torch.float32)
    short = prepared(stack.values, tight, torch.float32)
    batched = prepared(stack.values, tight, torch.float32, real=True)
    contenders: dict[str, Callable[[], Any]] = {
        OURS: lambda: model.forward(volume, film.frame_edges_s),
        f"{OURS} (torch)": lambda: torch_model.forward(tensor, film.frame_edges_s).numpy(),
        "complex, twice the sensor": lambda: double.complex_frames(tensor, row_weights).numpy(),
        "complex, tight": lambda: short.complex_frames(tensor, row_weights).numpy(),
        "batched rfft2": lambda: batched.real_batch(tensor, row_weights).numpy(),
    }
    exact = prepared(stack.values, tight, torch.float64)
    truth = exact.complex_frames(tensor.double(), torch.from_numpy(weights)).numpy()
    errors = {name: float(np.abs(run() - truth).max() / truth.max()) for name, run in contenders.items()}
    title = f"{frames} frames of {scene[0]} x {scene[1]}, {planes} plane{'s' if planes > 1 else ''}"
    show(title, rows(measure(contenders, rounds), errors, OURS), OURS, "max error")


def memory(counts: tuple[int, ...], rng: np.random.Generator) -> None:
    print("\npeak memory of forward_clip beside clip and model, 12 planes")
    stack = psf_stack(12, rng)
    for frames in counts:
        model, film = ForwardModel(stack, SENSOR, SMALL, shutter(frames)), clip(frames, SMALL, rng)
        tracemalloc.start()
        model.forward_clip(film)
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        volume = frames * 12 * 3 * SMALL[0] * SMALL[1] * 4
        print(
            f"  {frames:4d} frames  {peak / 2**20:6.1f} MiB  (its volume of planes would be {volume / 2**20:.0f} MiB)"
        )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a tenth of the frames, one round")
    parser.add_argument("--rounds", type=int, default=3, help="counted rounds per table")
    args = parser.parse_args()
    single_threaded()
    print(versions("numpy", "scipy", "torch") + ", one thread")
    rng = np.random.default_rng(1)
    share, rounds = (10, 1) if args.quick else (1, args.rounds)
    for frames, planes, scene in ((60, 1, SMALL), (140, 1, SMALL), (60, 1, SENSOR), (140, 1, SENSOR), (20, 12, SMALL)):
        compare(frames // share, planes, scene, rounds, rng)
    memory(tuple(frames // share for frames in (20, 60, 140, 280)), rng)
    return 0


if __name__ == "__main__":
    sys.exit(main())
