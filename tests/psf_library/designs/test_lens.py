"""The lens focuses where, as tightly and as brightly as diffraction allows; judged by direct Rayleigh-Sommerfeld sums."""

import numpy as np
import pytest
from scipy.special import j1

from psf_library.designs.lens import lens
from simulator.optics.materials import FUSED_SILICA
from simulator.optics.rayleigh_sommerfeld import rayleigh_sommerfeld

GREEN, F = 532e-9, 1.9e-3


def _axis_and_line(mask, wavelength_m, distance_m, x_m):
    points = np.stack([x_m, np.zeros_like(x_m)], -1)
    field = np.asarray(mask.transmission(wavelength_m), np.complex128)
    return np.abs(rayleigh_sommerfeld(field, mask.pitch_m, wavelength_m, distance_m, points)) ** 2


def _brightest(mask, wavelength_m, distances_m):
    """The distance of the greatest intensity on the axis, by a parabola through the largest sample and its neighbours."""
    axis = np.array([_axis_and_line(mask, wavelength_m, d, np.zeros(1))[0] for d in distances_m])
    middle = int(np.argmax(axis))
    a, b, _ = np.polyfit(distances_m[middle - 1 : middle + 2], axis[middle - 1 : middle + 2], 2)
    return -b / (2 * a)


def test_the_focus_is_an_airy_pattern():
    """(2 J1(v) / v)^2, v = pi x D / (lambda f); at f/4.75 the paraxial formula is good to 1 % of the peak."""
    mask = lens()
    x = np.concatenate([np.linspace(0, 8e-6, 17), [1.2197 * GREEN * F / 0.4e-3]])
    light = _axis_and_line(mask, GREEN, F, x)
    v = np.pi * np.clip(x, 1e-12, None) * 0.4e-3 / (GREEN * F)
    np.testing.assert_allclose(light / light[0], (2 * j1(v) / v) ** 2, atol=0.01)
    assert light[-1] < 1e-3 * light[0]  # the first dark ring


def test_its_strehl_ratio_is_one():
    """On the axis all contributions arrive in step: |sum| / sum of moduli, kernel f / (lambda R^2)."""
    mask = lens()
    x = (np.arange(400) - 199.5) * 1e-6
    r_squared = x[:, None] ** 2 + x[None, :] ** 2 + F**2
    in_step = np.sum(np.asarray(mask.amplitude, float) * F / (GREEN * r_squared)) * 1e-12
    assert _axis_and_line(mask, GREEN, F, np.zeros(1))[0] == pytest.approx(in_step**2, rel=1e-3)


def test_it_focuses_at_its_focal_length():
    """The brightest point lies inside the focus by 12 / (pi N)^2 of f (Li and Wolf 1981, N = a^2 / lambda f = 40): 0.08 %."""
    around = F * np.linspace(0.98, 1.02, 9)
    shift = 12 / (np.pi * (0.2e-3**2 / (GREEN * F))) ** 2
    assert _brightest(lens(), GREEN, around) == pytest.approx(F * (1 - shift), rel=5e-4)


@pytest.mark.parametrize(
    ("wrap", "at"),
    [
        (False, (FUSED_SILICA.index(GREEN) - 1) / (FUSED_SILICA.index(450e-9) - 1)),  # refraction: blue a little nearer
        (True, 532 / 450),  # diffraction: blue farther
    ],
)
def test_other_colours_focus_elsewhere(wrap, at):
    mask = lens(wrap=wrap)
    found = _brightest(mask, 450e-9, F * at * np.linspace(0.98, 1.02, 9))
    assert found == pytest.approx(F * at, rel=2e-3)  # measured 5e-4 and 8e-4


def test_profiles_and_heights():
    smooth, wrapped = lens(), lens(wrap=True)
    assert (smooth.profile, wrapped.profile) == ("smooth", "staircase")
    one_wave_m = GREEN / (FUSED_SILICA.index(GREEN) - 1)
    assert 0.99 * one_wave_m < wrapped.height_m.max() <= one_wave_m * 1.0001
    # The thin lens's sag is D^2 / (8 f (n - 1)), up to (D / 4 f)^2 = 3e-3; the grid's corners are lower by as much again.
    assert np.ptp(smooth.height_m) == pytest.approx(2 * 0.4e-3**2 / (8 * F * (one_wave_m**-1 * GREEN)), rel=0.02)
    assert smooth.transmitted_area_m2 == pytest.approx(np.pi / 4 * 0.4e-3**2, rel=5e-3)


@pytest.mark.parametrize("wrap", [False, True])
def test_its_psf_is_symmetric_to_rounding(psf_at_infinity, wrap):
    mask = lens(width_mm=0.2, pixel_um=2.0, wrap=wrap)
    psf = psf_at_infinity(mask, F, 4e-6)
    for other in (psf[::-1], psf[:, ::-1], psf.T):
        np.testing.assert_allclose(psf, other, atol=2e-6 * psf.max())
