"""Make the pinned references: ``python -m psf_library.reference.make [DESIGN ...]``.

Those that the code still reproduces are left as they are; ``pytest --regen-psf`` does the same from the test suite.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from psf_library.reference.cases import CASES, PINNED, build_mask, compute, load, load_pinned_mask, write
from psf_library.reference.difference import compare_stacks
from simulator.errors import InputError
from simulator.optics.mask import Mask

PSF_TOLERANCE = 2e-6
"""Relative L2 difference that counts as unchanged: exp, sin and BLAS round differently on other CPUs. From AVX-512 down to
SSE4 the references move by up to 2.2e-7; other releases of the FFT may round a few times worse."""

HEIGHT_TOLERANCE_M, AMPLITUDE_TOLERANCE = 1e-9, 1e-4
"""A mask sample that differs by less is the same: a nanometre turns green light's phase by 0.006 rad."""

CHANGED_SAMPLES = 1e-3
"""Share of a mask's samples that may differ all the same: retrieval feeds rounding errors back, so that heights at the
edge of a quantisation step fall to its other side. A relative noise of 1e-5 flips 1 of 40 000 PhlatCam pixels in 20
iterations and 10 in 50; from AVX-512 down to SSE4 none flips."""


@dataclass(frozen=True)
class Change:
    """What became of a reference: whether new files were written, and a note of which one and by how much it changed."""

    rewritten: bool
    note: str


def changed_samples(found: Mask, pinned: Mask) -> float:
    """Return the share of a mask's samples that differ; 1 when pitch or size do."""
    if found.shape != pinned.shape or found.pitch_m != pinned.pitch_m:
        return 1.0
    height = np.abs(found.height_m - pinned.height_m) > HEIGHT_TOLERANCE_M
    amplitude = np.abs(found.amplitude - pinned.amplitude) > AMPLITUDE_TOLERANCE
    return float(np.mean(height | amplitude))


def remake(name: str, folder: Path = PINNED) -> Change:
    """Compute a reference again, and write it into the folder where it is missing or no longer reproduced.

    Raises:
        InputError: for a name without a case.
        StorageError: the place cannot be written to.
    """
    mask = build_mask(name)
    try:
        pinned = load_pinned_mask(name, folder)
        samples = changed_samples(mask, pinned)
        if samples <= CHANGED_SAMPLES:
            mask = pinned
        difference = compare_stacks(compute(name, mask), load(name, folder))
        if samples <= CHANGED_SAMPLES and difference.error <= PSF_TOLERANCE:
            return Change(False, f"{name}: unchanged (relative L2 {difference.error:.2g})")
        note = f"{name}: {samples:.2%} of the mask's samples changed, PSF relative L2 {difference.error:.3g}"
    except InputError as error:
        note = f"{name}: new, because {error}"
    write(name, mask, compute(name, mask), folder)
    return Change(True, note)


def main(names: list[str]) -> None:
    """Remake the references of these designs, or of all, and say what changed."""
    for name in names or CASES:
        change = remake(name)
        print(f"{'wrote' if change.rewritten else 'kept '}  {change.note}")


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except InputError as error:
        sys.exit(f"error: {error}")
