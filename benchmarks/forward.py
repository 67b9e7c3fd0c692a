"""Our 3D forward model against convolving plane by plane with padded complex FFTs: CPU time and largest difference.

The default camera: 25 planes, 3 channels, scene 128 x 128, PSFs of 391 x 391, sensor 456 x 684, float32. The plain
versions take the same PSF spectra as given, pad to the shortest fast length that holds the full convolution, and invert
each plane on its own; one more calls scipy.signal.fftconvolve. The truth is the plain version in float64.

Run: uv run --group bench python benchmarks/forward.py [--quick]
"""

from __future__ import annotations

import argparse
import sys
from functools import partial
from typing import Any

import numpy as np
import scipy.fft
import scipy.signal
from common import measure, rows, show, single_threaded, versions

from simulator.camera.forward import ForwardModel
from simulator.camera.planes import split_planes
from simulator.optics.stack import PsfStack, depth_planes

SCENE = (128, 128)
PSF = (391, 391)
SENSOR = (456, 684)
OURS = "flatlight"


def place(full: Any) -> Any:
    """Cut the full convolution ``(C, h + H - 1, w + W - 1)`` down or pad it up to the sensor, by NumPy or torch."""
    out = full.new_zeros((3, *SENSOR)) if hasattr(full, "new_zeros") else np.zeros((3, *SENSOR), full.dtype)
    target, source = [slice(None)], [slice(None)]
    for psf, scene, sensor in zip(PSF, SCENE, SENSOR, strict=True):
        first = (sensor - scene) // 2 - psf // 2  # the sensor pixel of the full convolution's first sample
        begin, end = max(first, 0), min(first + psf + scene - 1, sensor)
        target.append(slice(begin, end))
        source.append(slice(begin - first, end - first))
    out[tuple(target)] = full[tuple(source)]
    return out


def lengths() -> tuple[int, int]:
    rows, columns = (scipy.fft.next_fast_len(psf + scene - 1) for psf, scene in zip(PSF, SCENE, strict=True))
    return rows, columns


def plain_numpy(spectra: np.ndarray, volume: np.ndarray) -> np.ndarray:
    total = np.zeros((3, *SENSOR), volume.dtype)
    for spectrum, plane in zip(spectra, volume, strict=True):
        padded = np.zeros((3, *lengths()), spectrum.dtype)
        padded[:, : SCENE[0], : SCENE[1]] = plane
        total += place(scipy.fft.ifft2(scipy.fft.fft2(padded) * spectrum).real)
    return total


def plain_torch(spectra: Any, volume: Any) -> np.ndarray:
    import torch

    total = torch.zeros((3, *SENSOR), dtype=volume.dtype)
    for spectrum, plane in zip(spectra, volume, strict=True):
        padded = torch.zeros((3, *lengths()), dtype=spectrum.dtype)
        padded[:, : SCENE[0], : SCENE[1]] = plane
        total += place(torch.fft.ifft2(torch.fft.fft2(padded) * spectrum).real)
    return total.numpy()


def scipy_signal(psfs: np.ndarray, volume: np.ndarray) -> np.ndarray:
    total = np.zeros((3, *SENSOR), volume.dtype)
    for psf, plane in zip(psfs, volume, strict=True):
        total += place(scipy.signal.fftconvolve(plane, psf, axes=(-2, -1)))
    return total


def psf_stack(planes: int, rng: np.random.Generator) -> PsfStack:
    """Sharp random PSFs under a smooth envelope; their content does not change the cost."""
    y, x = np.ogrid[-1 : 1 : PSF[0] * 1j, -1 : 1 : PSF[1] * 1j]
    values = rng.exponential(size=(planes, 3, *PSF)) * np.exp(-((x**2 + y**2) ** 3))
    values /= values.sum((-2, -1), keepdims=True)
    return PsfStack(values.astype(np.float32), depth_planes(0.036, 0.2, planes), 1.0, ("R", "G", "B"), "benchmark")


def volumes(stack: PsfStack, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Light on every plane and pixel, and a scene of surfaces shared linearly between two planes."""
    light = rng.uniform(size=(3, *SCENE)).astype(np.float32)
    ramp = 1 / np.linspace(1 / stack.depths_m[0], 1 / stack.depths_m[-1], SCENE[0])[:, None] * np.ones(SCENE)
    surfaces = split_planes(light, ramp.astype(np.float32), stack.depths_m)
    return {"light on every plane": np.broadcast_to(light, surfaces.shape).copy(), "one surface per pixel": surfaces}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="5 planes instead of 25, two rounds")
    parser.add_argument("--rounds", type=int, default=5, help="counted rounds per table")
    args = parser.parse_args()
    planes, rounds = (5, 2) if args.quick else (25, args.rounds)
    single_threaded()
    print(versions("numpy", "scipy", "torch") + ", one thread")
    rng = np.random.default_rng(1)
    stack = psf_stack(planes, rng)
    model = ForwardModel(stack, SENSOR, SCENE)
    spectra = scipy.fft.fft2(stack.values, lengths())
    for name, volume in volumes(stack, rng).items():
        contenders = {
            OURS: lambda v=volume: model.forward(v[None]),
            "plain complex64, scipy.fft": partial(plain_numpy, spectra, volume),
            "scipy.signal.fftconvolve": partial(scipy_signal, stack.values, volume),
        }
        try:
            import torch
        except ImportError as error:
            print(f"torch: not measured, {error}")
        else:
            tensor = torch.from_numpy(volume)
            torch_stack = PsfStack(torch.from_numpy(stack.values), stack.depths_m, 1.0, stack.channels, "benchmark")
            torch_model = ForwardModel(torch_stack, SENSOR, SCENE)
            contenders[f"{OURS} (torch)"] = lambda t=tensor, m=torch_model: m.forward(t[None]).numpy()
            contenders["plain complex64, torch.fft"] = partial(plain_torch, torch.from_numpy(spectra), tensor)
        exact = plain_numpy(scipy.fft.fft2(stack.values.astype(np.float64), lengths()), volume.astype(np.float64))
        errors = {name: np.abs(run() - exact).max() / exact.max() for name, run in contenders.items()}
        table = rows(measure(contenders, rounds), errors, OURS)
        show(f"{planes} planes, {name}", table, OURS, "max error")
    return 0


if __name__ == "__main__":
    sys.exit(main())
