"""Random lenslets: the envelope of their caps, foci at their centres, and the spot of a single one."""

import numpy as np
import pytest

from psf_library.designs.random_lenslets import lenslets, random_lenslets
from simulator.optics.rayleigh_sommerfeld import rayleigh_sommerfeld

GREEN, F = 532e-9, 1.9e-3


def test_one_lenslet_has_the_spot_of_its_square_aperture():
    """sinc^2(W x / (lambda f)) around its centre, as bright as (W^2 / (lambda f))^2.

    A cap's spherical aberration, r^3 (n - 1) / (2 R^3) = 4e-5 of slope at 50 um, moves the spot by 0.1 um: 2 %.
    """
    width = 0.1e-3
    (centre,), (focal,) = lenslets(width, 0.2e-3, F, None, seed=1)
    mask = random_lenslets(width_mm=0.1, spacing_um=200, pixel_um=1.0)
    assert focal == pytest.approx(F)
    x = np.linspace(-15e-6, 15e-6, 31)
    field = np.asarray(mask.transmission(GREEN), np.complex128)
    for along in (np.array([1.0, 0.0]), np.array([0.0, 1.0])):
        light = np.abs(rayleigh_sommerfeld(field, mask.pitch_m, GREEN, F, centre + x[:, None] * along)) ** 2
        expected = (width**2 / (GREEN * F) * np.sinc(width * x / (GREEN * F))) ** 2
        np.testing.assert_allclose(light, expected, atol=0.02 * expected.max())


def test_every_lenslet_makes_its_dot(psf_at_infinity):
    """The brightest pixel near each centre that is not at the border lies within one 4 um pixel of it."""
    mask = random_lenslets(width_mm=1.2)
    centres, _ = lenslets(1.2e-3, 160e-6, F, None, seed=1)
    psf = psf_at_infinity(mask, F, 4e-6)
    inner = centres[np.all(np.abs(centres) < 0.5e-3, axis=1)]
    assert len(inner) > 15
    for x, y in inner / 4e-6 + len(psf) // 2:
        row, column = round(y), round(x)
        near = psf[row - 9 : row + 10, column - 9 : column + 10]
        peak = np.unravel_index(np.argmax(near), near.shape)
        assert max(abs(peak[0] - 9), abs(peak[1] - 9)) <= 1
        assert near.max() > 20 * np.median(psf[psf > 0])


@pytest.mark.parametrize("nearest_cm", [None, 1.0])
def test_the_surface_is_the_upper_envelope_of_spherical_caps(nearest_cm):
    """Against all caps everywhere; heights of float32."""
    mask = random_lenslets(width_mm=0.8, pixel_um=4.0, nearest_cm=nearest_cm)
    centres, focal = lenslets(0.8e-3, 160e-6, F, nearest_cm, seed=1)
    radius = focal[:, None, None] * (mask.material.index(GREEN) - 1)
    x = (np.arange(200) - 99.5) * 4e-6
    r_squared = (x[:, None] - centres[:, 1, None, None]) ** 2 + (x[None, :] - centres[:, 0, None, None]) ** 2
    surface = (np.sqrt(np.clip(radius**2 - r_squared, 0, None)) - radius).max(0)
    np.testing.assert_allclose(mask.height_m, surface - surface.min(), atol=1e-6 * np.ptp(surface))


def test_focal_lengths_are_spread_evenly_in_disparity():
    """1/f - 1/d from 0 to 1/nearest, whatever the place."""
    _, focal = lenslets(3e-3, 160e-6, F, 1.0, seed=2)
    disparity = np.sort(1 / focal - 1 / F) * 1e-2
    expected = (np.arange(len(focal)) + 0.5) / len(focal)
    np.testing.assert_allclose(disparity, expected, atol=1e-9)
    assert np.all(lenslets(3e-3, 160e-6, F, None, seed=2)[1] == pytest.approx(F))


def test_a_multifocal_mask_keeps_sharp_dots_at_a_finite_depth():
    """Of two lenslets, that of the depth's own focal length is brighter in step than one focused at infinity.

    A source at z = 1 cm: the brightest dots of a mask with lenslets for 1 cm beat those of a mask without.
    """
    points_z = 1e-2
    peaks = []
    for nearest in (None, 1.0):
        mask = random_lenslets(width_mm=0.8, nearest_cm=nearest)
        centres, focal = lenslets(0.8e-3, 160e-6, F, nearest, seed=1)
        x = (np.arange(400) - 199.5) * 2e-6
        source = np.exp(1j * np.pi * (x[:, None] ** 2 + x[None, :] ** 2) / (GREEN * points_z))
        best = np.argsort(focal)[:3]  # the strongest lenslets, for the nearest depth
        shadow = centres[best] * (1 + F / points_z)  # where the chief rays of their centres go
        field = np.asarray(mask.transmission(GREEN), np.complex128) * source
        peaks.append((np.abs(rayleigh_sommerfeld(field, mask.pitch_m, GREEN, F, shadow)) ** 2).mean())
    assert peaks[1] > 1.5 * peaks[0]
