"""Patterns: statistics of random surfaces and places, lines along edges, round apertures."""

import numpy as np
import pytest
from scipy.ndimage import binary_dilation
from scipy.spatial import cKDTree

from simulator import arrays as memory
from simulator.design.patterns import (
    contours,
    gaussian_surface,
    perlin,
    poisson_disc,
    radius_squared_m2,
    round_aperture,
    sample_positions_m,
)
from simulator.errors import InputError


def test_perlin_noise_is_smooth_and_of_its_cell():
    noise = perlin((300, 300), 60, 1)
    assert (noise.min(), noise.max(), noise.dtype) == (0, 1, np.float32)
    assert np.abs(np.diff(noise, axis=0)).max() < 0.1  # one sample of sixty
    assert not np.array_equal(noise, perlin((300, 300), 60, 2))
    # Every lattice point is a zero of gradient noise: they all share one value, others do not.
    lattice = noise[60::60, 60::60]
    assert np.ptp(lattice) < 1e-5
    assert np.ptp(noise[30::60, 30::60]) > 0.2


def test_gaussian_surfaces_are_normalised():
    surface = gaussian_surface((200, 300), 10, 0)
    assert surface.mean() == pytest.approx(0, abs=1e-5)
    assert surface.std() == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_poisson_discs_keep_their_distance_and_leave_no_gap(seed):
    """No two nearer than 1, no place farther than 1 from a point but for half a lattice cell's diagonal (0.03)."""
    points = poisson_disc(12.0, seed)
    tree = cKDTree(points)
    assert tree.query(points, k=2)[0][:, 1].min() >= 1 - 1e-9
    places = np.stack(np.meshgrid(*[np.linspace(0, 12, 300)] * 2), -1).reshape(-1, 2)
    assert tree.query(places)[0].max() < 1.03


def test_poisson_discs_are_as_dense_as_they_get():
    """Random sequential addition covers 0.547 of the area (Feder 1980); about 600 points away from the border: 4 %."""
    points = poisson_disc(34.0, 0)
    inner = np.count_nonzero(np.all(np.abs(points - 17) < 15, axis=1))
    assert inner * np.pi / 4 / 30**2 == pytest.approx(0.547, rel=0.04)


def test_poisson_discs_follow_their_seed():
    np.testing.assert_array_equal(poisson_disc(5, 3), poisson_disc(5, 3))
    assert len(poisson_disc(0.5, 0)) == 1
    assert not np.array_equal(poisson_disc(5, 3)[0], poisson_disc(5, 4)[0])


def test_a_lattice_that_exceeds_the_memory_is_refused(monkeypatch):
    monkeypatch.setattr(memory, "machine_bytes", lambda: 10**6)
    with pytest.raises(InputError, match=r"^spacing_um: "):
        poisson_disc(100, 1)


@pytest.mark.parametrize("line", [6.0, 17.9, 18.0, 18.5, 33.0])
def test_wide_and_narrow_lines_are_discs_along_the_edges(line: float) -> None:
    """Against the plain definition, bit for bit: the distance from an edge is the root of a whole number."""
    edges = contours(300, 60, 1, 1) > 0  # a line narrower than two samples is the edge itself
    y, x = np.ogrid[-20:21, -20:21]
    expected = binary_dilation(edges, x**2 + y**2 <= (line / 2) ** 2)
    np.testing.assert_array_equal(contours(300, 60, line, 1), expected)


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
