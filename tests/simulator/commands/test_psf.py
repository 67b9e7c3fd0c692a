"""``psf`` as users meet it."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from psf_library import load_psf_stack
from simulator.assembly import Assembly
from simulator.config import load_config
from simulator.optics.stack_files import read_psf_stack

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")


def test_writes_and_describes_the_stack(flatlight, one_error, trial, tmp_path: Path) -> None:
    path = trial.write()
    code, out, err = flatlight("psf", path, "--output", tmp_path / "stack")
    assert code == 0, err
    assert "3, 3.6 cm to 20 cm" in out
    assert "error budget, worst first" in out
    assert all(f" {cause} " in out for cause in ("sampling", "wavelengths", "depth model", "planes", "field"))
    assert "as captured" not in out
    assert not (tmp_path / "stack_captured").exists()
    stack = Assembly(load_config(path)).psf_stack
    assert np.array_equal(read_psf_stack(tmp_path / "stack").values, stack.values)
    assert flatlight("psf", path, "--output", tmp_path / "stack")[0] == 0  # an older stack is replaced, nothing else
    one_error(flatlight("psf", path, "--output", tmp_path), "plugins.py")
    assert trial.plugins.exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--plot", "p.txt"), "--plot: "),
        (("--plot", "folder.png"), "folder.png"),
        (("--plot", "no/p.png"), "no "),
        (("--plot", "p.png", "--as-captured"), "p_captured.png"),
        (("--output", "plugins.py/x"), "plugins.py"),
    ],
)
def test_places_are_looked_at_before_anything_is_computed(
    one_error, flatlight, trial, monkeypatch, arguments, words
) -> None:
    monkeypatch.chdir(trial.folder)
    for name in ("folder.png", "p_captured.png"):
        (trial.folder / name).mkdir()
    result = flatlight("psf", trial.write(), *arguments)
    one_error(result, words)
    assert result[1] == ""
    assert "PSFs:" not in result[2]


# ``psf --as-captured`` as users meet it.


@pytest.mark.slow
def test_true_and_captured_side_by_side(flatlight, trial, tmp_path: Path) -> None:
    place, picture = tmp_path / "stack", tmp_path / "psf.png"
    code, out, err = flatlight("psf", trial.write(), "--as-captured", "--output", place, "--plot", picture)
    assert code == 0, err
    table = out.split("as captured by Nikon 5100 (NPL) under")[1].splitlines()
    assert "LED 530 nm" in table[0]
    assert all(words in table[1] for words in ("depth", "differs by", "shift x, y (px)", "SNR"))
    assert [line.split()[0] for line in table[2:5]] == ["3.6", "6.1", "20"]
    true, captured = load_psf_stack(place), load_psf_stack(place, captured=True)
    assert captured.provenance["nominal_fingerprint"] == true.fingerprint
    assert captured.values.shape == true.values.shape
    with Image.open(tmp_path / "psf_captured.png") as drawn:
        assert min(drawn.size) > 1000


def test_an_interpolated_stack_states_its_error(flatlight, trial) -> None:
    assert flatlight("psf", trial.write(), "--output", trial.folder / "stack")[0] == 0
    psf = {"measured": "stack", "planes": {"near_cm": 4, "far_cm": 10, "depths": 4}}
    code, out, err = flatlight("psf", trial.write(camera={"mask": None}, psf=psf))
    assert code == 0, err
    (line,) = (line for line in out.splitlines() if "interpolated" in line)
    assert "from 3 measured planes, error up to" in line


# ``psf --check``: the tables, what travels with the stack, and what cannot be checked.


@pytest.mark.slow
def test_the_check_is_printed_and_travels_with_the_stack(trial, flatlight, tmp_path):
    path = trial.write()
    code, out, _ = flatlight("psf", path, "--check", "--set", "psf.depths=1", "--set", "psf.near_cm=5", "--set",
                             "psf.far_cm=5", "--output", tmp_path / "stack")  # fmt: skip
    assert code == 0
    for expected in ("sampling error", "model vs exact", "points vs direct sum", "field angle", "5 cm"):
        assert expected in out
    provenance = json.loads((tmp_path / "stack" / "psf.json").read_text())["provenance"]
    assert provenance["errors"]["check"] == "full"
    assert provenance["errors"]["field"]["table"][-1]["degrees"] == pytest.approx(3.7, abs=0.1)
    values = [row["value"] for row in provenance["budget"]]
    assert values == sorted(values, reverse=True)
    assert provenance["sampling"]["error_bar"] == 2 * provenance["sampling"]["error"]


@pytest.mark.slow
def test_a_data_set_may_ask_for_the_full_check_and_resume_without_it(trial):
    """Looking more closely changes no sample, so the fingerprint stays."""
    folder = trial.generate(psf={"depths_cm": [5], "wavelengths_per_channel": 1, "accept_error": 1, "check": "full"})
    provenance = json.loads((folder / "psf" / "psf.json").read_text())["provenance"]
    assert provenance["errors"]["check"] == "full"
    assert trial.generate(psf={"depths_cm": [5], "wavelengths_per_channel": 1, "accept_error": 1}) == folder
