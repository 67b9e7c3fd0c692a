"""Pinned PSFs of every shipped mask design, and the comparison that a test suite needs to pin its own.

``load("phlatcam")`` returns a small stack that every release must reproduce; ``compare_stacks`` says where two stacks
differ and by how much, ``draw_difference`` shows it. ``python -m psf_library.reference.make`` makes the stacks again.
"""

from psf_library.reference.cases import CASES, Case, build_mask, compute, load, load_pinned_mask
from psf_library.reference.difference import StackDifference, compare_stacks, draw_difference

__all__ = [
    "CASES",
    "Case",
    "StackDifference",
    "build_mask",
    "compare_stacks",
    "compute",
    "draw_difference",
    "load",
    "load_pinned_mask",
]
