"""The Fresnel zone aperture: its rings, the fringe scan, and the focus of a zone plate."""

import numpy as np
import pytest

from psf_library.designs.fresnel_zone import fresnel_zone
from simulator.optics.rayleigh_sommerfeld import rayleigh_sommerfeld

GREEN = 532e-9


def test_the_rings_lie_where_the_cosine_changes_its_sign():
    """Beta r^2 + phase = pi / 2 + n pi with beta = pi / r_1^2: r^2 = (n + 1/2 - phase / pi) r_1^2; to a quarter sample."""
    for phase, first in ((0, 0.5), (90, 1.0)):
        mask = fresnel_zone(first_zone_um=200, phase_degrees=phase)
        line = np.asarray(mask.amplitude, float)[600, 600:]  # a row half a sample off the axis
        x = (np.arange(600) + 0.5) * 2.0
        crossings = np.flatnonzero((line[1:] > 0.5) != (line[:-1] > 0.5))
        at = [np.interp(0.5, np.sort(line[i : i + 2]), x[i : i + 2][np.argsort(line[i : i + 2])]) for i in crossings]
        expected = 200 * np.sqrt(np.arange(len(at)) + first)
        np.testing.assert_allclose(at, expected, atol=0.5)


@pytest.mark.parametrize("binary", [True, False])
def test_opposite_phases_fill_each_other_s_gaps(binary):
    """Fringe scan: the light through phases 0 and 180, and through 90 and 270, is all the light."""
    masks = [fresnel_zone(phase_degrees=phase, binary=binary).amplitude for phase in (0, 180, 90, 270)]
    power = 1 if binary else 2  # binary rims hold shares of area, the grey ones are means of an amplitude
    tolerance = (
        1 / 32 if binary else 0.01
    )  # a sub-pixel in 64 on the edge itself; the mean of a square is not its square
    for a, b in (masks[:2], masks[2:]):
        np.testing.assert_allclose(a**power + b**power, 1, atol=tolerance)


def test_it_focuses_at_the_square_of_its_first_zone_over_the_wavelength():
    """F = r_1^2 / lambda = 1.9 mm; there 1/pi of the amplitude adds up: I = (width^2 / (pi lambda f))^2 to 3 %.

    The rest, in other orders, is a few units of amplitude beside 50.
    """
    mask = fresnel_zone(width_mm=0.4, pixel_um=0.5, first_zone_um=31.793)
    field = np.asarray(mask.transmission(GREEN), np.complex128)
    distances = 1.9e-3 * np.linspace(0.97, 1.03, 13)
    axis = [np.abs(rayleigh_sommerfeld(field, mask.pitch_m, GREEN, d, np.zeros((1, 2)))[0]) ** 2 for d in distances]
    middle = int(np.argmax(axis))
    a, b, _ = np.polyfit(distances[middle - 1 : middle + 2], axis[middle - 1 : middle + 2], 2)
    assert -b / (2 * a) == pytest.approx(1.9e-3, rel=5e-3)
    assert np.sqrt(max(axis)) == pytest.approx(0.4e-3**2 / (np.pi * GREEN * 1.9e-3), rel=0.03)


def test_its_default_psf_is_its_shadow(psf_at_infinity):
    """The rings of at least 85 um stay recognisable; a sensor four times farther sees diffraction instead."""
    mask = fresnel_zone(pixel_um=4.0)
    near, far = (psf_at_infinity(mask, d, 16e-6) for d in (1.9e-3, 8e-3))
    shadow = np.asarray(mask.amplitude**2).reshape(150, 4, 150, 4).mean((1, 3))

    def likeness(psf):
        middle = len(psf) // 2
        # The PSF's origin lies on a sample, the shadow's between two: the mean of four neighbours is half a pixel off.
        quad = sum(
            psf[middle - 75 + i : middle + 75 + i, middle - 75 + j : middle + 75 + j] for i in (0, 1) for j in (0, 1)
        )
        return np.corrcoef(quad.ravel(), shadow.ravel())[0, 1]

    assert likeness(near) > 0.85
    assert likeness(far) < likeness(near) - 0.2
