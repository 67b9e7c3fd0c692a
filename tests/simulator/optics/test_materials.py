"""Refractive indices against published values and the public database beside the checkout."""

import numpy as np
import pytest
import yaml

from simulator.errors import InputError
from simulator.optics.materials import FUSED_SILICA, MATERIALS, PHLATCAM_RESIST, load_material


@pytest.mark.parametrize(
    ("wavelength_nm", "index", "digits"),
    [(587.5618, 1.45846, 5), (532.0, 1.46071, 5), (656.2725, 1.45637, 5), (486.1327, 1.46313, 5), (1064.0, 1.44963, 5)],
)
def test_fused_silica_is_malitsons(wavelength_nm, index, digits):
    """The index at the helium d, hydrogen C and F lines and two lasers, as makers of fused silica publish it."""
    assert FUSED_SILICA.index(wavelength_nm * 1e-9) == pytest.approx(index, abs=0.6 * 10**-digits)


def test_fused_silica_has_the_published_abbe_number():
    d, f, c = (FUSED_SILICA.index(w) for w in (587.5618e-9, 486.1327e-9, 656.2725e-9))
    assert (d - 1) / (f - c) == pytest.approx(67.8, abs=0.1)


def test_the_resist_has_its_only_published_value():
    assert PHLATCAM_RESIST.index(532e-9) - 1 == pytest.approx(0.5103, abs=1e-15)
    assert "nominal" in PHLATCAM_RESIST.source


def test_the_resists_dispersion_is_normal():
    """The index falls with the wavelength: 4 to 10 % of n - 1 from 400 to 700 nm for clear polymers' Abbe numbers."""
    index = [PHLATCAM_RESIST.index(w) for w in np.linspace(400e-9, 700e-9, 31)]
    assert np.all(np.diff(index) < 0)
    assert 0.04 < (index[0] - index[-1]) / 0.5103 < 0.10


def _formula(path):
    entry = yaml.safe_load(path.read_text(encoding="utf-8"))["DATA"][0]
    low, high = map(float, entry["wavelength_range"].split())
    return entry["type"], [float(c) for c in entry["coefficients"].split()], low, high


@pytest.mark.shared
def test_fused_silica_equals_the_database(shared_data):
    """Formula 1 of refractiveindex.info: n^2 - 1 = C1 + sum C_2i l^2 / (l^2 - C_2i+1^2)."""
    path = shared_data / "refractive_index/database/data/main/SiO2/nk/Malitson.yml"
    kind, c, low, high = _formula(path)
    assert kind == "formula 1"
    for um in np.linspace(low + 1e-9, high - 1e-9, 50):
        squared = 1 + c[0] + sum(b * um**2 / (um**2 - k**2) for b, k in zip(c[1::2], c[2::2], strict=True))
        assert FUSED_SILICA.index(um * 1e-6) == pytest.approx(np.sqrt(squared), abs=1e-12)


@pytest.mark.shared
def test_the_resists_dispersion_is_su8_rescaled(shared_data):
    """Formula 5: n = C1 + sum C_2i l^C_2i+1; one factor on n - 1 brings it to the anchor."""
    path = shared_data / "refractive_index/database/data/other/resists/Microchem SU-8 2000/nk/specs.yml"
    kind, c, low, high = _formula(path)
    assert kind == "formula 5"

    def su8(um):
        return c[0] + sum(a * um**power for a, power in zip(c[1::2], c[2::2], strict=True))

    factor = 0.5103 / (su8(0.532) - 1)
    for um in np.linspace(low + 1e-9, high - 1e-9, 20):
        assert PHLATCAM_RESIST.index(um * 1e-6) == pytest.approx(1 + factor * (su8(um) - 1), abs=1e-12)


@pytest.mark.parametrize("wavelength_m", [0.1e-6, 7e-6, 532.0, 0.0, float("nan")])
def test_wavelengths_outside_the_fit_are_refused(wavelength_m):
    with pytest.raises(InputError, match=r"is known from 2\.1e-07 to 6\.7e-06 m"):
        FUSED_SILICA.index(wavelength_m)


def test_materials_are_found_by_name():
    assert load_material("fused-silica") is FUSED_SILICA
    assert all(load_material(name).name == name for name in MATERIALS)
    with pytest.raises(InputError, match=r"got 'glass', expected one of fused-silica, phlatcam-resist"):
        load_material("glass")
