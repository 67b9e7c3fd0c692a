"""User tables against the formulas that they were sampled from, database pages against their own rows, and bad files."""

from dataclasses import asdict

import numpy as np
import pytest

from simulator.errors import InputError
from simulator.optics.materials import N_BK7, Material, load_material


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
    with pytest.raises(InputError, match=r"'glass\.csv' .*3\.8e-07 to 7\.8e-07 m"):
        glass.index(800e-9)


def test_absorption_is_left_out_and_said(tmp_path):
    glass = _csv(tmp_path, "wavelength_um; n; k\n0.7; 1.5; 1e-5\n0.4; 1.6; 3e-4\n")  # any order, semicolons
    assert glass.index(0.4e-6) == 1.6
    assert glass.index(0.7e-6) == 1.5
    assert "absorption (k up to 0.0003) is left out" in glass.source


def test_a_table_survives_json(tmp_path):
    """The cache of masks keeps a material as plain data."""
    import json

    glass = _csv(tmp_path, "nm,n\n400,1.5\n500,1.48\n600,1.47\n")
    data = json.loads(json.dumps(asdict(glass)))
    again = Material(**data | {key: tuple(data[key]) for key in ("coefficients", "range_m")})
    assert again == glass
    assert again.index(450e-9) == glass.index(450e-9)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "400,1.5\n500,1.4\n",
            "the unit of the wavelengths is not said; give the table a header, such as wavelength_nm,n",
        ),
        ("wavelength,n\n400,1.5\n500,1.4\n", "the unit of the wavelengths is not said"),
        ("nm,index\n400,1.5\n500,1.4\n", "got the columns index after the wavelength; expected n, or n and k"),
        ("nm,n\n400,1.5\n", "1 rows of numbers; a table needs at least two"),
        ("nm,n\n400,1.5\n400,1.4\n", "the wavelength 4e-07 m comes twice"),
        ("nm,n\n400,1.5\n500,x\n", "glass.csv:3:"),
        ("nm,n\n400,1.5\n500,nan\n", "glass.csv:3:"),
        ("nm,n\n400,1.5\n500\n", "glass.csv:3:"),
        ("nm,n,k\n400,1.5\n500,1.4\n", "its header names 3 columns, but the rows hold 2"),
        ("nm,n\n0.4,1.5\n0.5,1.4\n", "which is no light; does the header name their unit"),
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
    with pytest.raises(InputError, match=r"glass\.csv: .*UTF-8"):
        load_material("glass.csv", tmp_path)


FORMULA = "DATA:\n  - type: formula 1\n    wavelength_range: 0.3 2\n    coefficients: 0 1.1 0.1\n"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[1, 2", "no YAML that can be read"),
        ("!!python/object/apply:os.system ['true']", "no YAML that can be read"),
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


@pytest.mark.shared
def test_a_terahertz_page_knows_no_light(shared_data):
    page = shared_data / "refractive_index/database/data/other/resists/Nanoscribe IP-Dip/nk/Mavrona-cured.yml"
    resist = load_material(str(page))
    assert resist.index(300e-6) == pytest.approx(1.6, abs=0.05)
    with pytest.raises(InputError, match=r"0\.000199861 to 0\.000997678 m"):
        resist.index(532e-9)
