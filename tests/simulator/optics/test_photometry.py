"""Lux to electrons against numbers worked out by hand."""

import numpy as np
import pytest

from simulator.errors import InputError
from simulator.optics.spectra import Led, camera_curves, electron_rates

H, C = 6.62607015e-34, 299792458.0


@pytest.fixture
def flat(tmp_path):
    """Name of a sensor that counts a share of all photons from 360 to 830 nm, and its folder."""
    (tmp_path / "flat.csv").write_text("360,0.25\n830,0.25\n")
    return "flat.csv", tmp_path


def test_a_lux_of_555_nm_is_four_quadrillion_photons(flat):
    """1 lux of 555 nm is 1/683 W/m2, 4.09e15 photons per second and square metre; a steradian of white gets 1/pi of them."""
    rates = electron_rates(flat[0], (Led(555e-9, 1e-9),), flat[1])
    # The peak is scaled to 1; V falls by 2e-4 within the line's width.
    assert rates == pytest.approx({"Y": 555e-9 / (H * C) / 683 / np.pi}, rel=1e-3)
    assert rates["Y"] * np.pi == pytest.approx(4.09e15, rel=1e-3)


@pytest.mark.parametrize(("led_nm", "efficiency"), [(480, 0.13902), (510, 0.503), (620, 0.381)])
def test_a_line_counts_by_the_eyes_efficiency_and_the_sensors(led_nm, efficiency):
    """V as CIE 018:2019 tables it; the response of a named camera at that wavelength."""
    rates = electron_rates("Nikon 5100 (NPL)", (Led(led_nm * 1e-9, 1e-9),))
    curves = camera_curves("Nikon 5100 (NPL)")
    at = int(np.argmin(np.abs(curves.wavelengths_m - led_nm * 1e-9)))
    expected = 1 / (683 * efficiency) / np.pi * led_nm * 1e-9 / (H * C) * curves.values[:, at] / curves.values.max()
    # Curves bend within the 1 nm of the line.
    assert list(rates.values()) == pytest.approx(expected.tolist(), rel=2e-3)


def test_equal_energy_has_the_eyes_known_integral(flat):
    """The integral of V is 106.857 nm (CIE); that of l / hc from 360 to 830 nm is a parabola."""
    photons_nm = 1e-9 * (830**2 - 360**2) / 2 / (H * C)
    rates = electron_rates(flat[0], "E", flat[1])
    # Sums of 1 nm against integrals.
    assert rates["Y"] == pytest.approx(photons_nm / (683 * 106.857) / np.pi, rel=1e-5)


def test_invisible_light_has_no_lux(flat):
    (flat[1] / "uv.csv").write_text("250,1\n830,1\n")
    with pytest.raises(InputError, match="LED 300 nm"):
        electron_rates("uv.csv", (Led(300e-9, 5e-9),), flat[1])
