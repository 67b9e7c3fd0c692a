"""Figures of merit against closed forms: Gaussians, single pixels, shifted copies."""

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.special import erf

from simulator.errors import InputError
from simulator.optics.metrics import autocorrelation_peak, depth_correlations, distinct_depths, mean_mtf
from simulator.optics.stack import PsfStack


def _gaussian(rows: float, columns: float, size: int = 121) -> np.ndarray:
    at = np.arange(size) - size // 2
    return np.exp(-(at[:, None] ** 2) / (2 * rows**2) - at[None, :] ** 2 / (2 * columns**2))


def _stack(planes: np.ndarray) -> PsfStack:
    return PsfStack(planes[:, None], np.arange(1.0, 1 + len(planes)), 1e-5, ("Y",), "test")


# --- autocorrelation


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


def test_a_pedestal_is_a_sidelobe() -> None:
    """A bright pixel on a wide square of n^2 pixels of height h.

    The peak is between one and sqrt(2) pixels wide, so the diagonal neighbour is the first sidelobe: the square overlaps
    with itself on (n - 1)^2 pixels, and the bright pixel meets the square twice.
    """
    n, h = 60, 0.01
    image = np.pad(np.full((n, n), h), 5)
    image[35, 35] += 1
    peak = autocorrelation_peak(image, 1.0)
    total = np.sum(image**2)
    assert peak.sidelobe == pytest.approx(((n - 1) ** 2 * h**2 + 2 * h) / total, rel=1e-9)


def test_the_pitch_scales_the_width_alone() -> None:
    image = np.random.default_rng(0).random((20, 23)) ** 8
    one, other = autocorrelation_peak(image, 1e-6), autocorrelation_peak(image, 3e-6)
    assert other.width_m == pytest.approx(3 * one.width_m)
    assert other.sidelobe == one.sidelobe


def test_an_image_of_zeros_has_no_peak() -> None:
    with pytest.raises(InputError, match="image"):
        autocorrelation_peak(np.zeros((4, 4)), 1e-6)


# --- MTF


def test_mean_mtf_of_a_gaussian() -> None:
    """The mean of exp(-2 (pi s f)^2) up to the last ring, 60 / 121: an error function; rings average to 1e-3."""
    sigma, last = 1.5, 60 / 121
    expected = erf(np.sqrt(2) * np.pi * sigma * last) / (2 * np.sqrt(2 * np.pi) * sigma * last)
    assert mean_mtf(_gaussian(sigma, sigma), 1.0) == pytest.approx(expected, abs=1e-3)


def test_mean_mtf_has_no_unit() -> None:
    image = np.random.default_rng(0).random((20, 23))
    assert mean_mtf(image, 1e-6) == pytest.approx(mean_mtf(image, 5e-6), rel=1e-12)


# --- depths


def test_identical_depths_are_one_depth() -> None:
    image = np.random.default_rng(0).random((9, 9))
    correlations = depth_correlations(_stack(np.stack([image, 2 * image, 0.1 * image])))
    np.testing.assert_allclose(correlations, 1, atol=1e-12)
    assert distinct_depths(correlations) == pytest.approx(1)


def test_depths_without_common_pixels_are_all_distinct() -> None:
    planes = np.zeros((4, 6, 6))
    for k in range(4):
        planes[k, k, 1:3] = k + 1
    correlations = depth_correlations(_stack(planes))
    np.testing.assert_allclose(correlations, np.eye(4), atol=1e-15)
    assert distinct_depths(correlations) == pytest.approx(4)


def test_shifted_gaussians_correlate_as_their_autocorrelation() -> None:
    """C = exp(-s^2 / 4 sigma^2); at sigma = 5 samples sums equal integrals far below 1e-10."""
    image = _gaussian(5, 5)
    planes = np.stack([np.roll(image, shift, axis=1) for shift in (0, 4, 10)])
    shifts = np.array([[0, 4, 10], [4, 0, 6], [10, 6, 0]])
    np.testing.assert_allclose(depth_correlations(_stack(planes)), np.exp(-(shifts**2) / 100), atol=1e-10)


def test_channels_count_together() -> None:
    """Equal in one of two channels of one energy, disjoint in the other: half."""
    values = np.zeros((2, 2, 4, 4))
    values[:, 0, 1, 1] = 1
    values[0, 1, 2, 2] = values[1, 1, 3, 3] = 1
    stack = PsfStack(values, np.array([1.0, 2.0]), 1e-5, ("R", "G"), "test")
    np.testing.assert_allclose(depth_correlations(stack), [[1, 0.5], [0.5, 1]], atol=1e-15)
