"""The vortex: a helix of whole turns, a dark axis, and the doughnut of its Hankel transform."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.special import jv

from psf_library.designs.lens import lens
from psf_library.designs.vortex import vortex
from simulator.optics.rayleigh_sommerfeld import rayleigh_sommerfeld

GREEN, F = 532e-9, 1.9e-3


def _light(mask, distance_m, points):
    """Intensity by the direct sum; three samples per pixel and axis stand for the staircase."""
    field = np.asarray(mask.transmission(GREEN, 3), np.complex128)
    return np.abs(rayleigh_sommerfeld(field, mask.pitch_m / 3, GREEN, distance_m, np.asarray(points))) ** 2


@pytest.mark.parametrize("charge", [1, 3, -6])
@pytest.mark.parametrize("distance_m", [0.5e-3, F])
def test_the_axis_is_dark_at_every_depth(charge, distance_m):
    """A quarter turn multiplies the field by i^charge, so its four parts cancel on the axis unless 4 divides the charge."""
    mask = vortex(charge=charge, width_mm=0.16)
    field = np.asarray(mask.transmission(GREEN), np.complex128)
    # rot90 brings to each place what lies a quarter turn further clockwise, and the helix winds clockwise (y points down).
    np.testing.assert_allclose(np.rot90(field), field * 1j**charge, atol=2e-5)  # float32 heights of one wave
    axis, ring = _light(mask, distance_m, [[0.0, 0.0]])[0], _light(mask, distance_m, [[5e-6, 3e-6], [-10e-6, 4e-6]])
    assert axis < 1e-8 * ring.max()


def _ring(charge, width_m, radius_m):
    """|int J_l(k rho r / f) rho drho|^2: the paraxial doughnut."""
    scale = 2 * np.pi / (GREEN * F) * radius_m
    return quad(lambda rho: jv(charge, scale * rho) * rho, 0, width_m / 2, epsrel=1e-8, limit=200)[0] ** 2


def test_the_doughnut_is_a_hankel_transform():
    """For the first ring and around it: paraxial at f/6, and light that square pixels of 1 um dim at the rim by 2 %."""
    mask = vortex(charge=4, width_mm=0.3, pixel_um=1.0)
    r = np.linspace(0.5e-6, 15e-6, 24)
    light = _light(mask, F, np.stack([r, np.zeros_like(r)], -1))
    expected = np.array([_ring(4, 0.3e-3, radius) for radius in r])
    np.testing.assert_allclose(light / light.max(), expected / expected.max(), atol=0.03)


@pytest.mark.slow
def test_the_default_ring_is_where_its_hankel_transform_is_brightest(psf_at_infinity):
    """To one pixel of 2.4 um; it lies outside the caustic charge lambda f / (pi width) by about a quarter."""
    psf = psf_at_infinity(vortex(), F, 2.4e-6)
    y, x = np.indices(psf.shape) - len(psf) // 2
    radius = np.rint(np.hypot(x, y)).astype(int)
    rings = np.bincount(radius.ravel(), psf.ravel()) / np.bincount(radius.ravel())
    expected = np.argmax([_ring(24, 0.3e-3, r * 2.4e-6) for r in range(30)])
    assert abs(np.argmax(rings) - expected) <= 1
    assert expected * 2.4e-6 == pytest.approx(1.25 * 24 * GREEN * F / (np.pi * 0.3e-3), rel=0.1)
    assert rings[: expected // 2].max() < 0.02 * rings.max()


def test_the_sign_is_the_sense_of_rotation():
    np.testing.assert_allclose(
        vortex(charge=-5).transmission(GREEN), vortex(charge=5).transmission(GREEN)[::-1], atol=2e-5
    )
    steps = np.angle(vortex(charge=1, distance_um=None).transmission(GREEN)[[75, 149, 74, 0], [149, 75, 0, 74]])
    assert np.all(np.diff(np.unwrap(steps)) > 0)  # right, down, left, up: clockwise from behind the sensor


def test_without_charge_it_is_the_wrapped_lens():
    plain, wrapped = vortex(charge=0), lens(width_mm=0.3, pixel_um=2.0, wrap=True)
    assert plain.digest() == wrapped.digest()
