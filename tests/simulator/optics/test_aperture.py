"""Round apertures: their area, their symmetry, and samples that are whole where the circle does not pass."""

import numpy as np
import pytest

from simulator.design.patterns import radius_squared_m2, round_aperture, sample_positions_m


@pytest.mark.parametrize(("samples", "diameter"), [(40, 40.0), (41, 30.4), (200, 150.7), (31, 31.0)])
def test_the_area_is_the_circle_s(samples, diameter):
    """Rim samples are counted in 256 parts: the errors of some hundred of them average to 1e-3 of the area."""
    assert float(round_aperture(samples, diameter).sum()) == pytest.approx(np.pi / 4 * diameter**2, rel=1e-3)


def test_it_is_round_and_centred():
    coverage = round_aperture(41, 30.4)
    for other in (coverage[::-1], coverage[:, ::-1], coverage.T):
        np.testing.assert_array_equal(coverage, other)
    away = np.sqrt(radius_squared_m2(41, 1.0))
    assert np.all(coverage[away < 15.2 - 0.71] == 1)
    assert np.all(coverage[away > 15.2 + 0.71] == 0)
    rim = (away > 15.2 - 0.2) & (away < 15.2 + 0.2)
    assert np.all((coverage[rim] > 0.2) & (coverage[rim] < 0.8))


def test_positions_are_centred():
    np.testing.assert_allclose(sample_positions_m(4, 2e-6), [-3e-6, -1e-6, 1e-6, 3e-6])
    np.testing.assert_allclose(radius_squared_m2(3, 1.0)[0], [2, 1, 2])
