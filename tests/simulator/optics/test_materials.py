"""Refractive indices against published values and the public database beside the checkout."""

import numpy as np
import pytest
import yaml

from simulator.errors import InputError
from simulator.optics.materials import FUSED_SILICA, MATERIALS, PHLATCAM_RESIST, load_material, material_file

D, F, C = 587.5618e-9, 486.1327e-9, 656.2725e-9  # the Fraunhofer lines of Abbe numbers

# Where each built-in material's numbers lie in the database: CC0, never copied into the repository.
PAGES = {
    "fused-silica": "main/SiO2/nk/Malitson.yml",
    "n-bk7": "specs/schott/optical/N-BK7.yml",
    "pmma": "organic/(C5H8O2)n - poly(methyl methacrylate)/nk/Beadie.yml",
    "pdms": "organic/(C2H6OSi)n - polydimethylsiloxane/nk/Schneider-Sylgard184.yml",
    "polycarbonate": "organic/(C16H14O3)n - polycarbonate/nk/Sultanova.yml",
    "noa61": "other/optical adhesives/NOA-61/nk/Norland.yml",
    "su-8": "other/resists/Microchem SU-8 3000/nk/specs.yml",
}
RESIST_PAGE = "other/resists/Microchem SU-8 2000/nk/specs.yml"


@pytest.mark.parametrize(
    ("name", "wavelength_nm", "index", "tolerance"),
    [
        # Fused silica at five lines, as its makers publish it (Malitson's table 1 has five decimals).
        ("fused-silica", 587.5618, 1.45846, 6e-6),
        ("fused-silica", 532.0, 1.46071, 6e-6),
        ("fused-silica", 656.2725, 1.45637, 6e-6),
        ("fused-silica", 486.1327, 1.46313, 6e-6),
        ("fused-silica", 1064.0, 1.44963, 6e-6),
        # SCHOTT's data sheet of N-BK7 (five decimals): h, g, F', e, d, C, 1060 nm.
        ("n-bk7", 404.656, 1.53024, 6e-6),
        ("n-bk7", 435.835, 1.52668, 6e-6),
        ("n-bk7", 479.991, 1.52283, 6e-6),
        ("n-bk7", 546.074, 1.51872, 6e-6),
        ("n-bk7", 587.5618, 1.51680, 6e-6),
        ("n-bk7", 656.2725, 1.51432, 6e-6),
        ("n-bk7", 1060.0, 1.50669, 6e-6),
        # Norland prints 1.56 for the cured polymer at the sodium line; makers of PMMA 1.491, of polycarbonate 1.585.
        ("noa61", 589.3, 1.56, 5e-3),
        ("pmma", 589.3, 1.491, 2e-3),
        ("polycarbonate", 589.3, 1.585, 1e-3),
        ("air", 532.0, 1.0, 0),
    ],
)
def test_published_indices(name, wavelength_nm, index, tolerance):
    assert load_material(name).index(wavelength_nm * 1e-9) == pytest.approx(index, abs=tolerance)


@pytest.mark.parametrize(
    ("name", "abbe", "tolerance"),
    [("fused-silica", 67.8, 0.1), ("n-bk7", 64.17, 0.01), ("pmma", 58, 2), ("polycarbonate", 29, 2)],
)
def test_published_abbe_numbers(name, abbe, tolerance):
    """Heraeus and SCHOTT print them to the digits asked for here; those of plastics vary with the maker."""
    d, f, c = (load_material(name).index(w) for w in (D, F, C))
    assert (d - 1) / (f - c) == pytest.approx(abbe, abs=tolerance)


def test_the_resist_has_its_only_published_value():
    assert PHLATCAM_RESIST.index(532e-9) - 1 == pytest.approx(0.5103, abs=1e-15)
    assert "nominal" in PHLATCAM_RESIST.source


@pytest.mark.parametrize("name", sorted(set(MATERIALS) - {"air"}))
def test_dispersion_is_normal(name):
    """The index falls with the wavelength: 2 to 11 % of n - 1 over 450-700 nm, for Abbe numbers from 70 to 25."""
    material = MATERIALS[name]
    index = [material.index(w) for w in np.linspace(450e-9, 700e-9, 26)]
    assert np.all(np.diff(index) < 0)
    assert 0.015 < (index[0] - index[-1]) / (material.index(532e-9) - 1) < 0.11
    assert material.source


@pytest.fixture
def database(shared_data):
    return shared_data / "refractive_index" / "database" / "data"


def _formula(path):
    entry = yaml.safe_load(path.read_text(encoding="utf-8"))["DATA"][0]
    low, high = map(float, entry["wavelength_range"].split())
    return entry["type"], [float(c) for c in entry["coefficients"].split()], low, high


def _by_hand(kind, c, um):
    """The formulas as the database's own document writes them, here once more."""
    pairs = np.reshape(c[1:], (-1, 2)).T
    if kind == "formula 1":
        return np.sqrt(1 + c[0] + np.sum(pairs[0] * um**2 / (um**2 - pairs[1] ** 2)))
    if kind == "formula 2":
        return np.sqrt(1 + c[0] + np.sum(pairs[0] * um**2 / (um**2 - pairs[1])))
    value = c[0] + np.sum(pairs[0] * um ** pairs[1])
    return {"formula 3": np.sqrt(value), "formula 5": value}[kind]


@pytest.mark.shared
@pytest.mark.parametrize("name", sorted(PAGES))
def test_built_in_materials_equal_the_database(database, name):
    """The same range, and the same index to rounding, at 50 wavelengths."""
    kind, coefficients, low, high = _formula(database / PAGES[name])
    assert MATERIALS[name].range_m == (pytest.approx(low * 1e-6), pytest.approx(high * 1e-6))
    for um in np.linspace(low + 1e-9, high - 1e-9, 50):
        assert MATERIALS[name].index(um * 1e-6) == pytest.approx(_by_hand(kind, coefficients, um), abs=1e-12)


@pytest.mark.shared
def test_the_resists_dispersion_is_su8_rescaled(database):
    """One factor on n - 1 brings the uncured SU-8 2000 to the anchor."""
    kind, c, low, high = _formula(database / RESIST_PAGE)
    factor = 0.5103 / (_by_hand(kind, c, 0.532) - 1)
    for um in np.linspace(low + 1e-9, high - 1e-9, 20):
        expected = 1 + factor * (_by_hand(kind, c, um) - 1)
        assert PHLATCAM_RESIST.index(um * 1e-6) == pytest.approx(expected, abs=1e-12)


@pytest.mark.shared
def test_other_groups_measured_nearly_the_same(database):
    """Independent measurements of bulk polymers: their greatest difference over the visible was 0.002, 0.007 and 0.022."""
    for name, page, spread in (
        ("pmma", "organic/(C5H8O2)n - poly(methyl methacrylate)/nk/Szczurowski.yml", 0.0025),
        ("polycarbonate", "organic/(C16H14O3)n - polycarbonate/nk/Zhang.yml", 0.008),
        ("pdms", "organic/(C2H6OSi)n - polydimethylsiloxane/nk/Gupta.yml", 0.025),
    ):
        other = load_material(str(database / page))
        for wavelength_m in np.linspace(460e-9, 690e-9, 12):
            assert other.index(wavelength_m) == pytest.approx(MATERIALS[name].index(wavelength_m), abs=spread), name


@pytest.mark.parametrize("wavelength_m", [0.1e-6, 7e-6, 532.0, 0.0, float("nan")])
def test_wavelengths_outside_the_fit_are_refused(wavelength_m):
    with pytest.raises(InputError, match=r"2\.1e-07 to 6\.7e-06 m"):
        FUSED_SILICA.index(wavelength_m)


def test_refractivity_is_what_a_design_divides_by_and_never_nothing():
    assert load_material("n-bk7").refractivity(587.5618e-9) == pytest.approx(0.5168, abs=5e-5)  # Schott's n_d
    with pytest.raises(InputError, match=r"material: 'air' .*'fused-silica'"):
        load_material("air").refractivity(550e-9)


def test_materials_are_found_by_name():
    assert load_material("fused-silica") is FUSED_SILICA
    assert all(load_material(name).name == name for name in MATERIALS)
    with pytest.raises(InputError, match=r"'glass'.*air, fused-silica, n-bk7"):
        load_material("glass")


def test_files_are_told_from_names(tmp_path):
    assert material_file("n-bk7", tmp_path) is None
    assert material_file("glass", tmp_path) is None
    assert material_file("my glass.csv", tmp_path) == tmp_path / "my glass.csv"
    with pytest.raises(InputError, match=r"lost\.yml"):
        load_material("lost.yml", tmp_path)
