"""Exact PSFs against direct Rayleigh-Sommerfeld sums, the oracle, and what physics says without any sum."""

from dataclasses import replace

import numpy as np
import pytest

from simulator.errors import InputError
from simulator.optics.exact import ORDERS, Wave, exact_images, waves
from simulator.optics.fine_mask import TAPER
from simulator.optics.mask import Mask
from simulator.optics.materials import FUSED_SILICA
from simulator.optics.psf import PsfConfig, depth_images, sampled_intensity
from simulator.optics.rayleigh_sommerfeld import rayleigh_sommerfeld
from simulator.optics.sources import Source
from simulator.types import CameraGeometry, SpectralResponse

GREEN = SpectralResponse(np.array([531e-9, 532e-9, 533e-9]), np.array([[0.0, 1.0, 0.0]]), ("Y",), "one line")
D = 0.5e-3
CAMERA = CameraGeometry(D, 4e-6, GREEN)
DIRECTIONS = [(0.0, 0.0), (0.3, -0.1), (-0.1, 0.6)]  # up to 31 degrees


def grid(samples: int, pitch_m: float) -> tuple[np.ndarray, np.ndarray]:
    x = (np.arange(samples) - (samples - 1) / 2) * pitch_m
    return x[:, None], x[None, :]


def random_phase(dtype=np.float64, samples=160, pitch_m=1e-6) -> Mask:
    """Random cosines under a smooth round aperture; not symmetric in any way."""
    y, x = grid(samples, pitch_m)
    height = np.zeros((samples, samples))
    for fy, fx, a, p in zip(*np.random.default_rng(0).uniform(-1, 1, (4, 8)), strict=True):
        height += 0.25e-6 * a * np.cos(2 * np.pi * 2.5e4 * (fy * y + fx * x) + 3 * p)
    aperture = np.exp(-((np.hypot(y, x) / (0.36 * samples * pitch_m)) ** 12))
    return Mask(height.astype(dtype), aperture.astype(dtype), pitch_m, FUSED_SILICA, "smooth")


def soft_lens(dtype=np.float64, samples=161, pitch_m=1e-6) -> Mask:
    """A lens of 0.9 mm focal length, off centre under its aperture: an odd grid, a steep phase."""
    y, x = grid(samples, pitch_m)
    height = -(np.hypot(y - 7e-6, x + 12e-6) ** 2) / (2 * 0.9e-3 * 0.46)
    aperture = np.exp(-((np.hypot(y, x) / (0.36 * samples * pitch_m)) ** 12))
    return Mask((height - height.min()).astype(dtype), aperture.astype(dtype), pitch_m, FUSED_SILICA, "smooth")


def soft_holes(dtype=np.float64, samples=150, pitch_m=1e-6) -> Mask:
    """Two soft holes and a soft bar: amplitude alone, gone to 1e-18 at the mask's border."""
    y, x = grid(samples, pitch_m)
    amplitude = np.exp(-((np.hypot(y - 14e-6, x + 18e-6) / 8e-6) ** 2))
    amplitude += 0.5 * np.exp(-((np.hypot(y + 20e-6, x + 5e-6) / 6e-6) ** 2))
    amplitude += 0.8 * np.exp(-(((y - 5e-6) / 9e-6) ** 2) - ((x - 20e-6) / 5e-6) ** 2)
    return Mask(np.zeros_like(amplitude, dtype), amplitude.clip(0, 1).astype(dtype), pitch_m, FUSED_SILICA, "smooth")


MASKS = [random_phase, soft_lens, soft_holes]


def incident(mask: Mask, source: Source) -> tuple[np.ndarray, np.ndarray, float]:
    """The incident wave on the mask's samples, written down anew; the direction of its chief ray; its sine."""
    tangent = np.array(source.direction)
    chief = -tangent / np.sqrt(1 + tangent @ tangent)
    y, x = ((np.arange(n) - (n - 1) / 2) * mask.pitch_m for n in mask.shape)
    y, x = y[:, None], x[None, :]
    k = 2 * np.pi / source.wavelength_m
    if np.isinf(source.depth_m):
        return np.exp(1j * k * (chief[0] * x + chief[1] * y)), chief, float(np.hypot(*chief))
    at_x, at_y, z = *(tangent * source.depth_m), source.depth_m
    r0, r = np.sqrt(at_x**2 + at_y**2 + z**2), np.sqrt((x - at_x) ** 2 + (y - at_y) ** 2 + z**2)
    return r0 / r * np.exp(1j * k * (r - r0)), chief, float(np.hypot(*chief))


def mean_cosine(mask: Mask, source: Source) -> float:
    """The mean of cos(theta) of the light behind the mask, by its power |U|^2 in each direction."""
    wave, chief, sine = incident(mask, source)
    y, x = grid(mask.shape[0], mask.pitch_m)
    k = 2 * np.pi / source.wavelength_m
    field = mask.transmission(source.wavelength_m, 1, sine) * wave * np.exp(-1j * k * (chief[0] * x + chief[1] * y))
    power = np.abs(np.fft.fft2(field, (400, 400))) ** 2
    s = np.fft.fftfreq(400, mask.pitch_m) * source.wavelength_m
    cosine = np.sqrt(np.clip(1 - (s[:, None] + chief[1]) ** 2 - (s[None, :] + chief[0]) ** 2, 0, None))
    return float(np.sum(power * cosine) / np.sum(power))


def direct(mask: Mask, source: Source, points_m: np.ndarray, d: float = D) -> np.ndarray:
    """|U|^2 by the direct sum at points around the PSF's centre."""
    wave, chief, sine = incident(mask, source)
    centre = d * chief / np.sqrt(1 - sine**2)
    transmission = np.asarray(mask.transmission(source.wavelength_m, 1, sine), complex)
    field = rayleigh_sommerfeld(transmission * wave, mask.pitch_m, source.wavelength_m, d, points_m + centre)
    return np.abs(field) ** 2


def direct_flux(mask: Mask, source: Source, points_m: np.ndarray, d: float = D) -> np.ndarray:
    """Im(U* dU/dz) / k by direct sums, per that of the incident wave: irradiance per irradiance, at the same points."""
    wave, chief, sine = incident(mask, source)
    light = wave * np.asarray(mask.transmission(source.wavelength_m, 1, sine), complex)
    cosine, k, h = np.sqrt(1 - sine**2), 2 * np.pi / source.wavelength_m, 2e-9
    points = points_m + d * chief / cosine
    below, here, above = (
        rayleigh_sommerfeld(light, mask.pitch_m, source.wavelength_m, d + z, points) for z in (-h, 0, h)
    )
    return np.imag(np.conj(here) * (above - below)) / (2 * h * k * cosine)


def error(found: np.ndarray, truth: np.ndarray) -> float:
    return float(np.linalg.norm(found - truth) / np.linalg.norm(truth))


# --- direct sums


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("make", MASKS)
@pytest.mark.parametrize("wavelength_m", [470e-9, 640e-9])
@pytest.mark.parametrize("depth_m", [0.006, 0.02, 0.1, np.inf])
@pytest.mark.slow
def test_the_wave_equals_the_direct_sum_on_and_off_axis(make, wavelength_m, depth_m, dtype):
    """1e-9 in float64, 5e-6 in float32 (PHYSICS): smooth edges leave nothing but rounding. Truth always in float64."""
    mask, truth_mask = make(dtype), make(np.float64)
    truth_mask = replace(truth_mask, height_m=mask.height_m.astype(float), amplitude=mask.amplitude.astype(float))
    for direction in DIRECTIONS:
        config = PsfConfig((depth_m,), "exact")
        rng = np.random.default_rng(1)
        points, found = sampled_intensity(mask, CAMERA, config, wavelength_m, depth_m, 5, rng, direction=direction)
        truth = direct(truth_mask, Source(wavelength_m, depth_m, direction), points)
        assert error(found, truth) < (1e-9 if dtype == np.float64 else 5e-6), direction


def at(wave: Wave, points_m: np.ndarray) -> np.ndarray:
    """The field at any points (y, x), by the Fourier series that the grid stands for."""
    n, pitch_m = wave.grid.samples, wave.grid.pitch_m
    frequency = np.fft.fftfreq(n)
    spectrum = np.fft.fft(wave.spectrum, axis=0) / n**2
    down, across = (np.exp(2j * np.pi * np.outer(points_m[:, axis] / pitch_m + n // 2, frequency)) for axis in (0, 1))
    return np.sum((down @ spectrum) * across, axis=1)


@pytest.mark.slow
def test_a_staircase_equals_its_direct_sum():
    """Truth: 10 x 10 points per mask pixel, integrated over sensor pixels; its midpoint rule errs by 0.4 %."""
    mask, d, pitch_m = staircase(), 0.4e-3, 6e-6
    source, camera = Source(532e-9, 0.02, (0.2, 0.1)), CameraGeometry(0.4e-3, 6e-6, GREEN)
    fine = Mask(np.kron(mask.height_m, np.ones((10, 10))), np.ones((400, 400)), 2e-6 / 10, FUSED_SILICA)
    nodes, weights = np.polynomial.legendre.leggauss(6)
    pixels = np.random.default_rng(1).integers(-7, 8, (4, 2))
    truth = []
    for row, column in pixels:
        px, py = np.meshgrid((column + nodes / 2) * pitch_m, (row + nodes / 2) * pitch_m)
        values = direct_flux(fine, source, np.stack([px.ravel(), py.ravel()], 1), d)
        truth.append(np.sum(np.outer(weights, weights).ravel() / 4 * values))
    for oversampling in (1, 2):
        (stored,) = exact_images(mask, camera, [source], 41, oversampling=oversampling)
        assert error(stored[20 - pixels[:, 0], 20 - pixels[:, 1]], np.array(truth)) < 0.006


@pytest.mark.parametrize(("oversampling", "pixel_m"), [(1, 2e-6), pytest.param(2, 3e-6, marks=pytest.mark.slow)])
def test_the_light_of_a_staircase_is_that_of_the_orders_that_are_followed(oversampling, pixel_m):
    """Its spectrum is that of its samples, repeated under the sinc of a pixel; the band's soft edge lies within 5 %."""
    mask, camera = replace(staircase(), pitch_m=pixel_m), CameraGeometry(4e-3, 8e-6, GREEN)
    (image,) = exact_images(mask, camera, [Source(532e-9, np.inf)], 601, oversampling=oversampling)
    samples = 4 * mask.shape[0]
    power = np.abs(np.fft.fft2(mask.transmission(532e-9), (samples, samples))) ** 2
    orders = np.arange(-4 * samples, 4 * samples)
    shares = []
    for end in (TAPER * ORDERS * oversampling, ORDERS * oversampling):
        axis = np.zeros(samples)
        kept = np.abs(orders / samples) <= end
        np.add.at(axis, orders[kept] % samples, np.sinc(orders[kept] / samples) ** 2)
        shares.append(axis @ power @ axis / samples**2 / mask.shape[0] ** 2)
    found = image.sum() * 64e-12 / mask.transmitted_area_m2
    assert shares[0] - 5e-3 < found < shares[1] + 1e-9  # light steep along both axes is cut where the grid ends
    assert shares[1] < 1


def staircase() -> Mask:
    height = np.random.default_rng(0).integers(0, 6, (40, 40)) * 0.2e-6
    return Mask(height, np.ones_like(height), 2e-6, FUSED_SILICA, "staircase")


@pytest.mark.slow
@pytest.mark.parametrize("make", MASKS)
@pytest.mark.parametrize("direction", DIRECTIONS[1:])
def test_oblique_irradiance_is_the_flux_of_the_direct_sum(make, direction):
    """|U|^2 alone is off by 10 to 90 times as much: up to 1.4 % behind these masks, which bend light little."""
    mask, source = make(), Source(532e-9, 0.02, direction)
    (wave,) = waves(mask, CAMERA, [source], irradiance=True)
    half = round(0.4 * mask.shape[0] * mask.pitch_m / wave.grid.pitch_m)
    index, middle = np.random.default_rng(0).integers(-half, half, (200, 2)), wave.grid.samples // 2
    found = wave.intensity(index[:, 1] + middle)[np.arange(200), index[:, 0] + middle]
    truth, modulus = (by(mask, source, index * wave.grid.pitch_m) for by in (direct_flux, direct))
    assert error(found, truth) < 1e-3
    assert error(found, truth) < 0.1 * error(modulus, truth)


# --- energy, symmetry, reciprocity


@pytest.mark.parametrize("direction", DIRECTIONS)
@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float64, 1e-9), (np.float32, 1e-6)])
def test_all_light_of_a_smooth_mask_arrives(direction, dtype, tolerance):
    """Parseval; from 2 cm the wave itself falls off by (r0 / r)^2, which the sum over the mask knows.

    Off the axis every plane wave behind the mask carries its own cosine, per cosine of the chief ray's.
    """
    mask = random_phase(dtype)
    for depth_m in (0.02, np.inf):
        source = Source(532e-9, depth_m, direction)
        wave, _, sine = incident(mask, source)
        sent = np.sum(np.abs(wave) ** 2 * np.asarray(mask.amplitude, float) ** 2) * mask.pitch_m**2
        if direction != (0.0, 0.0):
            sent *= mean_cosine(mask, source) / np.sqrt(1 - sine**2)
        (image,) = exact_images(mask, CAMERA, [source], 301)
        assert float(np.sum(image, dtype=np.float64)) * CAMERA.pixel_pitch_m**2 == pytest.approx(sent, rel=tolerance)


@pytest.mark.parametrize("samples", [120, 121])
def test_symmetric_masks_give_symmetric_psfs_to_rounding(samples):
    """A ring is even in x and y and under their exchange, so its on-axis PSF is; off axis in x, it still is in y."""
    y, x = grid(samples, 1e-6)
    ring = np.exp(-(((np.hypot(y, x) - 35e-6) / 9e-6) ** 4))
    mask = Mask(np.zeros_like(ring), ring, 1e-6, FUSED_SILICA, "smooth")
    image, oblique = (
        next(iter(exact_images(mask, CAMERA, [Source(532e-9, 0.01, t)], 101))) for t in ((0, 0), (0.3, 0))
    )
    for other in (image[::-1], image[:, ::-1], image.T):
        assert error(other, image) < 1e-12
    assert error(oblique[::-1], oblique) < 1e-12
    assert error(oblique[:, ::-1], oblique) > 1e-3  # but no longer in x


def test_source_and_sensor_point_may_be_exchanged():
    """Reciprocity: light from Q to P through the mask equals light from P to Q through its mirror image.

    The Rayleigh-Sommerfeld kernel weighs arriving light by cos / r and (1 - 1 / (i k r)), the incident wave by 1 / r: the
    mask's amplitude makes up for it in both directions.
    """
    mask, wavelength_m, near, far = soft_holes(), 532e-9, 2e-3, 3e-3
    k = 2 * np.pi / wavelength_m
    (qy, qx), (py, px) = (40e-6, -70e-6), (-55e-6, 25e-6)  # lateral positions of Q at ``far``, P at ``near``
    y, x = grid(mask.shape[0], mask.pitch_m)
    r_q, r_p = (np.sqrt((y - a) ** 2 + (x - b) ** 2 + z**2) for a, b, z in ((qy, qx, far), (py, px, near)))

    def passage(from_y, from_x, depth, to_y, to_x, d, weigh):
        weighed = replace(mask, amplitude=(mask.amplitude * weigh / weigh.max()))
        source = Source(wavelength_m, depth, (from_x / depth, from_y / depth))
        (wave,) = waves(weighed, CameraGeometry(d, 4e-6, GREEN), [source])
        centre = np.array([-from_y, -from_x]) * d / depth
        r0 = np.sqrt(depth**2 + from_x**2 + from_y**2)
        # Undo the normalisations: 1 / r0 at the mask's centre, d / (2 pi) |ik - 1/r| of the kernel.
        return np.abs(at(wave, np.array([[to_y, to_x]]) - centre)[0]) * weigh.max() / r0 / d

    there = passage(qy, qx, far, py, px, near, r_p / np.abs(1 / r_p - 1j * k))
    back = passage(py, px, near, qy, qx, far, r_q / np.abs(1 / r_q - 1j * k))
    assert there == pytest.approx(back, rel=1e-9)


def test_an_oblique_psf_is_centred_where_its_chief_ray_arrives():
    """Its centroid is the mask's own, turned: diffraction spreads light about the ray, to second order in its angles."""
    mask = soft_holes()
    (image,) = exact_images(mask, CAMERA, [Source(532e-9, np.inf, (0.0, 0.35))], 81)
    rows, columns = np.indices(image.shape) - 40
    centre = np.array([np.sum(rows * image), np.sum(columns * image)]) / image.sum()
    light = np.asarray(mask.amplitude) ** 2
    y, x = grid(mask.shape[0], mask.pitch_m)
    shadow = -np.array([np.sum(light * y), np.sum(light * x)]) / light.sum() / CAMERA.pixel_pitch_m
    np.testing.assert_allclose(centre, shadow, atol=0.1)
    assert np.hypot(*shadow) > 1  # a centre forgotten would be seen


# --- models


def test_models_agree_for_a_plane_wave_and_part_with_the_angle_of_the_source():
    """At infinity the identity is exact (what is left is the pixel rule on either grid); near, its error is paraxial."""
    mask = random_phase()
    config = PsfConfig((0.0005, np.inf), "exact", oversampling=2)
    size, camera = 61, CameraGeometry(D, 12e-6, GREEN)
    exact = list(depth_images(mask, camera, config, 532e-9, size))
    scaled = list(depth_images(mask, camera, replace(config, model="scaled_distance"), 532e-9, size))
    assert error(scaled[1], exact[1]) < 2.5e-3
    assert error(scaled[0], exact[0]) > 3 * error(scaled[1], exact[1])


def test_only_exact_knows_oblique_sources():
    with pytest.raises(InputError, match=r"^direction: "):
        depth_images(random_phase(), CAMERA, PsfConfig((1.0,)), 532e-9, 11, direction=(0.1, 0))


def test_many_depths_share_grids_and_equal_each_alone():
    """Depths that share a grid sit on a finer one than they need: the same light to the sensor pixel's rule."""
    mask = random_phase()
    sources = [Source(532e-9, z) for z in (0.01, 0.012, 0.1, np.inf)]
    together = list(exact_images(mask, CAMERA, sources, 121, threads=2))
    for source, image in zip(sources, together, strict=True):
        (alone,) = exact_images(mask, CAMERA, [source], 121)
        assert error(image, alone) < 5e-3  # 4 um pixels over a grid of 1 um
