"""``psf --check``: the tables, what travels with the stack, and what cannot be checked."""

import json

import pytest

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")


def test_the_check_is_printed_and_travels_with_the_stack(trial, flatlight, tmp_path):
    path = trial.write()
    code, out, _ = flatlight("psf", path, "--check", "--set", "psf.depths=1", "--set", "psf.near_cm=5", "--set",
                             "psf.far_cm=5", "--output", tmp_path / "stack")  # fmt: skip
    assert code == 0
    for expected in ("error bar", "model vs exact", "points vs direct sum", "field angle", "5 cm"):
        assert expected in out
    provenance = json.loads((tmp_path / "stack" / "psf.json").read_text())["provenance"]
    assert provenance["errors"]["check"] == "full"
    assert provenance["errors"]["field_angle"]["table"][-1]["degrees"] == pytest.approx(7.4, abs=0.1)
    assert provenance["sampling"]["error_bar"] == 2 * provenance["sampling"]["error"]


def test_a_data_set_may_ask_for_the_full_check_and_resume_without_it(trial):
    """Looking more closely changes no sample, so the fingerprint stays."""
    folder = trial.generate(psf={"depths_cm": [5], "wavelengths_per_channel": 1, "accept_error": 1, "check": "full"})
    provenance = json.loads((folder / "psf" / "psf.json").read_text())["provenance"]
    assert provenance["errors"]["check"] == "full"
    assert trial.generate(psf={"depths_cm": [5], "wavelengths_per_channel": 1, "accept_error": 1}) == folder
