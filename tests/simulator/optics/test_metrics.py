"""PSF metrics against closed forms and brute force."""

import numpy as np
import pytest
from scipy.signal import correlate2d
from scipy.special import j1

from simulator.errors import InputError
from simulator.optics.metrics import autocorrelation, depth_limit_m, light_off_sensor, radial_mtf
from simulator.optics.stack import PsfStack


def _stack(values: np.ndarray) -> PsfStack:
    channels = tuple("RGB"[: values.shape[1]])
    return PsfStack(values, np.arange(1.0, values.shape[0] + 1), 1e-5, channels, "test")


def _axes(shape):
    return (np.arange(n) - n // 2 for n in shape)


# --- autocorrelation


def test_autocorrelation_of_one_bright_pixel_is_one_bright_pixel():
    image = np.zeros((7, 10))
    image[1, 8] = 3.0
    expected = np.zeros((13, 19))
    expected[6, 9] = 1
    np.testing.assert_allclose(autocorrelation(image), expected, atol=1e-15)


@pytest.mark.parametrize("shape", [(5, 8), (6, 6), (1, 9), (12, 3)])
def test_autocorrelation_equals_the_direct_sum(shape):
    """Nothing wraps around: the direct double sum of SciPy has no period."""
    image = np.random.default_rng(0).random(shape)
    direct = correlate2d(image, image) / np.sum(image**2)
    np.testing.assert_allclose(autocorrelation(image), direct, atol=1e-12)


def test_autocorrelation_of_a_gaussian_is_sqrt_two_wider():
    """Exp(-x^2 / 2 s^2) correlates to exp(-x^2 / 4 s^2); at s = 4 samples the sums equal the integrals to 1e-12."""
    y, x = _axes((61, 71))
    image = np.exp(-(y[:, None] ** 2 + x[None, :] ** 2) / 32)
    shifts_y, shifts_x = _axes((121, 141))
    expected = np.exp(-(shifts_y[:, None] ** 2 + shifts_x[None, :] ** 2) / 64)
    np.testing.assert_allclose(autocorrelation(image), expected, atol=1e-10)


@pytest.mark.parametrize("image", [np.zeros((3, 3)), np.array([[1.0, np.nan]]), np.ones(4), np.ones((0, 3))])
def test_autocorrelation_refuses_what_has_none(image):
    with pytest.raises(InputError, match="image"):
        autocorrelation(image)


# --- MTF


def test_mtf_of_one_bright_pixel_is_one_up_to_nyquist():
    image = np.zeros((33, 33))
    image[4, 20] = 0.5
    frequency, mtf = radial_mtf(image, 2e-6)
    np.testing.assert_allclose(mtf, 1, atol=1e-12)
    assert frequency[0] == 0
    assert np.all(np.diff(frequency) > 0)
    # The last ring is centred on floor(33 / 2) / 33 of the sampling frequency, 1.5 % below Nyquist; its mean is near it.
    assert abs(frequency[-1] / (16 / 33 / 2e-6) - 1) < 0.02


@pytest.mark.parametrize("shape", [(129, 129), (96, 128), (128, 61)])
def test_mtf_of_a_gaussian_is_a_gaussian(shape):
    """MTF = exp(-2 (pi s f)^2). A ring of width w averages it to second order: (w^2 / 24) MTF'' < 1e-3 here."""
    pitch, sigma = 5e-6, 2.5 * 5e-6
    y, x = (axis * pitch for axis in _axes(shape))
    frequency, mtf = radial_mtf(np.exp(-(y[:, None] ** 2 + x[None, :] ** 2) / (2 * sigma**2)), pitch)
    np.testing.assert_allclose(mtf, np.exp(-2 * (np.pi * sigma * frequency) ** 2), atol=1e-3)


def test_mtf_of_a_disc_is_a_jinc():
    """A pinhole's shadow: |2 J1(x) / x|, x = pi D f. Area weighting of the rim multiplies by the pixel's sinc < 1 %."""
    fine, size, diameter, pitch = 8, 200, 24.0, 3e-6
    at = (np.arange(size * fine) + 0.5) / fine - size / 2
    inside = (at[:, None] ** 2 + at[None, :] ** 2 <= (diameter / 2) ** 2).astype(float)
    image = inside.reshape(size, fine, size, fine).mean((1, 3))
    frequency, mtf = radial_mtf(image, pitch)
    low = (frequency > 0) & (frequency * pitch < 0.12)
    argument = np.pi * diameter * pitch * frequency[low]
    np.testing.assert_allclose(mtf[low], np.abs(2 * j1(argument) / argument), atol=0.012)


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
    ("image", "pitch", "words"), [(-np.ones((3, 3)), 1.0, "sum"), (np.ones((3, 3)), 0.0, "pitch_m")]
)
def test_mtf_refuses_senseless_input(image, pitch, words):
    with pytest.raises(InputError, match=words):
        radial_mtf(image, pitch)


# --- depth limit


@pytest.mark.parametrize(("pitch_m", "limit_m"), [(19.2e-6, 0.35), (2.4e-6, 2.8)])
def test_depth_limit_of_the_published_camera(pitch_m, limit_m):
    assert depth_limit_m(7e-3, 1.9e-3, pitch_m) == pytest.approx(limit_m, rel=0.02)


def test_depth_limit_is_where_the_rim_moves_by_one_pixel():
    """A ray from an axial point at z through the mask's rim a/2 lands at (a/2)(1 + d/z); from infinity at a/2."""
    a, d, p = 3.1e-3, 1.7e-3, 7e-6
    z = depth_limit_m(a, d, p)
    assert a / 2 * (1 + d / z) - a / 2 == pytest.approx(p, rel=1e-9)


@pytest.mark.parametrize("lengths", [(0, 1e-3, 1e-6), (1e-3, -1e-3, 1e-6), (1e-3, 1e-3, float("nan"))])
def test_depth_limit_refuses_lengths_that_are_not_positive(lengths):
    with pytest.raises(InputError, match="_m: got"):
        depth_limit_m(*lengths)


# --- light that misses the sensor


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


def test_light_off_sensor_agrees_with_the_forward_model():
    """What a uniform scene sends and the forward model does not deliver."""
    from simulator.camera.convolution import StackConvolution

    values = np.random.default_rng(2).random((2, 1, 21, 18))
    planes = np.zeros((2, 1, 6, 8))
    lost = light_off_sensor(_stack(values), (16, 12), (6, 8))
    for k in range(2):
        planes[:] = 0
        planes[k] = 1
        received = StackConvolution(values, (16, 12), (6, 8)).forward(planes).sum()
        assert 1 - received / (48 * values[k].sum()) == pytest.approx(lost[k, 0], abs=1e-12)


def test_nothing_is_lost_on_a_large_sensor():
    assert np.all(light_off_sensor(_stack(np.ones((1, 3, 9, 9))), (40, 40), (20, 20)) == 0)


@pytest.mark.parametrize("scene_shape", [(41, 40), (39, 40), (40, 0)])
def test_light_off_sensor_refuses_scenes_that_do_not_fit(scene_shape):
    with pytest.raises(InputError, match="scene_shape"):
        light_off_sensor(_stack(np.ones((1, 1, 9, 9))), (40, 40), scene_shape)
