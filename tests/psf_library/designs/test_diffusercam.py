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


def test_another_material_bends_light_alike():
    """A surface of lower index is steeper by the ratio of n - 1."""
    silica, resist = (diffusercam(width_mm=0.4, material=name) for name in ("fused-silica", "phlatcam-resist"))
    ratio = (silica.material.index(532e-9) - 1) / (resist.material.index(532e-9) - 1)
    np.testing.assert_allclose(resist.height_m, silica.height_m * ratio, rtol=1e-5, atol=1e-12)
    assert resist.material.name == "phlatcam-resist"


def test_its_light_gathers_in_caustics_at_the_focal_length_of_its_hills(psf_at_infinity):
    """Contrast (std / mean) inside the mask's shadow: weak close by, strongest about correlation / (sqrt(6) slope)."""
    mask = diffusercam(width_mm=1.0, correlation_um=60, slope_degrees=1.0)
    focal_m = 60e-6 / (np.sqrt(6) * np.tan(np.radians(1.0)))

    def contrast(distance_m):
        psf = psf_at_infinity(mask, distance_m, 4e-6)
        middle = len(psf) // 2
        inner = psf[middle - 90 : middle + 90, middle - 90 : middle + 90]
        return inner.std() / inner.mean()

    close, focus = contrast(0.1 * focal_m), contrast(focal_m)
    assert close < 0.3  # geometric optics: distance x std of the Laplacian, 0.1 x sqrt(8 / 3)
    assert focus > 1
    assert close == pytest.approx(0.1 * np.sqrt(8 / 3), rel=0.3)


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
