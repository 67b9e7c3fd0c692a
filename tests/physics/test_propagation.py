"""Propagation against sums and closed forms that the test computes itself."""

import numpy as np
import pytest
from numpy.fft import fft2, ifft2

from simulator.errors import InputError
from simulator.optics.kernel import PixelKernel, kernel_reach_m
from simulator.optics.propagation import Transfer, angular_spectrum, angular_spectrum_adjoint, even_filter
from simulator.optics.rayleigh_sommerfeld import rayleigh_sommerfeld

WAVELENGTH_M = 532e-9


def _grid(samples: int, pitch_m: float) -> np.ndarray:
    return (np.arange(samples) - (samples - 1) / 2) * pitch_m


def _smooth_field(samples: int, pitch_m: float, seed: int = 0) -> np.ndarray:
    """A phase of a few random cosines under a smooth aperture: band-limited to rounding on a sub-micrometre grid."""
    rng = np.random.default_rng(seed)
    x = _grid(samples, pitch_m)
    y, x = x[:, None], x[None, :]
    phase = sum(
        a * np.cos(2 * np.pi * (fy * y + fx * x) + p)
        for fy, fx, a, p in zip(
            rng.uniform(-2e4, 2e4, 6),
            rng.uniform(-2e4, 2e4, 6),
            rng.uniform(0, 2, 6),
            rng.uniform(0, 6, 6),
            strict=True,
        )
    )
    return np.exp(1j * phase - (np.hypot(y, x) / (0.3 * samples * pitch_m)) ** 8)


def _direct(field, pitch, wavelength, distance, points):
    """Rayleigh-Sommerfeld by hand, one point at a time: independent of the package's own loop."""
    y, x = np.meshgrid(_grid(field.shape[0], pitch), _grid(field.shape[1], pitch), indexing="ij")
    k = 2 * np.pi / wavelength
    out = []
    for px, py in points:
        r = np.sqrt((x - px) ** 2 + (y - py) ** 2 + distance**2)
        out.append(np.sum(field * distance / r * (1 / r - 1j * k) * np.exp(1j * k * r) / r) * pitch**2 / (2 * np.pi))
    return np.array(out)


def test_direct_sum_equals_a_sum_by_hand():
    field = _smooth_field(40, 1e-6)[:, 3:]  # not square, so that rows and columns cannot be swapped
    points = np.array([[3e-6, -11e-6], [-15e-6, 8e-6]])
    ours = rayleigh_sommerfeld(field, 1e-6, WAVELENGTH_M, 0.3e-3, points)
    np.testing.assert_allclose(ours, _direct(field, 1e-6, WAVELENGTH_M, 0.3e-3, points), rtol=1e-12)


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.complex128, 1e-9), (np.complex64, 5e-6)])
def test_angular_spectrum_equals_the_direct_sum(dtype, tolerance):
    """PHYSICS section 3's accuracy, without the oracle: a smooth field small enough for a direct sum."""
    pitch, distance, samples = 0.5e-6, 0.4e-3, 384
    field = _smooth_field(samples, pitch)
    image = angular_spectrum(field.astype(dtype), pitch, WAVELENGTH_M, distance)
    assert image.dtype == dtype
    rows, columns = np.array([60, 151, 192, 301]), np.array([222, 97, 180, 260])
    x = _grid(samples, pitch)
    truth = _direct(field, pitch, WAVELENGTH_M, distance, np.stack([x[columns], x[rows]], 1))
    ours = image[rows, columns] * np.exp(2j * np.pi / WAVELENGTH_M * distance)
    # The field, not only its intensity: a wrong sign or constant phase would show.
    assert np.linalg.norm(ours - truth) / np.linalg.norm(truth) < tolerance


def test_a_tilted_beam_leaves_the_window_and_does_not_come_back():
    """A beam that walks 1.3 windows sideways must be gone, not wrapped around."""
    samples, pitch, distance = 256, 1e-6, 2e-3
    x = _grid(samples, pitch)
    sine = 0.165
    beam = np.exp(-((x[:, None] ** 2 + x[None, :] ** 2) / (40e-6) ** 2) + 2j * np.pi * sine / WAVELENGTH_M * x[None, :])
    image = angular_spectrum(beam, pitch, WAVELENGTH_M, distance)
    assert np.sum(np.abs(image) ** 2) < 1e-6 * np.sum(np.abs(beam) ** 2)


@pytest.mark.parametrize("shape", [(64, 1600), (1600, 40)])
def test_a_long_window_loses_no_light_that_stays_inside(shape):
    """A steep beam along the long side of a window: the short side's band limit must not reach it."""
    pitch, distance, sine = 1e-6, 0.8e-3, 0.245
    y, x = _grid(shape[0], pitch)[:, None], _grid(shape[1], pitch)[None, :]
    along = x if shape[1] > shape[0] else y
    start = -0.5 * distance * np.tan(np.arcsin(sine))
    envelope = np.exp(-((along - start) ** 2) / (60e-6) ** 2) * np.exp(-(((x if along is y else y) / 12e-6) ** 8))
    beam = envelope * np.exp(2j * np.pi * sine / WAVELENGTH_M * along)
    image = angular_spectrum(beam, pitch, WAVELENGTH_M, distance)
    large = np.zeros((2048, 2048), complex)
    corner = tuple(slice(1024 - n // 2, 1024 - n // 2 + n) for n in shape)
    large[corner] = beam
    transfer = Transfer(large.shape, pitch, WAVELENGTH_M, like=large)
    truth = even_filter(large, large.shape, transfer.quadrant(distance).__getitem__)[corner]
    # The short side really is band-limited (softly: 1e-3); a hard loss of the beam would be of order 1.
    assert np.linalg.norm(image - truth) / np.linalg.norm(truth) < 5e-3


@pytest.mark.parametrize("shape", [(16, 16), (16, 15), (15, 18), (17, 17)])
def test_quadrant_is_the_whole_transfer_function(shape):
    """even_filter must place the quadrant right for even and odd sizes."""
    pitch, distance = 1e-6, 50e-6
    field = np.random.default_rng(0).normal(size=shape) + 0j
    fy, fx = (np.fft.fftfreq(n, pitch) for n in shape)
    root = np.sqrt(1 - WAVELENGTH_M**2 * (fy[:, None] ** 2 + fx[None, :] ** 2))
    whole = np.exp(2j * np.pi / WAVELENGTH_M * distance * (root - 1))
    quadrant = Transfer(shape, pitch, WAVELENGTH_M, like=field).quadrant(distance)
    filtered = even_filter(field, shape, quadrant.__getitem__)
    np.testing.assert_allclose(filtered, ifft2(fft2(field) * whole), atol=1e-9)


def test_pixel_kernel_equals_the_direct_sum_over_the_subdivided_staircase():
    """The field behind a staircase of random heights, all diffraction orders included.

    The truth sums Rayleigh-Sommerfeld over 12 x 12 points per mask pixel. The wavefront's curvature over a pixel adds the
    mean phase pi p^2 / (6 lambda d) = 6.6e-3 rad, which no intensity sees and which is taken out here; what may remain is
    its variation with angle and the sum's own midpoint rule, (pi sin(theta) p / 12 lambda)^2 / 6 = 1e-3.
    """
    pitch, distance, samples, sub = 2e-6, 0.6e-3, 48, 12
    rng = np.random.default_rng(3)
    mask = np.exp(2j * np.pi * rng.uniform(size=(samples, samples)))
    reach = kernel_reach_m(pitch, WAVELENGTH_M, distance)
    margin = int(np.ceil(reach / pitch))
    size = 2 * ((samples + 2 * margin) // 2 + 1)
    padded = np.zeros((size, size), complex)
    padded[:samples, :samples] = mask
    quadrant = PixelKernel((size, size), pitch, WAVELENGTH_M, reach, like=padded).quadrant(distance)(slice(None))
    field = even_filter(padded, padded.shape, quadrant.__getitem__)[:samples, :samples]
    fine = np.kron(mask, np.ones((sub, sub)))
    rows, columns = rng.integers(0, samples, (2, 12))
    x = _grid(samples, pitch)
    truth = rayleigh_sommerfeld(fine, pitch / sub, WAVELENGTH_M, distance, np.stack([x[columns], x[rows]], 1)) * np.exp(
        -2j * np.pi / WAVELENGTH_M * distance
    )
    curvature = np.exp(1j * np.pi * pitch**2 / (6 * WAVELENGTH_M * distance))
    error = np.linalg.norm(field[rows, columns] * curvature - truth) / np.linalg.norm(truth)
    assert error < 2e-3
    # Sampling the staircase at its pixel centres is far off: without the kernel this test would fail.
    naive = angular_spectrum(np.pad(mask, margin), pitch, WAVELENGTH_M, distance)[rows + margin, columns + margin]
    assert np.linalg.norm(naive - truth) / np.linalg.norm(truth) > 0.1


def test_bad_arguments_name_themselves():
    field = np.ones((8, 8), complex)
    for arguments, name in (
        ((field.real, 2e-6, 532e-9, 1e-3), "field"),
        ((field, 2.0, 532e-9, 1e-3), "pitch_m"),
        ((field, 2e-6, 532, 1e-3), "wavelength_m"),
        ((field, 2e-6, 532e-9, -1e-3), "distance_m"),
        ((field, 2e-6, 532e-9, float("nan")), "distance_m"),
    ):
        with pytest.raises(InputError, match=name):
            angular_spectrum(*arguments)


def _dot_product_gap(there, back, shape, dtype, rng):
    """|<A u, v> - <u, A* v>| of random fields, relative to their norms."""
    u, v = ((rng.normal(size=shape) + 1j * rng.normal(size=shape)).astype(dtype) for _ in range(2))
    left, right = np.vdot(there(u), v), np.vdot(u, back(v))
    return abs(left - right) / (np.linalg.norm(u) * np.linalg.norm(v))


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.complex128, 1e-12), (np.complex64, 1e-5)])
@pytest.mark.parametrize("shape", [(32, 40), (31, 45), (2, 17, 24)])
@pytest.mark.parametrize(("pitch_m", "distance_m"), [(2e-6, 1e-4), (2e-6, 2e-3), (0.4e-6, 5e-5)])
def test_angular_spectrum_has_its_adjoint(shape, pitch_m, distance_m, dtype, tolerance):
    """Whether all light stays inside, or the band is limited by travel or by steep waves."""
    lengths = pitch_m, WAVELENGTH_M, distance_m
    gap = _dot_product_gap(
        lambda field: angular_spectrum(field, *lengths),
        lambda field: angular_spectrum_adjoint(field, *lengths),
        shape,
        dtype,
        np.random.default_rng(4),
    )
    assert gap < tolerance


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.complex128, 1e-12), (np.complex64, 1e-5)])
def test_the_conjugate_transfer_function_is_the_adjoint_through_layers_too(dtype, tolerance):
    """Air and glass on an odd padded grid, with a band limit."""
    shape, padded, layers = (21, 30), (45, 64), ((1e-4, 1.0), (2e-4, 1.46))
    there = Transfer(padded, 2e-6, WAVELENGTH_M, like=np.empty(0, dtype)).quadrant(layers, (40e-6, 60e-6))
    gap = _dot_product_gap(
        lambda field: even_filter(field, padded, there.__getitem__),
        lambda field: even_filter(field, padded, there.conj().__getitem__),
        shape,
        dtype,
        np.random.default_rng(4),
    )
    assert gap < tolerance
