"""What the default camera costs: the PhlatCam's design, its PSF stack, a quick look, and the peak memory.

The camera: a PhlatCam of 7.01 mm and 3505 x 3505 pixels of 2 um, 1.9 mm before a sensor of 19.2 um pixels. The stack:
25 depths from 3.6 to 20 cm, three wavelengths for each of three channels. The quick look: five depths, one wavelength
per channel. The sampling proof is part of both. CPU seconds are those of all threads; wall time needs an idle machine.

Run: uv run --group bench python benchmarks/stack.py [--quick] [--threads N]
"""

from __future__ import annotations

import argparse
import os
import resource
import sys
import time
import warnings
from collections.abc import Callable
from typing import TypeVar

from common import versions

from psf_library.designs.phlatcam import phlatcam
from simulator.optics.psf import PsfConfig, compute_psf_stack
from simulator.optics.psf_stack import depth_planes
from simulator.optics.spectrum import spectral_response
from simulator.types import CameraGeometry

T = TypeVar("T")


def timed(name: str, run: Callable[[], T]) -> T:
    """Run and print wall and CPU seconds."""
    wall, cpu = time.perf_counter(), time.process_time()
    result = run()
    print(f"  {name:34} wall {time.perf_counter() - wall:6.1f} s   CPU {time.process_time() - cpu:6.1f} s", flush=True)
    return result


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="the design and the quick look only")
    parser.add_argument("--threads", type=int, default=2, help="depths computed at a time")
    args = parser.parse_args()
    print(f"{versions('numpy', 'scipy')}: {args.threads} of {os.cpu_count()} cores for the PSFs, all for the design")
    camera = CameraGeometry(1.9e-3, 19.2e-6, spectral_response())
    mask = timed("design, 20 iterations", phlatcam)
    runs = {
        "quick look, 5 depths x 3 wavelengths": PsfConfig(tuple(depth_planes(0.036, 0.2, 5)), wavelengths_per_channel=1)
    }
    if not args.quick:
        runs["stack, 25 depths x 9 wavelengths"] = PsfConfig(tuple(depth_planes(0.036, 0.2, 25)))
    for name, config in runs.items():
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the sampling error is printed
            stack = timed(name, lambda c=config: compute_psf_stack(mask, camera, c, threads=args.threads))
        shape, error = " x ".join(map(str, stack.values.shape)), stack.provenance["sampling"]["error"]
        print(f"    {shape} values, sampling error {error:.4f}")
    unit = 1 if sys.platform == "darwin" else 1024  # bytes on macOS, kilobytes on Linux
    print(f"  peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e9:.2f} GB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
