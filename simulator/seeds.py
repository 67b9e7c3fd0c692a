"""Random streams: one generator per (data set, split, sample, purpose), no global state.

Source: NumPy's SeedSequence; independent streams by ``spawn_key``.
"""

from __future__ import annotations

import numpy as np

# Fixed for ever: these integers are part of what a seed means.
SPLITS = {"train": 0, "validation": 1, "test": 2, "pilot": 3}
PURPOSES = {"scene": 0, "noise": 1, "calibration": 2}


def generator(seed: int, split: str, index: int, purpose: str) -> np.random.Generator:
    """Return the generator of one purpose of one sample.

    Args:
        seed: the data set's root seed; 0 is a seed like any other.
        split: ``train``, ``validation``, ``test`` or ``pilot``.
        index: the sample's number within its split.
        purpose: ``scene``, ``noise`` or ``calibration`` (of the camera, drawn from the split ``pilot``).

    Example:
        >>> generator(7, "train", 0, "scene").integers(1000, size=3)
        array([172, 635, 692])
    """
    key = (SPLITS[split], index, PURPOSES[purpose])
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))
