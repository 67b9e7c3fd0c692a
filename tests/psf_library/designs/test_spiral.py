"""The spiral: odd symmetry of the mask, and what follows from it: a dark axis and dark lines below the edges."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from psf_library.designs.spiral import spiral
from simulator.optics.propagation import angular_spectrum
from simulator.optics.rayleigh_sommerfeld import rayleigh_sommerfeld

GREEN = 532e-9


def _light(mask, wavelength_m, distance_m, points):
    field = np.asarray(mask.transmission(wavelength_m, 3), np.complex128)
    return np.abs(rayleigh_sommerfeld(field, mask.pitch_m / 3, wavelength_m, distance_m, np.asarray(points))) ** 2


def test_an_odd_number_of_arms_makes_an_odd_mask():
    """Half a wave is half a wave to the rounding of a float32 height."""
    field = spiral().transmission(GREEN)
    np.testing.assert_allclose(field[::-1, ::-1], -field, atol=1e-5)
    even = spiral(arms=6).transmission(GREEN)
    np.testing.assert_array_equal(even[::-1, ::-1], even)


@pytest.mark.parametrize("distance_m", [0.2e-3, 0.7e-3, 1.9e-3])
def test_the_axis_is_dark_at_any_distance(distance_m):
    mask = spiral(width_mm=0.5)
    assert _light(mask, GREEN, distance_m, [[0.0, 0.0]])[0] < 1e-9  # of the incident light: float32 heights
    off = _light(spiral(width_mm=0.5, arms=8), GREEN, distance_m, [[0.0, 0.0]])[0]
    assert off > 1e-4  # an even number of arms has no such axis


def _below(mask, wavelength_m, part):
    """Intensity 0.2 mm below the mask and 0.35 mm from its axis, at 18 points a ``part`` of an arm beyond each edge.

    arms (angle - cot(pitch) ln(r / pixel)) = pi (k + part), the angle from x (right) towards y (down).
    """
    radius = 0.35e-3
    angle = np.pi * (np.arange(18) + part) / 9 + np.log(radius / 2e-6)
    field = angular_spectrum(mask.transmission(wavelength_m, 2), mask.pitch_m / 2, wavelength_m, 0.2e-3)
    row, column = ((radius * f(angle)) / (mask.pitch_m / 2) + (len(field) - 1) / 2 for f in (np.sin, np.cos))
    return map_coordinates(np.abs(field) ** 2, [row, column], order=1)


def test_every_edge_casts_a_dark_line():
    """An arm is pi 0.35 mm sin(45) / 9 = 86 um wide, many times sqrt(lambda d) = 10 um.

    The edge's steps of 2 um leave a little light, most of it where an edge runs slantwise over the pixels.
    """
    mask = spiral()
    dark, bright = _below(mask, GREEN, 0.0), _below(mask, GREEN, 0.5)
    assert dark.max() < 0.05  # of the incident light
    assert bright.min() > 0.5


def test_off_the_design_wavelength_the_lines_fade_as_cos_squared():
    """At 450 nm the step is 1.19 half waves: cos^2 of half its phase, 9.0 %, passes as if there were no grating."""
    mask = spiral()
    index = mask.material.index
    half_phase = np.pi / 2 * (532 / 450) * (index(450e-9) - 1) / (index(GREEN) - 1)
    assert np.cos(half_phase) ** 2 == pytest.approx(0.09, abs=0.002)
    extra = _below(mask, 450e-9, 0.0).mean() - _below(mask, GREEN, 0.0).mean()
    assert extra == pytest.approx(np.cos(half_phase) ** 2, rel=0.1)


def test_arms_are_counted_and_widen():
    mask = spiral(width_mm=1.0, arms=7, pitch_degrees=30)
    angle = np.linspace(0, 2 * np.pi, 20000, endpoint=False)
    for radius in (60, 120, 240):  # in pixels
        row, column = (np.rint(249.5 + radius * f(angle)).astype(int) for f in (np.sin, np.cos))
        raised = mask.height_m[row, column] > 0
        turn = np.fft.rfft(np.where(raised, 1.0, -1.0)) / len(angle)
        assert abs(turn[7]) == pytest.approx(2 / np.pi, rel=0.02)  # a square wave of seven periods
        assert raised.mean() == pytest.approx(0.5, abs=0.02)
    # Along a radius an edge comes whenever ln r grows by pi tan(pitch) / arms.
    line = mask.height_m[249, 250:] > 0
    edges = np.flatnonzero(line[1:] != line[:-1]) + 1.0
    ratio = np.exp(np.pi * np.tan(np.radians(30)) / 7)
    outer = edges[edges > 30]
    np.testing.assert_allclose(outer[1:] / outer[:-1], ratio, rtol=0.06)  # a pixel at 30


def test_its_psf_is_symmetric_under_a_half_turn(psf_at_infinity):
    psf = psf_at_infinity(spiral(width_mm=0.4), 1e-3, 4e-6)
    np.testing.assert_allclose(psf, psf[::-1, ::-1], atol=1e-5 * psf.max())
    assert not np.allclose(psf, psf[::-1], atol=0.1 * psf.max())
