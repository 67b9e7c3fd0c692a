"""The mask designs keep what they promise: geometry, statistics, and the PSF that they were made for."""

import warnings

import numpy as np
import pytest
from scipy.ndimage import distance_transform_edt

from psf_library.designs.diffusercam import diffusercam
from psf_library.designs.phlatcam import contours, phlatcam
from psf_library.designs.pinhole import disc, pinhole
from simulator.optics.mask import Mask
from simulator.optics.materials import FUSED_SILICA, PHLATCAM_RESIST
from simulator.optics.noise import gaussian_surface, perlin
from simulator.optics.psf import PsfConfig, compute_psf_stack
from simulator.types import CameraGeometry, SpectralResponse

GREEN = SpectralResponse(np.array([531e-9, 532e-9, 533e-9]), np.array([[0.0, 1.0, 0.0]]), ("Y",), "one line")


# --- PhlatCam


@pytest.fixture(scope="module")
def small() -> Mask:
    return phlatcam(width_mm=0.8, iterations=8)


def test_phlatcam_heights_are_fabricable_steps(small):
    """Multiples of 0.2 um from 0 to the floor of one wave (532 nm / 0.5103 = 1.04 um), all of them used."""
    steps = np.asarray(small.height_m, float) / 0.2e-6
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-5)
    assert set(np.rint(steps).astype(int).ravel()) == {0, 1, 2, 3, 4, 5}
    assert small.profile == "staircase"
    assert small.material is PHLATCAM_RESIST
    assert np.all(small.amplitude == 1)


def test_phlatcam_has_the_size_that_was_asked_for(small):
    assert small.shape == (400, 400)
    assert small.pitch_m == 2e-6
    coarse = phlatcam(width_mm=0.9, pixel_um=3.0, iterations=1)
    assert (coarse.shape, coarse.pitch_m) == ((300, 300), 3e-6)


def test_phlatcam_is_the_same_every_time(small):
    again, other = phlatcam(width_mm=0.8, iterations=8), phlatcam(width_mm=0.8, iterations=8, seed=2)
    assert again.digest() == small.digest()
    assert other.digest() != small.digest()
    assert phlatcam(width_mm=0.3, iterations=1, seed=0).digest() != phlatcam(width_mm=0.3, iterations=1).digest()


def test_phlatcam_without_steps_is_continuous():
    mask = phlatcam(width_mm=0.3, iterations=1, step_um=0)
    assert len(np.unique(mask.height_m)) > 1000
    assert 0 <= mask.height_m.min() < mask.height_m.max() < 532e-9 / 0.5103


def test_the_steps_are_rounded_down():
    stepped, free = (phlatcam(width_mm=0.3, iterations=1, step_um=step) for step in (0.2, 0))
    loss = np.asarray(free.height_m, float) - stepped.height_m
    assert loss.min() > -1e-12
    assert loss.max() < 0.2e-6


def _stored_psf(mask, distance_m, pitch_m=4e-6):
    """The PSF at infinity turned back into the mask's frame, cut to the mask's size."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        config = PsfConfig((np.inf,), wavelengths_per_channel=1, accept_error=10.0)
        stack = compute_psf_stack(mask, CameraGeometry(distance_m, pitch_m, GREEN), config)
    psf = np.asarray(stack.values[0, 0])[::-1, ::-1]
    middle, half = len(psf) // 2, round(mask.shape[0] * mask.pitch_m / pitch_m / 2)
    return psf[middle - half : middle + half + 1, middle - half : middle + half + 1]


def _pixels_of(target):
    """The target on sensor pixels of 2 x 2 samples, centred on sample boundaries like the PSF's grid, by plain means."""
    padded = np.pad(target, 1)
    return padded.reshape(len(padded) // 2, 2, len(padded) // 2, 2).mean((1, 3))


def test_phlatcam_casts_its_contours_at_its_distance(small):
    """Through the whole chain, quantised heights and frames included; turned or elsewhere the likeness is gone."""
    target = _pixels_of(contours(400, 120, 6, 1))
    psf = _stored_psf(small, 1869e-6)
    assert psf.shape == target.shape

    def likeness(image):
        return np.corrcoef(image.ravel(), target.ravel())[0, 1]

    assert likeness(psf) > 0.9  # measured 0.94; shifted by one 4 um pixel 0.79 to 0.84
    for shift, axis in ((1, 0), (-1, 0), (1, 1), (-1, 1)):
        assert likeness(np.roll(psf, shift, axis)) < likeness(psf) - 0.05
    for other in (psf[::-1], psf[:, ::-1], psf[::-1, ::-1], psf.T):
        assert likeness(other) < 0.2
    assert likeness(_stored_psf(small, 900e-6)) < 0.5


def test_the_contours_are_lines_of_the_asked_width():
    """The largest inscribed radius along a line 6 to 7 samples wide is 3 to 4; junctions are a little wider."""
    target = contours(600, 120, 6, 1)
    assert set(np.unique(target)) == {0.0, 1.0}
    assert 0.05 < target.mean() < 0.35
    depth = distance_transform_edt(target)
    ridge = depth[depth >= 3]
    assert 3 <= np.median(ridge) <= 4


def test_a_mask_smaller_than_a_cell_is_still_a_camera():
    assert phlatcam(width_mm=0.06, iterations=1).transmitted_area_m2 == pytest.approx(3.6e-9)


def test_perlin_noise_is_smooth_and_of_its_cell():
    noise = perlin((300, 300), 60, 1)
    assert (noise.min(), noise.max(), noise.dtype) == (0, 1, np.float32)
    assert np.abs(np.diff(noise, axis=0)).max() < 0.1  # one sample of sixty
    assert not np.array_equal(noise, perlin((300, 300), 60, 2))
    # Every lattice point is a zero of gradient noise: they all share one value, others do not.
    lattice = noise[60::60, 60::60]
    assert np.ptp(lattice) < 1e-5
    assert np.ptp(noise[30::60, 30::60]) > 0.2


# --- DiffuserCam


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


def test_gaussian_surfaces_are_normalised():
    surface = gaussian_surface((200, 300), 10, 0)
    assert surface.mean() == pytest.approx(0, abs=1e-5)
    assert surface.std() == pytest.approx(1, abs=1e-5)


# --- pinhole


@pytest.mark.parametrize(("diameter_um", "pixel_um"), [(40.0, 0.5), (30.0, 0.7), (100.0, 2.0), (25.3, 0.5)])
def test_the_pinholes_area_is_that_of_its_circle(diameter_um, pixel_um):
    """Each rim pixel counts by the part inside."""
    mask = pinhole(diameter_um=diameter_um, pixel_um=pixel_um)
    area = float(np.sum(np.asarray(mask.amplitude, float))) * mask.pitch_m**2
    assert area == pytest.approx(np.pi / 4 * (diameter_um * 1e-6) ** 2, rel=1e-3)


def test_the_pinhole_is_round_and_centred():
    amplitude = disc(30.4)
    assert amplitude.shape == (33, 33)
    for other in (amplitude[::-1], amplitude[:, ::-1], amplitude.T):
        np.testing.assert_array_equal(amplitude, other)
    assert np.all(amplitude[0] == 0)  # the grid holds it whole
    assert amplitude[16, 16] == 1
    away = np.hypot(*np.mgrid[-16:17, -16:17])
    assert np.all(amplitude[away < 15.2 - 0.71] == 1)
    assert np.all(amplitude[away > 15.2 + 0.71] == 0)
