"""The pinhole is round, centred, and as large as asked."""

import numpy as np
import pytest

from psf_library.designs.pinhole import pinhole


@pytest.mark.parametrize(("diameter_um", "pixel_um"), [(40.0, 0.5), (30.0, 0.7), (100.0, 2.0), (25.3, 0.5)])
def test_the_pinholes_area_is_that_of_its_circle(diameter_um, pixel_um):
    """Each rim pixel counts by the part inside."""
    mask = pinhole(diameter_um=diameter_um, pixel_um=pixel_um)
    area = float(np.sum(np.asarray(mask.amplitude, float))) * mask.pitch_m**2
    assert area == pytest.approx(np.pi / 4 * (diameter_um * 1e-6) ** 2, rel=1e-3)


def test_the_pinhole_is_round_and_centred():
    amplitude = pinhole(diameter_um=30.4, pixel_um=1.0).amplitude
    assert amplitude.shape == (33, 33)
    for other in (amplitude[::-1], amplitude[:, ::-1], amplitude.T):
        np.testing.assert_array_equal(amplitude, other)
    assert np.all(amplitude[0] == 0)  # the grid holds it whole
    assert amplitude[16, 16] == 1
    away = np.hypot(*np.mgrid[-16:17, -16:17])
    assert np.all(amplitude[away < 15.2 - 0.71] == 1)
    assert np.all(amplitude[away > 15.2 + 0.71] == 0)
