"""Our free-space propagation against torchoptics, waveprop and prysm, side by side; then whole stacks (``stack.py``).

The field is a random smooth phase (400 cosine modes up to 20 cycles/mm, 4.2 rad rms) under a smooth aperture
exp(-(r / 0.36 mm)^12), 532 nm, propagated over 1.9 mm. The truth is the direct Rayleigh-Sommerfeld sum on the fine
grid.

Run: uv run --group bench python benchmarks/psf.py [--quick] [--full] [--oracle FOLDER]
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import stack
from common import measure, relative_error, rows, show, single_threaded, versions
from peers import PEERS, Propagate

from simulator.optics.propagation import angular_spectrum
from simulator.optics.rayleigh_sommerfeld import rayleigh_sommerfeld

WAVELENGTH_M = 532e-9
DISTANCE_M = 1.9e-3
APERTURE_M = 0.36e-3
COARSE = (512, 2e-6)
FINE = (1536, 2e-6 / 3)
OURS = "flatlight"


@dataclass(frozen=True)
class Modes:
    """A height map as a sum of cosines, times the phase per metre of height."""

    fx: np.ndarray
    fy: np.ndarray
    phase: np.ndarray
    amplitude_rad: np.ndarray

    @classmethod
    def random(cls, seed: int = 1) -> Modes:
        """Our own random modes, with the statistics of the oracle's."""
        rng = np.random.default_rng(seed)
        radius, angle = 20e3 * np.sqrt(rng.uniform(size=400)), rng.uniform(0, 2 * np.pi, 400)
        amplitude = np.full(400, 4.2 * np.sqrt(2 / 400))
        return cls(radius * np.cos(angle), radius * np.sin(angle), rng.uniform(0, 2 * np.pi, 400), amplitude)

    @classmethod
    def of_oracle(cls, oracle: np.lib.npyio.NpzFile) -> Modes:
        """The modes of the independently computed reference."""
        per_metre = 2 * np.pi * float(oracle["delta_n"]) / WAVELENGTH_M
        return cls(oracle["mode_fx"], oracle["mode_fy"], oracle["mode_phase"], oracle["mode_amp"] * per_metre)

    def field(self, samples: int, pitch_m: float) -> np.ndarray:
        """The field behind the mask on a centred grid, complex128 ``(samples, samples)``."""
        x = (np.arange(samples) - (samples - 1) / 2) * pitch_m
        # cos(a x + b y + c) = Re[e^{i a x} e^{i (b y + c)}]: one matrix product instead of 400 maps.
        across = np.exp(2j * np.pi * np.outer(self.fx, x))
        down = self.amplitude_rad[:, None] * np.exp(1j * (2 * np.pi * np.outer(self.fy, x) + self.phase[:, None]))
        phase = (down.T @ across).real
        radius = np.hypot(x[None, :], x[:, None])
        return np.exp(-((radius / APERTURE_M) ** 12)) * np.exp(1j * phase)


def truth(args: argparse.Namespace) -> tuple[Modes, np.ndarray, np.ndarray, np.ndarray]:
    """Modes, rows and columns of points on the coarse grid, and the true intensity there."""
    if args.oracle is not None:
        with np.load(args.oracle / "e2_smooth_aperture_truth.npz", allow_pickle=False) as oracle:
            plane_wave = int(np.flatnonzero(np.isinf(oracle["depths"]))[0])
            modes, intensity = Modes.of_oracle(oracle), oracle["intensity"][plane_wave]
            return modes, oracle["index_row"], oracle["index_col"], intensity
    modes = Modes.random()
    rng = np.random.default_rng(2)
    row, column = rng.integers(96, 416, (2, 10 if args.quick else 60))
    points = (np.stack([column, row], -1) - (COARSE[0] - 1) / 2) * COARSE[1]
    field = rayleigh_sommerfeld(modes.field(*FINE), FINE[1], WAVELENGTH_M, DISTANCE_M, points)
    return modes, row, column, np.abs(field) ** 2


def ours_numpy(pitch_m: float) -> Propagate:
    return lambda field: np.abs(angular_spectrum(field, pitch_m, WAVELENGTH_M, DISTANCE_M)) ** 2


def ours_torch(pitch_m: float) -> Propagate:
    import torch

    def run(field: np.ndarray) -> np.ndarray:
        there = angular_spectrum(torch.from_numpy(field), pitch_m, WAVELENGTH_M, DISTANCE_M)
        return (there.abs() ** 2).numpy()

    return run


def contenders(samples: int, pitch_m: float) -> tuple[dict[str, Propagate], list[str]]:
    """Everybody who can be imported, and a line about everybody who cannot."""
    factories = {
        OURS: lambda: ours_numpy(pitch_m),
        f"{OURS} (torch)": lambda: ours_torch(pitch_m),
        **{name: lambda f=f: f(pitch_m, WAVELENGTH_M, DISTANCE_M, (samples, samples)) for name, f in PEERS.items()},
    }
    found, missing = {}, []
    for name, factory in factories.items():
        try:
            found[name] = factory()
        except ImportError as error:
            missing.append(f"{name}: not measured, {error}")
    return found, missing


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="coarse grid and few points only")
    parser.add_argument("--oracle", type=Path, help="folder with e2_smooth_aperture_truth.npz instead of our own sum")
    parser.add_argument(
        "--full", action="store_true", help="the exact stack of 25 depths x 15 wavelengths too (minutes)"
    )
    parser.add_argument("--rounds", type=int, default=5, help="counted rounds per table")
    args = parser.parse_args()
    single_threaded()
    print(versions("numpy", "scipy", "torch", "torchoptics", "waveprop", "prysm") + ", one thread")
    modes, row, column, intensity = truth(args)
    print(f"truth: Rayleigh-Sommerfeld at {len(intensity)} points, {'the oracle' if args.oracle else 'our direct sum'}")
    for samples, pitch_m in (COARSE,) if args.quick else (COARSE, FINE):
        fine = samples // COARSE[0]
        found, missing = contenders(samples, pitch_m)
        for dtype in (np.complex128, np.complex64):
            field = modes.field(samples, pitch_m).astype(dtype)
            at_points = np.s_[fine * row + fine // 2, fine * column + fine // 2]
            errors = {name: relative_error(run(field)[at_points], intensity) for name, run in found.items()}
            seconds = measure({name: partial(run, field) for name, run in found.items()}, args.rounds)
            title = f"{samples} x {samples} samples of {pitch_m * 1e6:.3f} um, {np.dtype(dtype)}"
            show(title, rows(seconds, errors, OURS), OURS, "error")
        print(*missing, sep="\n")
    if not args.quick:
        print("\nWhole stacks of the default camera")
        stack.run(threads=2, full=args.full)
    return 0


if __name__ == "__main__":
    sys.exit(main())
