"""What whole PSF stacks cost: the default camera's PhlatCam, scaled and exact, with their sampling proof.

The camera: a PhlatCam of 7.01 mm and 3505 x 3505 pixels of 2 um, 1.9 mm before a sensor of 19.2 um pixels; depths from 3.6
to 20 cm. For each stack: wall and CPU seconds (all threads), the share of CPU time inside FFTs, and the time that the
arrays' way through memory alone would take, at the bandwidth of a plain copy measured in the same run. Wall time needs an
idle machine. ``psf.py`` runs this too.

Run: uv run --group bench python benchmarks/stack.py [--quick] [--full] [--threads N]
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import scipy.fft
from common import versions

from psf_library.designs.phlatcam import phlatcam
from simulator.optics.error_budget.budget import proven_psf_stack
from simulator.optics.exact import plan
from simulator.optics.mask import Mask
from simulator.optics.psf import PsfConfig
from simulator.optics.scaled import ScaledModel
from simulator.optics.sources import Source
from simulator.optics.spectra import quantile_lines, spectral_response
from simulator.optics.stack import PsfStack, depth_planes
from simulator.types import CameraGeometry

NEAR_M, FAR_M = 0.036, 0.2
CAMERA = CameraGeometry(1.9e-3, 19.2e-6, spectral_response())
TRANSFORMS = ("fft", "ifft", "fft2", "dct")


@contextmanager
def clock_of_ffts() -> Iterator[list[float]]:
    """Add up the CPU seconds that all threads spend inside SciPy's transforms."""
    spent, lock = [0.0], threading.Lock()
    plain = {name: getattr(scipy.fft, name) for name in TRANSFORMS}

    def timed(transform: Callable[..., Any]) -> Callable[..., Any]:
        def run(*arguments: Any, **options: Any) -> Any:
            begin = time.thread_time()
            result = transform(*arguments, **options)
            with lock:
                spent[0] += time.thread_time() - begin
            return result

        return run

    for name, transform in plain.items():
        setattr(scipy.fft, name, timed(transform))
    try:
        yield spent
    finally:
        for name, transform in plain.items():
            setattr(scipy.fft, name, transform)


def copy_bandwidth() -> float:
    """Bytes per second, read and written together, of a plain copy of an array far larger than the cache."""
    source = np.ones(2**26, np.float32)
    target = np.empty_like(source)
    best = np.inf
    for _ in range(5):
        begin = time.perf_counter()
        np.copyto(target, source)
        best = min(best, time.perf_counter() - begin)
    return 2 * source.nbytes / best


def bytes_moved(mask: Mask, config: PsfConfig) -> float:
    """The least that a stack's complex64 grids must move: each sweep over one reads it once and writes it once.

    Exact: rows written, columns read and written, rows read. Scaled: spectrum read, wave written and read.
    """
    total = 0.0
    for line in quantile_lines(CAMERA.response, config.wavelengths_per_channel):
        sources = [Source(line.wavelength_m, depth) for depth in config.depths_m]
        if config.model == "exact":
            total += sum(4 * 8 * plan(mask, CAMERA, 1, source).grid(mask, 1).samples ** 2 for source in sources)
        else:
            rows, columns = ScaledModel(mask, CAMERA, line.wavelength_m, 1).wave(sources[0]).shape
            total += 3 * 8 * rows * columns * len(sources)
    return total


def measure(name: str, mask: Mask, config: PsfConfig, threads: int, bandwidth: float) -> PsfStack:
    """Compute a stack and print what it cost."""
    with warnings.catch_warnings(), clock_of_ffts() as ffts:
        warnings.simplefilter("ignore")  # the sampling error is printed
        wall, cpu = time.perf_counter(), time.process_time()
        stack = proven_psf_stack(mask, CAMERA, config, threads=threads)
        wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    limit = bytes_moved(mask, config) / bandwidth
    print(
        f"  {name:52} wall {wall:6.1f} s   CPU {cpu:7.1f} s   FFT {ffts[0] / cpu:4.0%}   memory limit {limit:5.1f} s "
        f"(x {wall / limit:.1f})\n"
        f"    {' x '.join(map(str, stack.values.shape))} values, sampling error "
        f"{stack.provenance['sampling']['error']:.4f}",
        flush=True,
    )
    return stack


def run(threads: int, *, quick: bool = False, full: bool = False) -> None:
    """Measure the design and the stacks, and print the peak memory."""
    print(f"{versions('numpy', 'scipy')}: {threads} of {os.cpu_count()} cores for the PSFs, all for the design")
    bandwidth = copy_bandwidth()
    print(f"  a plain copy moves {bandwidth / 1e9:.1f} GB/s")
    wall, cpu = time.perf_counter(), time.process_time()
    mask = phlatcam()
    print(f"  design, 20 iterations: wall {time.perf_counter() - wall:.1f} s   CPU {time.process_time() - cpu:.1f} s")
    few, many = (tuple(map(float, depth_planes(NEAR_M, FAR_M, count))) for count in (5, 25))
    stacks = {"scaled_distance, 5 depths x 3 wavelengths": PsfConfig(few, wavelengths_per_channel=1)}
    if not quick:
        stacks["scaled_distance, 25 depths x 9 wavelengths (default)"] = PsfConfig(many)
        stacks["scaled_distance, 25 depths x 15 wavelengths"] = PsfConfig(many, wavelengths_per_channel=5)
        stacks["exact, 5 depths x 3 wavelengths"] = PsfConfig(few, "exact", wavelengths_per_channel=1)
    if full:
        stacks["exact, 25 depths x 15 wavelengths"] = PsfConfig(many, "exact", wavelengths_per_channel=5)
    for name, config in stacks.items():
        measure(name, mask, config, threads, bandwidth)
        unit = 1 if sys.platform == "darwin" else 1024  # bytes on macOS, kilobytes on Linux
        print(f"    peak memory so far {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**30:.2f} GiB")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="the design and the smallest stack only")
    parser.add_argument("--full", action="store_true", help="the exact stack of 25 depths x 15 wavelengths too")
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    run(args.threads, quick=args.quick, full=args.full)
    return 0


if __name__ == "__main__":
    sys.exit(main())
