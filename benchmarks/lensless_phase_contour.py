# /// script
# requires-python = ">=3.9,<3.12"
# dependencies = ["lensless==1.0.8", "waveprop==0.0.12", "perlin-numpy", "sympy", "tqdm", "torch"]
# ///
"""LenslessPiCam's own PhaseContour mask, timed in its own environment; prints one line of JSON.

The package pins NumPy 1.26 and is under the AGPL, so it runs apart from ours: ``design.py --lensless PYTHON`` starts this
file with the interpreter of an environment that has it. Run: python benchmarks/lensless_phase_contour.py 1024 20
"""

from __future__ import annotations

import json
import sys
import time

from lensless.hardware.mask import PhaseContour, phase_retrieval


def main() -> None:
    samples, iterations = map(int, sys.argv[1:])
    optics = {"wv": 532e-9, "d1": 2e-6, "dz": 1869e-6, "n": 1.5103}
    start = time.process_time()
    mask = PhaseContour(
        noise_period=(16, 16),
        refractive_index=optics["n"],
        n_iter=iterations,
        resolution=(samples, samples),
        feature_size=(optics["d1"], optics["d1"]),
        distance_sensor=optics["dz"],
    )
    whole = time.process_time() - start
    start = time.process_time()
    phase_retrieval(mask.target_psf, n_iter=iterations, **optics)
    print(json.dumps({"whole_s": whole, "retrieval_s": time.process_time() - start}))


if __name__ == "__main__":
    main()
