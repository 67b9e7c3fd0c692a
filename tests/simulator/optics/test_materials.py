"""Refractive indices against published values and the public database; tables and pages from files, and bad ones."""

import numpy as np
import pytest
import yaml

from simulator.errors import InputError
from simulator.optics.materials import (
    FUSED_SILICA,
    MATERIALS,
    N_BK7,
    PHLATCAM_RESIST,
    load_material,
    material_file,
)

# ---- built in


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
        # Fused silica at three lines, as its makers publish it (Malitson's table 1 has five decimals).
        ("fused-silica", 587.5618, 1.45846, 6e-6),
        ("fused-silica", 486.1327, 1.46313, 6e-6),
        ("fused-silica", 1064.0, 1.44963, 6e-6),
        # SCHOTT's data sheet of N-BK7 (five decimals): h, e, d, 1060 nm.
        ("n-bk7", 404.656, 1.53024, 6e-6),
        ("n-bk7", 546.074, 1.51872, 6e-6),
        ("n-bk7", 587.5618, 1.51680, 6e-6),
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


@pytest.mark.parametrize("wavelength_m", [0.1e-6, 7e-6, 532.0, 0.0, float("nan")])
def test_wavelengths_outside_the_fit_are_refused(wavelength_m):
    with pytest.raises(InputError, match=r"^wavelength_m: "):
        FUSED_SILICA.index(wavelength_m)


def test_refractivity_is_what_a_design_divides_by_and_never_nothing():
    assert load_material("n-bk7").refractivity(587.5618e-9) == pytest.approx(0.5168, abs=5e-5)  # Schott's n_d
    with pytest.raises(InputError, match=r"^material: "):
        load_material("air").refractivity(550e-9)


def test_materials_are_found_by_name():
    assert load_material("fused-silica") is FUSED_SILICA
    assert all(load_material(name).name == name for name in MATERIALS)
    with pytest.raises(InputError, match=r"^material: "):
        load_material("glass")


def test_files_are_told_from_names(tmp_path):
    assert material_file("n-bk7", tmp_path) is None
    assert material_file("glass", tmp_path) is None
    assert material_file("my glass.csv", tmp_path) == tmp_path / "my glass.csv"
    with pytest.raises(InputError, match=r"lost\.yml: "):
        load_material("lost.yml", tmp_path)


# ---- from files


def _csv(folder, text):
    (folder / "glass.csv").write_text(text, encoding="utf-8")
    return load_material("glass.csv", folder)


@pytest.mark.parametrize(
    ("unit", "scale"), [("wavelength_nm", 1e9), ("lambda (um)", 1e6), ("Wavelength [Angstrom]", 1e10)]
)
def test_a_sampled_table_gives_back_its_formula(tmp_path, unit, scale):
    """N-BK7 every 20 nm: a linear interpolation would err by 3e-5, the cubic by less than 3e-6; the points are exact."""
    at_m = np.linspace(380e-9, 780e-9, 21)
    rows = "\n".join(f"{w * scale!r},{N_BK7.index(w)!r}" for w in map(float, at_m))
    glass = _csv(tmp_path, f"# measured by hand\n{unit},n\n{rows}\n")
    assert (glass.name, glass.source) == ("glass.csv", "measured by hand")
    assert glass.range_m == (pytest.approx(380e-9), pytest.approx(780e-9))
    for w in at_m[1:-1]:
        assert glass.index(w) == pytest.approx(N_BK7.index(w), abs=1e-14)
    errors = [abs(glass.index(w) - N_BK7.index(w)) for w in np.linspace(400e-9, 760e-9, 73)]
    assert max(errors) < 3e-6
    with pytest.raises(InputError, match=r"^wavelength_m: "):
        glass.index(800e-9)


def test_absorption_is_left_out_and_said(tmp_path):
    glass = _csv(tmp_path, "wavelength_um; n; k\n0.7; 1.5; 1e-5\n0.4; 1.6; 3e-4\n")  # any order, semicolons
    assert glass.index(0.4e-6) == 1.6
    assert glass.index(0.7e-6) == 1.5
    assert "absorption (k up to 0.0003) is left out" in glass.source


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "400,1.5\n500,1.4\n",
            "the wavelengths have no unit",
        ),
        ("wavelength,n\n400,1.5\n500,1.4\n", "the wavelengths have no unit"),
        ("nm,index\n400,1.5\n500,1.4\n", "got the columns index after the wavelength; expected n, or n and k"),
        ("nm,n\n400,1.5\n", "1 rows of numbers"),
        ("nm,n\n400,1.5\n400,1.4\n", "the wavelength 4e-07 m comes twice"),
        ("nm,n\n400,1.5\n500,x\n", "glass.csv:3:"),
        ("nm,n\n400,1.5\n500,nan\n", "glass.csv:3:"),
        ("nm,n\n400,1.5\n500\n", "glass.csv:3:"),
        ("nm,n,k\n400,1.5\n500,1.4\n", "its header names 3 columns, but the rows hold 2"),
        ("nm,n\n0.4,1.5\n0.5,1.4\n", "does the header name their unit"),
        ("nm,n\n400,400\n500,1.4\n", "a refractive index of 400; expected 0.05 to 10"),
        ("", "0 rows of numbers"),
    ],
)
def test_bad_tables_are_refused(tmp_path, text, words):
    with pytest.raises(InputError) as caught:
        _csv(tmp_path, text)
    assert words in str(caught.value)
    assert "glass.csv" in str(caught.value)


def test_a_binary_file_is_refused(tmp_path):
    (tmp_path / "glass.csv").write_bytes(b"\xff\xfe\x00nm")
    with pytest.raises(InputError, match=r"glass\.csv: "):
        load_material("glass.csv", tmp_path)


FORMULA = "DATA:\n  - type: formula 1\n    wavelength_range: 0.3 2\n    coefficients: 0 1.1 0.1\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[1, 2", "not readable as YAML"),
        ("!!python/object/apply:os.system ['true']", "not readable as YAML"),
        ("ABOUT: glass\n", "no DATA list; expected a page of refractiveindex.info"),
        ("DATA:\n  - type: formula 7\n", "its DATA are formula 7; expected exactly one of formula 1, formula 2"),
        ("DATA:\n  - type: tabulated k\n    data: 0.3 1\n", "its DATA are tabulated k; expected exactly one"),
        (FORMULA + FORMULA.removeprefix("DATA:\n"), "its DATA are formula 1, formula 1; expected exactly one"),
        (FORMULA.replace("0 1.1 0.1", "0 1.1"), "formula 1 with 2 coefficients"),
        (FORMULA.replace("0 1.1 0.1", "0 a 0.1"), "formula 1 has coefficients '0 a 0.1'"),
        (FORMULA.replace("0.3 2", "2 0.3"), "over (2.0, 0.3) um makes no sense"),
        (FORMULA.replace("0 1.1 0.1", "0 1.1 0.5"), "a refractive index of nan; expected 0.05 to 10"),
        (
            "DATA:\n  - type: tabulated n\n    data: |\n      0.3 1.5 0\n      0.4 1.5 0\n",
            "holds 2 rows of 3; expected 2",
        ),
    ],
)
def test_bad_pages_are_refused(tmp_path, text, words):
    (tmp_path / "glass.yml").write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        load_material("glass.yml", tmp_path)
    assert words in str(caught.value)
    assert "glass.yml" in str(caught.value)


@pytest.mark.shared
def test_a_page_with_several_data_entries(shared_data):
    """N-BK7's page holds formula 2, a table of k and a thermal formula: the first is used, the others are no index."""
    page = shared_data / "refractive_index/database/data/specs/schott/optical/N-BK7.yml"
    glass = load_material(str(page))
    for w in np.linspace(300e-9, 2500e-9, 30):
        assert glass.index(w) == pytest.approx(N_BK7.index(w), abs=1e-15)
    assert glass.source.startswith("SCHOTT Zemax catalog 2017-01-20b")
    assert "<" not in glass.source
    assert glass.source.endswith("absorption (k up to 8.13e-06) is left out")


@pytest.mark.shared
def test_tabulated_pages_give_back_their_rows(shared_data):
    page = shared_data / "refractive_index/database/data/main/SiO2/nk/Gao.yml"
    film = load_material(str(page))
    for um, n in ((0.252, 1.523846), (0.3, 1.507046), (0.318, 1.50266)):
        assert film.index(um * 1e-6) == pytest.approx(n, abs=1e-12)
    assert film.range_m == (pytest.approx(0.252e-6), pytest.approx(1.25e-6))
    assert film.index(1.25e-6) > 1.4  # the end of the table belongs to it
    # Linear interpolation of these 2 nm steps agrees to the data's own curvature.
    assert film.index(0.301e-6) == pytest.approx((1.507046 + 1.506518) / 2, abs=2e-6)
