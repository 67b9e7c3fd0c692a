"""Pixel integration and cubic interpolation against closed forms."""

import numpy as np
import pytest
import torch

from simulator.optics.resample import Band, box_integral, cubic_interpolation


def _stairs_integral(samples, pitch, origin, low, high):
    """Integrate the piecewise constant function whose cell i spans (i - 1/2 .. i + 1/2 - origin) pitch, cell by cell."""
    total = 0.0
    for i, value in enumerate(samples):
        left, right = (i - origin - 0.5) * pitch, (i - origin + 0.5) * pitch
        total += value * max(0.0, min(high, right) - max(low, left))
    return total


@pytest.mark.parametrize(
    ("origin", "width", "centres"),
    [
        (4.5, 0.9, np.linspace(-3, 3, 9)),  # narrower than a cell
        (4.5, 3.3, np.linspace(-14, 14, 23)),  # wider, many off the grid
        (2.0, 2.0, np.arange(-20.0, 21.0, 2.0)),  # edges on cell edges
        (0.0, 100.0, np.array([0.0])),  # one box around everything
        (4.5, 1.7, np.array([-200.0, 0.3, 900.0])),  # far apart
        (4.5, 2.2, np.array([500.0])),  # nothing but air
    ],
)
def test_box_integral_equals_the_cell_by_cell_sum(origin, width, centres):
    pitch, samples = 1.1, np.random.default_rng(0).random(10)
    band = box_integral(origin, pitch, centres, width)
    expected = [_stairs_integral(samples, pitch, origin, c - width / 2, c + width / 2) for c in centres]
    np.testing.assert_allclose(band.apply(samples[None], -1)[0], expected, atol=1e-12)
    np.testing.assert_allclose(band.apply(samples[:, None], -2)[:, 0], expected, atol=1e-12)


@pytest.mark.parametrize("axis", [-1, -2])
def test_a_band_is_its_matrix_on_numpy_and_torch(axis):
    """Also when its reach begins before and ends behind the input, and for more outputs than one tile."""
    rng = np.random.default_rng(0)
    first = np.sort(rng.integers(-8, 30, 45))
    weights = rng.standard_normal((45, 5))
    matrix = np.zeros((45, 25))
    for j in range(45):
        for b in range(5):
            if 0 <= first[j] + b < 25:
                matrix[j, first[j] + b] += weights[j, b]
    array = rng.standard_normal((2, 25, 25))
    expected = array @ matrix.T if axis == -1 else matrix @ array
    band = Band(first, weights)
    np.testing.assert_allclose(band.apply(array, axis), expected, atol=1e-12)
    np.testing.assert_allclose(band.apply(torch.tensor(array), axis).numpy(), expected, atol=1e-12)


def test_precision_is_the_inputs():
    band = box_integral(2.0, 1.0, np.array([0.0]), 1.5)
    assert band.apply(np.ones((1, 5), np.float32), -1).dtype == np.float32
    assert band.apply(np.ones((1, 5)), -1).dtype == np.float64


@pytest.mark.parametrize("factor", [2, 3, 4])
def test_cubic_interpolation_is_exact_on_quadratics(factor):
    """Keys' kernel reproduces polynomials of second degree wherever it has four neighbours."""
    length = 12
    x, fine = np.arange(length), (np.arange(length * factor) + 0.5) / factor - 0.5
    got = cubic_interpolation(length, factor).apply((0.3 * x**2 - 2 * x + 1.0)[None], -1)[0]
    inner = (fine >= 1) & (fine <= length - 2)
    assert inner.sum() > factor * (length - 4)
    np.testing.assert_allclose(got[inner], (0.3 * fine**2 - 2 * fine + 1)[inner], atol=1e-12)


@pytest.mark.parametrize("length", [1, 2, 3, 4, 7])
def test_cubic_interpolation_keeps_constants_to_the_border(length):
    got = cubic_interpolation(length, 3).apply(np.full((1, length), 1.7), -1)
    assert got.shape == (1, 3 * length)
    np.testing.assert_allclose(got, 1.7, atol=1e-12)


def test_cubic_interpolation_goes_through_the_samples():
    """With an odd factor the middle fine sample lies on the coarse one."""
    samples = np.random.default_rng(0).random((1, 9))
    np.testing.assert_allclose(cubic_interpolation(9, 3).apply(samples, -1)[:, 1::3], samples, atol=1e-12)


def test_cubic_interpolation_is_symmetric():
    samples = np.random.default_rng(0).random((1, 9))
    band = cubic_interpolation(9, 4)
    np.testing.assert_allclose(band.apply(samples[:, ::-1], -1), band.apply(samples, -1)[:, ::-1], atol=1e-12)
