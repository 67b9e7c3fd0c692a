"""DiffuserCam: the statistics of its surface, and caustics at its distance."""

import numpy as np
import pytest

from psf_library.designs.diffusercam import diffusercam
from simulator.optics.materials import FUSED_SILICA


def test_diffusercam_bends_light_as_strongly_as_asked():
    """Standard deviation of (n - 1) times the slope, over 1600 correlation areas: 5 %."""
    mask = diffusercam(width_mm=2.4, correlation_um=60, slope_degrees=0.7)
    slope = np.stack(np.gradient(np.asarray(mask.height_m, float), mask.pitch_m))
    bend = (FUSED_SILICA.index(532e-9) - 1) * slope
    assert np.degrees(np.arctan(bend.std())) == pytest.approx(0.7, rel=0.05)


def test_diffusercam_has_the_asked_correlation_length():
    """Autocorrelation 1/e at the correlation length, from the circular FFT of the (periodic) surface."""
    for correlation_um in (40.0, 80.0):
        mask = diffusercam(width_mm=2.4, pixel_um=4, correlation_um=correlation_um, seed=3)
        height = np.asarray(mask.height_m, float)
        height -= height.mean()
        power = np.abs(np.fft.fft2(height)) ** 2
        shifts = np.fft.ifft2(power).real
        row = (shifts[0] + shifts[:, 0]) / 2 / shifts[0, 0]
        length_um = 4 * np.interp(-np.exp(-1), -row[:100], np.arange(100))
        assert length_um == pytest.approx(correlation_um, rel=0.1)


def test_diffusercam_is_a_smooth_glass_of_the_asked_size():
    mask = diffusercam(width_mm=0.5, pixel_um=2.5)
    assert mask.shape == (200, 200)
    assert mask.pitch_m == pytest.approx(2.5e-6)
    assert (mask.profile, mask.material) == ("smooth", FUSED_SILICA)
    assert mask.height_m.min() == 0
    assert mask.height_m.dtype == np.float32
    assert np.all(mask.amplitude == 1)
    assert diffusercam(width_mm=0.5).digest() == diffusercam(width_mm=0.5).digest()
    assert diffusercam(width_mm=0.5).digest() != diffusercam(width_mm=0.5, seed=2).digest()
