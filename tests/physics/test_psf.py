"""PSF stacks against direct sums, energy balance, geometry and the pinhole camera."""

from dataclasses import replace

import numpy as np
import pytest

from simulator.camera.field import FieldOfView
from simulator.camera.forward import ForwardModel
from simulator.errors import InputError
from simulator.optics.error_budget.sampling import prove_sampling, sampling_error
from simulator.optics.kernel import ORDERS
from simulator.optics.mask import Mask, steepest_frequency
from simulator.optics.materials import FUSED_SILICA
from simulator.optics.psf import PsfConfig, compute_psf_stack, depth_images, plain_psf, sampled_intensity
from simulator.optics.rayleigh_sommerfeld import rayleigh_sommerfeld
from simulator.optics.spectra import shared_lines
from simulator.types import CameraGeometry, Clip, SpectralResponse, View

GREEN = SpectralResponse(np.array([531e-9, 532e-9, 533e-9]), np.array([[0.0, 1.0, 0.0]]), ("Y",), "one line")


def _smooth_mask(samples=160, pitch_m=1e-6, seed=0, dtype=np.float64) -> Mask:
    """Random cosines under a smooth round aperture; not symmetric in any way."""
    rng = np.random.default_rng(seed)
    x = (np.arange(samples) - (samples - 1) / 2) * pitch_m
    y, x = x[:, None], x[None, :]
    height = np.zeros((samples, samples))
    for fy, fx, a, p in zip(*rng.uniform(-1, 1, (4, 8)), strict=True):
        height += 0.25e-6 * a * np.cos(2 * np.pi * 2.5e4 * (fy * y + fx * x) + 3 * p)
    aperture = np.exp(-((np.hypot(y, x) / (0.4 * samples * pitch_m)) ** 12))
    return Mask(height.astype(dtype), aperture.astype(dtype), pitch_m, FUSED_SILICA, "smooth")


def _staircase_mask(samples=150, seed=0) -> Mask:
    height = np.random.default_rng(seed).integers(0, 6, (samples, samples)) * 0.2e-6
    return Mask(height, np.ones_like(height), 2e-6, FUSED_SILICA, "staircase")


def _direct_intensity(mask, wavelength_m, d, depth_m, points_m, oversample=1):
    """|RS sum|^2 under spherical illumination at points x, y of the physical sensor."""
    field = mask.transmission(wavelength_m, oversample)
    fine = mask.pitch_m / oversample
    y, x = ((np.arange(n) - (n - 1) / 2) * fine for n in field.shape)
    if np.isfinite(depth_m):
        r = np.sqrt(x[None, :] ** 2 + y[:, None] ** 2 + depth_m**2)
        field = field * depth_m / r * np.exp(2j * np.pi / wavelength_m * (r - depth_m))
    return np.abs(rayleigh_sommerfeld(field, fine, wavelength_m, d, points_m)) ** 2


def _direct_pixel_values(mask, wavelength_m, d, depth_m, pitch_m, pixels, oversample, nodes=7):
    """Integrate the direct sum over pixels given by (row, column) in the physical frame."""
    nodes, weights = np.polynomial.legendre.leggauss(nodes)
    values = []
    for row, column in pixels:
        px, py = np.meshgrid((column + nodes / 2) * pitch_m, (row + nodes / 2) * pitch_m)
        points = np.stack([px.ravel(), py.ravel()], 1)
        intensity = _direct_intensity(mask, wavelength_m, d, depth_m, points, oversample)
        values.append(np.sum(np.outer(weights, weights).ravel() / 4 * intensity))
    return np.array(values)


@pytest.mark.parametrize("depth_m", [0.01, 0.05, np.inf])
def test_psf_of_a_smooth_mask_equals_the_direct_sum(depth_m):
    """Pixel by pixel, in absolute units, frame included.

    The identity is paraxial in the source's angle: (a / z)^2 (80 um at 1 cm: 6e-5) and in phase k a^4 / (8 z^3) < 1e-3.
    What is left at infinity is the pixel rule: cells of 1 um share their intensity with 6 um pixels, 0.2 %.
    """
    mask, d, pitch = _smooth_mask(), 0.5e-3, 6e-6
    stack = compute_psf_stack(
        mask, CameraGeometry(d, pitch, GREEN), PsfConfig((depth_m,), wavelengths_per_channel=1, oversampling=2)
    )
    middle = stack.values.shape[-1] // 2
    pixels = np.random.default_rng(1).integers(-11, 12, (14, 2))
    truth = _direct_pixel_values(mask, 532e-9, d, depth_m, pitch, pixels, 1)
    stored = stack.values[0, 0][middle - pixels[:, 0], middle - pixels[:, 1]]  # turned by 180 degrees
    assert np.linalg.norm(stored - truth) / np.linalg.norm(truth) < 3e-3


@pytest.mark.parametrize("depth_m", [2e-3, np.inf])
def test_sampled_points_of_a_smooth_mask_equal_the_direct_sum(depth_m):
    """In absolute units at a magnification of 1.25; paraxial in the source's angle: (a / z)^2 = 2e-3."""
    mask, d = _smooth_mask(), 0.5e-3
    config, rng = PsfConfig((depth_m,), wavelengths_per_channel=1), np.random.default_rng(1)
    points, found = sampled_intensity(mask, CameraGeometry(d, 6e-6, GREEN), config, 532e-9, depth_m, 12, rng)
    truth = _direct_intensity(mask, 532e-9, d, depth_m, points)
    assert np.linalg.norm(found - truth) / np.linalg.norm(truth) < 0.02


@pytest.mark.parametrize("depth_m", [0.02, np.inf])
def test_psf_of_a_staircase_equals_the_direct_sum(depth_m):
    """A staircase of random heights: the truth sums 8 x 8 points per mask pixel; the bound is the measured sampling error."""
    mask, d, pitch = _staircase_mask(40), 0.4e-3, 6e-6
    config = PsfConfig((depth_m,), wavelengths_per_channel=1, oversampling=4)
    stack = compute_psf_stack(mask, CameraGeometry(d, pitch, GREEN), config)
    middle = stack.values.shape[-1] // 2
    pixels = np.random.default_rng(1).integers(-7, 8, (8, 2))
    truth = _direct_pixel_values(mask, 532e-9, d, depth_m, pitch, pixels, 8)
    stored = stack.values[0, 0][middle - pixels[:, 0], middle - pixels[:, 1]]
    assert np.linalg.norm(stored - truth) / np.linalg.norm(truth) < 0.02
    # The direct sum sees all angles, the PSF ORDERS of them, so it must not be brighter.
    assert stack.energy_m2()[0, 0] < mask.transmitted_area_m2


@pytest.mark.parametrize(
    ("pixel_m", "d"), [pytest.param(20e-6, 1.9e-3, marks=pytest.mark.slow), (30e-6, 0.5e-3)], ids=["20 um", "FlatCam"]
)
def test_psf_of_coarse_mask_pixels_equals_the_direct_sum(pixel_m, d):
    """Mask pixels larger than the sensor's, and the first diffraction orders closer than a Fresnel length sqrt(lambda d).

    Cutting the wave at its first orders would be wrong by 0.08 and 0.8. What is left is the sensor pixel's rule (0.5 %)
    and the truth's own midpoint rule (0.4 %).
    """
    mask = replace(_staircase_mask(4, seed=2), pitch_m=pixel_m)
    camera = CameraGeometry(d, 9.6e-6, GREEN)
    config = PsfConfig((np.inf,), wavelengths_per_channel=1, oversampling=round(pixel_m / 1.2e-6))
    stack = compute_psf_stack(mask, camera, config)
    middle = stack.values.shape[-1] // 2
    pixels = np.random.default_rng(1).integers(-5, 6, (8, 2))
    truth = _direct_pixel_values(mask, 532e-9, d, np.inf, 9.6e-6, pixels, round(pixel_m / 1e-6), nodes=12)
    stored = stack.values[0, 0][middle - pixels[:, 0], middle - pixels[:, 1]]
    assert np.linalg.norm(stored - truth) / np.linalg.norm(truth) < 0.01
    assert 0.95 < stack.energy_m2()[0, 0] / mask.transmitted_area_m2 < 1
    # One sample per mask pixel is far too few here: the proof must say so.
    with pytest.raises(InputError, match=r"^oversampling: "):
        prove_sampling(mask, camera, PsfConfig((np.inf,), wavelengths_per_channel=1))


@pytest.mark.parametrize("samples", [1, 4])
def test_a_mask_smaller_than_a_sensor_pixel_lights_the_pixels_that_rays_reach(samples):
    """2 and 8 um of mask behind pixels of 60 um: the far field of a square, sinc^2 per axis, on each pixel.

    Truth: |sinc|^2 integrated over the pixels in the angle's tangent, paraxial to (60 um / 0.6 mm)^2 = 1 %.
    """
    d, pitch = 0.6e-3, 60e-6
    mask = Mask(np.zeros((samples, samples)), np.ones((samples, samples)), 2e-6)
    stack = compute_psf_stack(mask, CameraGeometry(d, pitch, GREEN), PsfConfig((np.inf,), wavelengths_per_channel=1))
    middle = stack.values.shape[-1] // 2
    x = (np.arange(3 * 400) + 0.5) / 400 * pitch - 1.5 * pitch
    width = samples * 2e-6
    share = (
        (np.sinc(width * x / np.hypot(x, d) / 532e-9) ** 2 * width / 532e-9 / d).reshape(3, 400).sum(1) * pitch / 400
    )
    expected = np.outer(share, share) * width**2 / pitch**2
    found = stack.values[0, 0][middle - 1 : middle + 2, middle - 1 : middle + 2]
    np.testing.assert_allclose(found, expected, atol=0.02 * expected.max())


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-9), (np.float32, 1e-6)])
def test_all_light_of_a_smooth_mask_reaches_the_stack(dtype, tolerance):
    """Parseval: the sum of a PSF times the pixel area is transmittance x aperture area, at every depth and any pixel."""
    mask = _smooth_mask(dtype=dtype)
    for pitch in (2.3e-6, 19.2e-6):
        stack = compute_psf_stack(mask, CameraGeometry(0.4e-3, pitch, GREEN), PsfConfig((0.01, 0.1, np.inf)))
        np.testing.assert_allclose(stack.energy_m2(), mask.transmitted_area_m2, rtol=tolerance)


@pytest.mark.parametrize("model", ["scaled_distance", "exact"])
@pytest.mark.parametrize("distance_m", [0.05e-3, 0.3e-3, 1.9e-3])
@pytest.mark.parametrize("turns", [0.0, 0.45])
def test_a_steep_or_near_smooth_mask_keeps_its_light(distance_m, turns, model):
    """A prism just below Nyquist (0.5 turns per sample), and distances where the band limit's edge exceeds the spread.

    The soft aperture leaves 1e-6 of the light outside the band; at oversampling 2 the sampled intensity adds 1e-7, and the
    fading end of an exact PSF's band takes 8e-6.
    """
    soft = _smooth_mask(200, 2e-6)
    slope = turns * 532e-9 / (FUSED_SILICA.index(532e-9) - 1)
    mask = replace(soft, height_m=np.broadcast_to(np.arange(200) * slope, (200, 200)).copy())
    for oversampling in (1, 2):
        config = PsfConfig((np.inf,), model, wavelengths_per_channel=1, oversampling=oversampling)
        stack = compute_psf_stack(mask, CameraGeometry(distance_m, 19.2e-6, GREEN), config)
        np.testing.assert_allclose(stack.energy_m2(), mask.transmitted_area_m2, rtol=1e-5 if model == "exact" else 3e-6)
    config = replace(config, oversampling=1)
    assert sampling_error(mask, CameraGeometry(distance_m, 19.2e-6, GREEN), config)["error"] < 3e-3


def test_light_of_a_staircase_is_that_of_its_diffraction_orders():
    """The share that arrives is the power of the staircase's spectrum (the pixel's sinc included) inside the followed angles.

    A ray picture relates angle and place, so the two agree up to diffraction at the window's rim: 1 %.
    """
    mask, wavelength, d = _staircase_mask(200), 532e-9, 1.9e-3
    stack = compute_psf_stack(mask, CameraGeometry(d, 19.2e-6, GREEN), PsfConfig((np.inf,), wavelengths_per_channel=1))
    spectrum = np.abs(np.fft.fft2(mask.transmission(wavelength))) ** 2
    order = np.arange(-500, 501)
    frequency = order / (200 * mask.pitch_m)
    share = np.abs(np.sinc(order / 200)) ** 2
    power = spectrum[np.ix_(order % 200, order % 200)] * share[:, None] * share[None, :]
    cosine = np.sqrt(1 - wavelength**2 * (frequency[:, None] ** 2 + frequency[None, :] ** 2))
    limit = ORDERS * wavelength / mask.pitch_m / np.sqrt(1 - (ORDERS * wavelength / mask.pitch_m) ** 2)
    inside = (np.abs(wavelength * frequency[:, None] / cosine) < limit) & (
        np.abs(wavelength * frequency / cosine) < limit
    )
    expected = power[inside].sum() / spectrum.sum()
    assert stack.energy_m2()[0, 0] / mask.transmitted_area_m2 == pytest.approx(expected, abs=0.01)
    assert 0.8 < expected < 0.99  # the orders that are not followed are real: this mask scatters wildly


def test_an_off_centre_hole_lands_where_rays_say_in_the_stored_frame():
    """Physical light through a hole at (+x, +y) lands at (1 + d/z) times that; the stored frame turns it by 180 degrees."""
    samples, pitch = 200, 2e-6
    amplitude = np.zeros((samples, samples))
    amplitude[150:160, 120:130] = 1  # 10 x 10 samples of 2 um: y = 110 um, x = 50 um
    mask = Mask(np.zeros_like(amplitude), amplitude, pitch)
    depths = (0.005, 0.02, np.inf)
    stack = compute_psf_stack(mask, CameraGeometry(1.9e-3, 4.8e-6, GREEN), PsfConfig(depths, wavelengths_per_channel=1))
    grid = np.arange(stack.values.shape[-1]) - stack.values.shape[-1] // 2
    for image, depth in zip(stack.values[:, 0], depths, strict=True):
        m = 1 + 1.9e-3 / depth
        y, x = (np.sum(image.sum(1) * grid) / image.sum(), np.sum(image.sum(0) * grid) / image.sum())
        # The centroid of a symmetric hole's light is the ray through its middle; the window cuts symmetric tails unevenly.
        assert y * 4.8e-6 == pytest.approx(-110e-6 * m, abs=1.5e-6)
        assert x * 4.8e-6 == pytest.approx(-50e-6 * m, abs=1.5e-6)


def test_scaled_psf_is_the_magnified_psf_of_infinity_and_scaled_distance_is_not():
    mask, camera = _smooth_mask(), CameraGeometry(0.5e-3, 3e-6, GREEN)
    config = PsfConfig((0.005, np.inf), wavelengths_per_channel=1)
    distance, scaled = (
        compute_psf_stack(mask, camera, config),
        compute_psf_stack(mask, camera, replace(config, model="scaled_psf")),
    )
    np.testing.assert_array_equal(distance.values[1], scaled.values[1])
    finer = compute_psf_stack(mask, replace(camera, pixel_pitch_m=3e-6 / 1.1), replace(config, depths_m=(np.inf,)))
    a, b = scaled.values[0, 0], finer.values[0, 0] / 1.1**2
    size = min(a.shape[0], b.shape[0]) // 2

    def middle(v):
        c = v.shape[0] // 2
        return v[c - size : c + size, c - size : c + size]

    a, b = middle(a), middle(b)
    np.testing.assert_allclose(a, b, atol=1e-9 * a.max())
    difference = np.linalg.norm(distance.values[0] - scaled.values[0]) / np.linalg.norm(distance.values[0])
    assert difference > 0.02


@pytest.mark.parametrize("vignetting", [True, False])
def test_pinhole_camera_returns_the_scene(vignetting):
    """Upright, on the right pixel, times cos^4, in absolute units: E = L A / d^2 cos^4 (the textbook pinhole camera)."""
    from psf_library.designs.pinhole import pinhole

    d, pitch = 1.9e-3, 240e-6  # pixels so large that the Airy disc (24 um) and the hole (60 um) stay inside one
    mask = pinhole(diameter_um=60)
    stack = compute_psf_stack(mask, CameraGeometry(d, pitch, GREEN), PsfConfig((0.05,), wavelengths_per_channel=1))
    stack = replace(stack, values=np.repeat(stack.values, 3, axis=1), channels=("R", "G", "B"))
    rng = np.random.default_rng(0)
    rgb = rng.uniform(size=(1, 10, 12, 3)).astype(np.float32)
    clip = Clip(rgb, np.full((1, 10, 12), 0.05, np.float32), np.ones((1, 10, 12), bool), np.array([0.0, 1.0]))
    view = View((10, 12), pitch, d, 0.03, 0.2)
    model = ForwardModel(stack, (14, 16), (10, 12), irradiance=FieldOfView(vignetting).irradiance(view))
    image = model.forward_clip(clip)
    y, x = (np.arange(10) - 4.5) * pitch, (np.arange(12) - 5.5) * pitch
    cosine = d / np.sqrt(d**2 + y[:, None] ** 2 + x[None, :] ** 2)
    expected = rgb[0] * (cosine[..., None] ** 4 if vignetting else 1) * mask.transmitted_area_m2 / d**2
    error = np.moveaxis(image[:, 2:-2, 2:-2], 0, -1) - expected
    # The Airy pattern's tail outside one 240 um pixel is 1.2 % of the light; it lands on neighbours.
    assert np.linalg.norm(error) / np.linalg.norm(expected) < 0.02
    assert np.abs(error).max() < 0.03 * expected.max()


def test_default_field_darkens_as_stated():
    """PHYSICS section 6: 0.50 at mid-edge and 0.30 in the corner of 128 x 128 pixels of 19.2 um at 1.9 mm."""
    weights = FieldOfView().irradiance(View((128, 128), 19.2e-6, 1.9e-3, 0.036, 0.2))
    relative = weights / weights.max()
    assert relative[0, 63] == pytest.approx(0.50, abs=0.01)
    assert relative[0, 0] == pytest.approx(0.30, abs=0.035)
    assert weights[63, 63] == pytest.approx((19.2e-6 / 1.9e-3) ** 2, rel=1e-3)


@pytest.mark.parametrize(
    ("mask", "depth_m", "oversampling", "tolerance"),
    [
        # The same samples and the same band; ``exact`` fades the corners of the band (0.2 %).
        (_smooth_mask(), np.inf, 1, {"scaled_distance": 1e-9, "exact": 4e-3}),
        # The source's wave, sampled with the mask, widens the band a little, which the plain grid folds back.
        (_smooth_mask(), 0.02, 1, {"scaled_distance": 4e-3, "exact": 4e-3}),
        # A staircase's orders beyond half the oversampling fold back: 5, 1.3 and 0.4 % at 2, 4 and 8 against ``exact``.
        (_staircase_mask(40), np.inf, 8, {"scaled_distance": 0.015, "exact": 8e-3}),
        (_staircase_mask(40), 0.02, 8, {"scaled_distance": 0.015, "exact": 8e-3}),
    ],
    ids=["smooth, infinity", "smooth, 2 cm", "staircase, infinity", "staircase, 2 cm"],
)
def test_the_fast_models_give_what_the_plain_formula_gives(mask, depth_m, oversampling, tolerance):
    plain = plain_psf(mask, 1.9e-3, 532e-9, depth_m, 9.6e-6, 31, oversampling=oversampling)
    camera = CameraGeometry(1.9e-3, 9.6e-6, GREEN)
    for model, allowed in tolerance.items():
        (fast,) = depth_images(mask, camera, PsfConfig((depth_m,), model), 532e-9, 31)
        assert np.linalg.norm(plain - fast) / np.linalg.norm(fast) < allowed, model


# --- smooth masks whose phase is steeper than their own samples can tell: what the refusal advises must be right

STEEP_PITCH_M, STEEP_SAMPLES = 2e-6, 160
HEIGHT_PER_TURN_M = 532e-9 / (FUSED_SILICA.index(532e-9) - 1)


def _steep_lens(turns: float) -> Mask:
    """A lens whose phase turns by ``turns`` per sample at 80 % of its half-width, where its soft aperture ends."""
    x = (np.arange(STEEP_SAMPLES) - (STEEP_SAMPLES - 1) / 2) * STEEP_PITCH_M
    radius = np.hypot(x[:, None], x[None, :])
    rim = 0.8 * STEEP_SAMPLES * STEEP_PITCH_M / 2
    height = -(radius**2) * turns * HEIGHT_PER_TURN_M / (2 * STEEP_PITCH_M * rim)
    return Mask(height - height.min(), np.exp(-((radius / rim) ** 12)), STEEP_PITCH_M, FUSED_SILICA, "smooth")


@pytest.mark.parametrize("model", ["scaled_distance", "exact"])
@pytest.mark.parametrize("turns", [0.3, 0.6, 0.8])
def test_oversampling_two_of_a_steep_mask_equals_the_direct_sum(turns, model):
    """All the light arrives, at the right places. Truth: the same cubic surface at six samples per mask sample, 2e-3."""
    camera, config = CameraGeometry(1e-3, 19.2e-6, GREEN), PsfConfig((np.inf,), model, oversampling=2)
    mask, rng = _steep_lens(turns), np.random.default_rng(0)
    points, found = sampled_intensity(mask, camera, config, 532e-9, np.inf, 8, rng)
    truth = np.abs(rayleigh_sommerfeld(mask.transmission(532e-9, 6), STEEP_PITCH_M / 6, 532e-9, 1e-3, points)) ** 2
    assert np.linalg.norm(found - truth) / np.linalg.norm(truth) < 0.01
    stack = compute_psf_stack(mask, camera, replace(config, wavelengths_per_channel=1))
    assert stack.energy_m2()[0, 0] == pytest.approx(mask.transmitted_area_m2, rel=2e-3)


def test_only_open_samples_are_steep():
    """A prism of 0.4 turns per sample; a step of ten turns where no light passes does not count."""
    height = np.broadcast_to(np.arange(40) * 0.4 * HEIGHT_PER_TURN_M, (40, 40)).copy()
    amplitude = np.ones((40, 40))
    height[:, 30:] += 10 * HEIGHT_PER_TURN_M
    amplitude[:, 30] = 0
    mask = Mask(height, amplitude, STEEP_PITCH_M, FUSED_SILICA, "smooth")
    assert steepest_frequency(mask, 532e-9) * STEEP_PITCH_M == pytest.approx(0.4, rel=1e-9)
    open_ = replace(mask, amplitude=np.ones((40, 40)))
    assert steepest_frequency(open_, 532e-9) * STEEP_PITCH_M == pytest.approx(10.4, rel=1e-9)


def test_one_psf_of_a_shared_wavelength_serves_all_channels():
    """Each channel is the weighted sum of the plain PSFs; no wavelength is computed twice."""
    at = np.arange(500e-9, 601e-9, 10e-9)
    response = SpectralResponse(at, np.array([at - 490e-9, 610e-9 - at]), ("R", "G"), "two ramps")
    height = np.random.default_rng(0).integers(0, 4, (20, 20)) * 0.2e-6
    mask, camera = Mask(height, np.ones_like(height), 2e-6), CameraGeometry(0.2e-3, 6e-6, response)
    config, told = PsfConfig((0.02, np.inf), shared_wavelengths=3), []
    stack = compute_psf_stack(mask, camera, config, progress=lambda done, total: told.append((done, total)))
    assert told[-1] == (6, 6)
    expected = np.zeros_like(stack.values)
    for line in shared_lines(response, 3):
        for k, image in enumerate(depth_images(mask, camera, config, line.wavelength_m, stack.values.shape[-1])):
            expected[k, line.channel] += line.weight * image
    np.testing.assert_allclose(stack.values, expected, rtol=1e-9)
    assert np.linalg.norm(stack.values[:, 0] - stack.values[:, 1]) > 0.01 * np.linalg.norm(stack.values[:, 0])
