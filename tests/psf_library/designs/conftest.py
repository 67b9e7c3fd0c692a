"""What the tests of mask designs share: one spectral line, and the PSF of infinity in the mask's own frame."""

from collections.abc import Callable

import numpy as np
import pytest

from simulator.optics.mask import Mask
from simulator.optics.psf import PsfConfig, compute_psf_stack
from simulator.types import CameraGeometry, SpectralResponse


@pytest.fixture(scope="session")
def psf_at_infinity() -> Callable[..., np.ndarray]:
    """Return a function from mask, distance, sensor pixel and wavelength to the PSF, turned back into the mask's frame."""

    def compute(mask: Mask, distance_m: float, pitch_m: float, wavelength_m: float = 532e-9) -> np.ndarray:
        response = SpectralResponse(
            wavelength_m + np.array([-1e-9, 0.0, 1e-9]), np.array([[0.0, 1.0, 0.0]]), ("Y",), "one line"
        )
        config = PsfConfig((np.inf,), wavelengths_per_channel=1)
        stack = compute_psf_stack(mask, CameraGeometry(distance_m, pitch_m, response), config)
        return np.asarray(stack.values[0, 0])[::-1, ::-1]

    return compute
