"""PSF metrics and figures of merit against closed forms and brute force."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.signal import correlate2d
from scipy.special import erf

from simulator.errors import InputError
from simulator.optics.metrics import (
    autocorrelation,
    autocorrelation_peak,
    depth_correlations,
    depth_limit_m,
    distinct_depths,
    light_off_sensor,
    mean_mtf,
    radial_mtf,
)
from simulator.optics.stack import PsfStack, depth_planes


def _stack(values: np.ndarray) -> PsfStack:
    channels = tuple("RGB"[: values.shape[1]])
    return PsfStack(values, np.arange(1.0, values.shape[0] + 1), 1e-5, channels, "test")


def _axes(shape):
    return (np.arange(n) - n // 2 for n in shape)


@pytest.mark.parametrize("shape", [(5, 8), (6, 6), (1, 9), (12, 3)])
def test_autocorrelation_equals_the_direct_sum(shape):
    """Nothing wraps around: the direct double sum of SciPy has no period."""
    image = np.random.default_rng(0).random(shape)
    direct = correlate2d(image, image) / np.sum(image**2)
    np.testing.assert_allclose(autocorrelation(image), direct, atol=1e-12)


@pytest.mark.parametrize("image", [np.zeros((3, 3)), np.array([[1.0, np.nan]]), np.ones(4), np.ones((0, 3))])
def test_autocorrelation_refuses_what_has_none(image):
    with pytest.raises(InputError, match=r"^image: "):
        autocorrelation(image)


@pytest.mark.parametrize("shape", [(129, 129), (96, 128), (128, 61)])
def test_mtf_of_a_gaussian_is_a_gaussian(shape):
    """MTF = exp(-2 (pi s f)^2). A ring of width w averages it to second order: (w^2 / 24) MTF'' < 1e-3 here."""
    pitch, sigma = 5e-6, 2.5 * 5e-6
    y, x = (axis * pitch for axis in _axes(shape))
    frequency, mtf = radial_mtf(np.exp(-(y[:, None] ** 2 + x[None, :] ** 2) / (2 * sigma**2)), pitch)
    np.testing.assert_allclose(mtf, np.exp(-2 * (np.pi * sigma * frequency) ** 2), atol=1e-3)


def test_mtf_of_a_long_line_is_its_sinc():
    """A box one pixel high and m wide on a single row: the only frequencies are along it, |sin(pi m f) / (m sin(pi f))|."""
    image, m = np.zeros((1, 240)), 7
    image[0, 50 : 50 + m] = 2.0
    frequency, mtf = radial_mtf(image, 1e-6)
    cycles = frequency[1:] * 1e-6
    np.testing.assert_allclose(mtf[1:], np.abs(np.sin(np.pi * m * cycles) / (m * np.sin(np.pi * cycles))), atol=1e-12)
    assert cycles[-1] == pytest.approx(0.5)


def test_mtf_does_not_depend_on_the_images_handedness():
    """The half that the real FFT leaves out counts: an image and its transpose have the same rings."""
    image = np.random.default_rng(0).random((30, 31))
    first, second = radial_mtf(image, 1.0), radial_mtf(image.T, 1.0)
    np.testing.assert_allclose(first, second, atol=1e-12)


@pytest.mark.parametrize(
    ("image", "pitch", "words"), [(-np.ones((3, 3)), 1.0, "^image: "), (np.ones((3, 3)), 0.0, "^pitch_m: ")]
)
def test_mtf_refuses_senseless_input(image, pitch, words):
    with pytest.raises(InputError, match=words):
        radial_mtf(image, pitch)


def test_depth_limit_is_where_the_rim_moves_by_one_pixel():
    """A ray from an axial point at z through the mask's rim a/2 lands at (a/2)(1 + d/z); from infinity at a/2."""
    a, d, p = 3.1e-3, 1.7e-3, 7e-6
    z = depth_limit_m(a, d, p)
    assert a / 2 * (1 + d / z) - a / 2 == pytest.approx(p, rel=1e-9)


@pytest.mark.parametrize("lengths", [(0, 1e-3, 1e-6), (1e-3, -1e-3, 1e-6), (1e-3, 1e-3, float("nan"))])
def test_depth_limit_refuses_lengths_that_are_not_positive(lengths):
    with pytest.raises(InputError, match="_m: got"):
        depth_limit_m(*lengths)


@pytest.mark.parametrize(
    ("psf_shape", "sensor_shape", "scene_shape"),
    [((7, 7), (8, 9), (4, 3)), ((20, 13), (10, 7), (10, 5)), ((5, 6), (31, 30), (1, 2)), ((40, 41), (4, 4), (2, 4))],
)
def test_light_off_sensor_equals_brute_force(psf_shape, sensor_shape, scene_shape):
    """Every scene pixel's PSF is laid on the sensor by hand, with the convolution's placing rule."""
    values = np.random.default_rng(1).random((2, 3, *psf_shape)) ** 4
    caught = np.zeros((2, 3))
    for i in range(scene_shape[0]):
        for j in range(scene_shape[1]):
            for r in range(psf_shape[0]):
                for c in range(psf_shape[1]):
                    row = i + (sensor_shape[0] - scene_shape[0]) // 2 + r - psf_shape[0] // 2
                    column = j + (sensor_shape[1] - scene_shape[1]) // 2 + c - psf_shape[1] // 2
                    if 0 <= row < sensor_shape[0] and 0 <= column < sensor_shape[1]:
                        caught += values[:, :, r, c]
    expected = 1 - caught / scene_shape[0] / scene_shape[1] / values.sum((-2, -1))
    np.testing.assert_allclose(light_off_sensor(_stack(values), sensor_shape, scene_shape), expected, atol=1e-12)


@pytest.mark.parametrize("scene_shape", [(41, 40), (39, 40), (40, 0)])
def test_light_off_sensor_refuses_scenes_that_do_not_fit(scene_shape):
    with pytest.raises(InputError, match=r"^scene_shape: "):
        light_off_sensor(_stack(np.ones((1, 1, 9, 9))), (40, 40), scene_shape)


def _gaussian(rows: float, columns: float, size: int = 121) -> np.ndarray:
    at = np.arange(size) - size // 2
    return np.exp(-(at[:, None] ** 2) / (2 * rows**2) - at[None, :] ** 2 / (2 * columns**2))


@pytest.mark.parametrize("sigma", [4.0, 6.5])
def test_the_peak_of_a_gaussian(sigma: float) -> None:
    """A = exp(-s^2 / 4 sigma^2): width 4 sqrt(ln 2) sigma, and 1/16 at that shift.

    Linear interpolation costs less than 1 / (8 sigma^2) of the width; the next whole shift may lie a little farther out.
    """
    peak = autocorrelation_peak(_gaussian(sigma, sigma), 3e-6)
    assert peak.width_m == pytest.approx(4 * np.sqrt(np.log(2)) * sigma * 3e-6, rel=1 / (8 * sigma**2))
    assert peak.sidelobe == pytest.approx(1 / 16, rel=0.05)


def test_the_peak_of_an_ellipse_has_the_ellipse_s_area() -> None:
    """Half-axes 2 sqrt(ln 2) sigma_i: the disc of their area has the geometric mean as diameter; interpolation is left."""
    peak = autocorrelation_peak(_gaussian(4, 9), 1.0)
    assert peak.width_m == pytest.approx(4 * np.sqrt(np.log(2)) * np.sqrt(4 * 9), rel=0.005)


def test_the_peak_of_one_pixel_is_about_one_pixel() -> None:
    """A is bilinear between 1 and its zero neighbours: along the angle phi it is (1 - r cos phi) (1 - r sin phi)."""
    image = np.zeros((9, 12))
    image[2, 8] = 5.0
    angles = np.arange(32) * np.pi / 64  # the rays of a quarter turn; the next quarter is their mirror image
    radii = np.array([brentq(lambda r, a=a: (1 - r * np.cos(a)) * (1 - r * np.sin(a)) - 0.5, 0, 0.8) for a in angles])
    peak = autocorrelation_peak(image, 2e-6)
    expected = 2 * np.sqrt(np.mean(radii**2))
    # Quarter-pixel steps joined by straight lines follow the parabola to 1 %.
    assert peak.width_m == pytest.approx(expected * 2e-6, rel=0.01)
    assert peak.sidelobe == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("second", [1.0, 0.3])
def test_a_second_point_is_a_sidelobe(second: float) -> None:
    """Two points of 1 and b: A at their distance is b / (1 + b^2)."""
    image = np.zeros((40, 40))
    image[10, 12], image[30, 20] = 1.0, second
    assert autocorrelation_peak(image, 1.0).sidelobe == pytest.approx(second / (1 + second**2), rel=1e-12)


def test_mean_mtf_of_a_gaussian() -> None:
    """The mean of exp(-2 (pi s f)^2) up to the last ring, 60 / 121: an error function; rings average to 1e-3."""
    sigma, last = 1.5, 60 / 121
    expected = erf(np.sqrt(2) * np.pi * sigma * last) / (2 * np.sqrt(2 * np.pi) * sigma * last)
    assert mean_mtf(_gaussian(sigma, sigma), 1.0) == pytest.approx(expected, abs=1e-3)


def test_identical_depths_are_one_depth() -> None:
    image = np.random.default_rng(0).random((9, 9))
    correlations = depth_correlations(_stack(np.stack([image, 2 * image, 0.1 * image])[:, None]))
    np.testing.assert_allclose(correlations, 1, atol=1e-12)
    assert distinct_depths(correlations, np.array([0.05, 0.1, np.inf])) == pytest.approx(1)


@pytest.mark.parametrize("spacing", ["disparity", "log"])
@pytest.mark.parametrize(("count", "tolerance"), [(60, 5e-3), (7, 0.03), (4, 0.08)])
def test_distinct_depths_of_few_planes_are_those_of_the_continuous_range(
    spacing: str, count: int, tolerance: float
) -> None:
    """Gaussian and exponential correlations, whose mean squares over [0, 1]^2 are known.

    That of exp(-(u - v)^2 / 2 w^2) is w sqrt(pi) erf(1 / w) - w^2 (1 - exp(-1 / w^2)), that of exp(-|u - v| / w) is
    w - w^2 (1 - exp(-2 / w)) / 2. Neighbours of four even planes correlate by 0.71 here.
    """
    depths_m = depth_planes(0.04, 0.1, count, spacing)
    u = (1 / depths_m - 10) / 15
    apart = np.abs(u[:, None] - u)
    w = 0.4
    gaussian = w * np.sqrt(np.pi) * erf(1 / w) - w**2 * (1 - np.exp(-1 / w**2))
    assert distinct_depths(np.exp(-(apart**2) / (2 * w**2)), depths_m) == pytest.approx(1 / gaussian, rel=tolerance)
    w = 1.0
    exponential = w - w**2 * (1 - np.exp(-2 / w)) / 2
    assert distinct_depths(np.exp(-apart / w), depths_m) == pytest.approx(1 / exponential, rel=tolerance)


def test_shifted_gaussians_correlate_as_their_autocorrelation() -> None:
    """C = exp(-s^2 / 4 sigma^2); at sigma = 5 samples sums equal integrals far below 1e-10."""
    image = _gaussian(5, 5)
    planes = np.stack([np.roll(image, shift, axis=1) for shift in (0, 4, 10)])
    shifts = np.array([[0, 4, 10], [4, 0, 6], [10, 6, 0]])
    np.testing.assert_allclose(depth_correlations(_stack(planes[:, None])), np.exp(-(shifts**2) / 100), atol=1e-10)


def test_channels_count_together() -> None:
    """Equal in one of two channels of one energy, disjoint in the other: half."""
    values = np.zeros((2, 2, 4, 4))
    values[:, 0, 1, 1] = 1
    values[0, 1, 2, 2] = values[1, 1, 3, 3] = 1
    stack = PsfStack(values, np.array([1.0, 2.0]), 1e-5, ("R", "G"), "test")
    np.testing.assert_allclose(depth_correlations(stack), [[1, 0.5], [0.5, 1]], atol=1e-15)
