"""``psf --as-captured`` as users meet it."""

from pathlib import Path

import pytest

from psf_library import load_psf_stack

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")


def test_true_and_captured_side_by_side(flatlight, trial, tmp_path: Path) -> None:
    from PIL import Image

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


def test_a_measured_psf_is_refused_before_anything_is_said(one_error, flatlight, trial, tmp_path: Path) -> None:
    assert flatlight("psf", trial.write(), "--output", trial.folder / "stack")[0] == 0
    result = flatlight("psf", trial.write(camera={"mask": None}, psf={"measured": "stack"}), "--as-captured")
    one_error(result, "this PSF was measured, and its errors are in it")
    assert result[1] == ""


def test_replaces_nothing_else(one_error, flatlight, trial, tmp_path: Path) -> None:
    (tmp_path / "stack_captured").mkdir()
    (tmp_path / "stack_captured/thesis.txt").touch()
    run = flatlight("psf", trial.write(), "--as-captured", "--output", tmp_path / "stack")
    one_error(run, "thesis.txt", "choose another name")


def test_an_interpolated_stack_states_its_error(flatlight, trial) -> None:
    assert flatlight("psf", trial.write(), "--output", trial.folder / "stack")[0] == 0
    psf = {"measured": "stack", "planes": {"near_cm": 4, "far_cm": 10, "depths": 4}}
    code, out, err = flatlight("psf", trial.write(camera={"mask": None}, psf=psf))
    assert code == 0, err
    (line,) = (line for line in out.splitlines() if "interpolated" in line)
    assert "from 3 measured planes, error up to" in line
