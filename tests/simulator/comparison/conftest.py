"""Candidates that cost no propagation: Gaussian PSFs of known width."""

from collections.abc import Callable

import numpy as np
import pytest

from simulator.optics.stack import PsfStack
from simulator.plots.comparison import Candidate, judge

AREA_M2 = 2e-6


@pytest.fixture(scope="session")
def gaussian_candidate() -> Callable[..., Candidate]:
    """Return a function that makes a candidate whose PSF has a standard deviation per depth, in pixels of 10 um."""

    def make(name: str = "gaussian", sigmas: tuple[float, ...] = (3.0, 4.0), camera: str = "a camera") -> Candidate:
        at = np.arange(81) - 40
        planes = [np.exp(-(at[:, None] ** 2 + at[None, :] ** 2) / (2 * sigma**2)) for sigma in sigmas]
        values = np.stack([plane / plane.sum() * AREA_M2 / 1e-10 for plane in planes])[:, None].repeat(3, 1)
        provenance = {
            "mask": {"name": name, "transmitted_area_m2": AREA_M2, "shape": [100, 100], "pitch_m": 2e-6},
            "sampling": {"error": 0.0123},
            "errors": {"spectrum": {"channels": {"R": 0.12, "G": 0.34, "B": 0.23}, "lines": 9}},
        }
        depths = np.linspace(0.04, 0.2, len(sigmas))
        stack = PsfStack(values, depths, 1e-5, ("R", "G", "B"), "test", provenance)
        off_sensor = np.tile(np.linspace(0.25, 0.5, len(sigmas))[:, None], (1, 3))
        return judge(name, stack, camera, [("model", "a <drawn> Gaussian")], off_sensor)

    return make
