"""Mask design: our phase retrieval against LenslessPiCam's, in CPU seconds and in what the masks cast.

Both run Gerchberg-Saxton between mask and sensor towards the same contours (2 um, 532 nm, 1869 um). The judge is neither
of them: the share of each mask's light that its phase, propagated by the angular spectrum in float64, puts into the lines,
and the correlation with the target. The peer's published algorithm is written down here on waveprop's Fresnel convolution,
where it spends its time; with ``--lensless PYTHON`` (an interpreter that has lensless 1.0.8) the package itself runs too.

Run: uv run --group bench python benchmarks/design.py [--quick] [--rounds N] [--lensless PYTHON]
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from common import single_threaded, versions
from peers import phase_contour_retrieval

from psf_library.designs.phlatcam import phlatcam
from simulator.design.patterns import contours
from simulator.design.phase_retrieval import retrieve_phase
from simulator.optics.propagation import angular_spectrum

PITCH_M, WAVELENGTH_M, DISTANCE_M = 2e-6, 532e-9, 1869e-6
ITERATIONS = 20


def judge(phase: np.ndarray, target: np.ndarray) -> tuple[float, float]:
    """Share of the mask's light inside the target's lines, and correlation of the intensity with the target."""
    field = angular_spectrum(np.exp(1j * np.asarray(phase, np.float64)), PITCH_M, WAVELENGTH_M, DISTANCE_M)
    intensity = np.abs(field) ** 2
    share = intensity[target > 0].sum() / target.size
    return float(share), float(np.corrcoef(intensity.ravel(), target.ravel())[0, 1])


def timed(run: Callable[[], Any]) -> tuple[float, Any]:
    """CPU seconds of one run, and what it returned."""
    start = time.process_time()
    result = run()
    return time.process_time() - start, result


def lensless_itself(python: str, samples: int) -> dict[str, float]:
    """CPU seconds of the peer's own code, on one thread in its own environment."""
    script = Path(__file__).with_name("lensless_phase_contour.py")
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    command = [python, str(script), str(samples), str(ITERATIONS)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return json.loads(done.stdout.strip().splitlines()[-1])


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="256 x 256 instead of 1024 x 1024")
    parser.add_argument("--rounds", type=int, default=1, help="rounds; each runs everybody once")
    parser.add_argument("--lensless", metavar="PYTHON", help="interpreter of an environment with lensless 1.0.8")
    args = parser.parse_args()
    single_threaded()
    samples = 256 if args.quick else 1024
    print(versions("numpy", "scipy", "waveprop") + f", one thread; {samples} x {samples}, {ITERATIONS} iterations")
    target = contours(samples, 120, 6, seed=1)
    optics = (PITCH_M, WAVELENGTH_M, DISTANCE_M)
    retrievals = {
        "flatlight": lambda image, passes: retrieve_phase(image, *optics, passes).phase,
        "LenslessPiCam's algorithm": lambda image, passes: phase_contour_retrieval(image, *optics, passes),
    }
    for retrieve in retrievals.values():
        retrieve(target[:64, :64], 1)  # imports are not timed
    design = partial(phlatcam, width_mm=samples * PITCH_M * 1e3, iterations=ITERATIONS, tolerance=0)
    seconds: dict[str, list[float]] = {}
    for _ in range(args.rounds):
        found = {name: timed(partial(retrieve, target, ITERATIONS)) for name, retrieve in retrievals.items()}
        found["flatlight, whole design"] = timed(design)
        for name, (spent, phase) in found.items():
            seconds.setdefault(name, []).append(spent)
            if name in retrievals and len(seconds[name]) == 1:
                share, likeness = judge(phase, target)
                print(f"  {name:26} {100 * share:5.1f} % of the light in the lines, correlation {likeness:.3f}")
        if args.lensless:
            own = lensless_itself(args.lensless, samples)
            seconds.setdefault("lensless 1.0.8, retrieval", []).append(own["retrieval_s"])
            seconds.setdefault("lensless 1.0.8, whole design", []).append(own["whole_s"])
    print(f"\n  {'':30} {'CPU s':>8} {'x flatlight':>12}")
    for name, spent in seconds.items():
        reference = seconds["flatlight, whole design" if "whole" in name else "flatlight"]
        ratio = statistics.median(a / b for a, b in zip(spent, reference, strict=True))
        print(f"  {name:30} {statistics.median(spent):8.2f} {ratio:12.1f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
