"""A data set's two stacks: samples are made with the true one, the captured one lies beside it and is checked alike."""

import json
import shutil

import numpy as np
import pytest

from psf_library import load_psf_stack
from simulator.dataset import generate, open_dataset, verify
from simulator.errors import InputError
from simulator.optics.stack_files import stack_folder

PSF = {"depths_cm": [3.6, 20], "wavelengths_per_channel": 1, "accept_error": 1}


@pytest.fixture(scope="module")
def finished(tmp_path_factory, make_trial):
    """A finished data set with a captured stack; the trial can go on with it."""
    trial = make_trial(tmp_path_factory.mktemp("captured"))
    return trial, trial.generate(psf=PSF | {"as_captured": {}})


def test_samples_are_made_with_the_true_stack(finished) -> None:
    _, root = finished
    true, captured = load_psf_stack(root), load_psf_stack(root, captured=True)
    assert captured.provenance["nominal_fingerprint"] == true.fingerprint
    assert open_dataset(root, "train")[0].metadata["psf"] == true.fingerprint
    change = np.linalg.norm(captured.values - true.values) / np.linalg.norm(true.values)
    assert 0.001 < change < 1
    assert verify(root).ok


def test_a_run_that_goes_on_keeps_both_and_makes_one_that_was_deleted_again(finished) -> None:
    trial, root = finished
    before = {path.name: path.read_bytes() for path in (root / "psf_captured").iterdir()}
    shutil.rmtree(root / "psf_captured")
    trial.generate(psf=PSF | {"as_captured": {}})
    assert {path.name: path.read_bytes() for path in (root / "psf_captured").iterdir()} == before


@pytest.mark.parametrize("folder", ["psf", "psf_captured"])
@pytest.mark.parametrize("file", ["psf.json", "depth_0000.exr"])
def test_a_run_does_not_go_on_beside_a_damaged_stack(make_trial, tmp_path, folder, file) -> None:
    psf = {"depths_cm": [20], "wavelengths_per_channel": 1, "accept_error": 1, "as_captured": {}}
    trial = make_trial(tmp_path)
    root = trial.generate(psf=psf)
    with (root / folder / file).open("ab") as opened:
        opened.write(b"x")
    with pytest.raises(InputError, match=f"{folder}/{file}"):
        trial.generate(psf=psf)


def test_another_light_of_the_calibration_is_another_data_set(trial) -> None:
    lamp = trial.folder / "lamp.csv"
    lamp.write_text("400,1\n700,2\n")
    psf = PSF | {"as_captured": {"illuminant": "lamp.csv"}}
    root = trial.generate(psf=psf)
    assert trial.generate(psf=psf) == root
    lamp.write_text("400,2\n700,1\n")
    with pytest.raises(InputError, match=r"inputs\.lamp\.csv: \w{12} -> \w{12}"):
        trial.generate(psf=psf)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"psf": PSF | {"as_captured": {"illuminant": "Bengal"}}}, r"psf\.as_captured\.illuminant:"),
        ({"camera": {"scene_to_camera": [[1, 0, 0]]}}, "scene_to_camera:"),
    ],
)
def test_mistakes_come_out_before_the_psfs_are_computed(trial, changes, words) -> None:
    seen = []
    with pytest.raises(InputError, match=words):
        generate(trial.write(**changes), progress=lambda *update: seen.append(update))
    assert seen == []


def test_without_the_key_there_is_none(trial) -> None:
    root = trial.generate()
    assert not (root / "psf_captured").exists()
    assert verify(root).ok
    with pytest.raises(InputError, match=r"psf_captured.*as_captured.*--as-captured"):
        load_psf_stack(root, captured=True)


def _copy(finished, tmp_path):
    root = tmp_path / "copy"
    shutil.copytree(finished[1], root)
    return root


def test_damage_is_named(finished, tmp_path) -> None:
    root = _copy(finished, tmp_path)
    data = bytearray((root / "psf_captured/depth_0001.exr").read_bytes())
    data[-20] ^= 1
    (root / "psf_captured/depth_0001.exr").write_bytes(data)
    (line,) = verify(root).problems
    assert "psf_captured/depth_0001.exr is damaged" in line
    shutil.rmtree(root / "psf_captured")
    (line,) = verify(root).problems
    assert "no PSF stack in" in line
    assert "psf_captured" in line


def test_a_stack_of_another_camera_is_named(finished, tmp_path) -> None:
    root = _copy(finished, tmp_path)
    path = root / "psf_captured/psf.json"
    content = json.loads(path.read_text())
    content["provenance"]["nominal_fingerprint"] = "b" * 64
    path.write_text(json.dumps(content))
    (line,) = verify(root).problems
    assert line.startswith("psf_captured: captured from psf = bbb")


def test_where_stacks_lie(tmp_path, monkeypatch) -> None:
    (tmp_path / "set/psf").mkdir(parents=True)
    assert stack_folder(tmp_path / "set") == tmp_path / "set/psf"
    assert stack_folder(tmp_path / "set", captured=True) == tmp_path / "set/psf_captured"
    assert stack_folder(tmp_path / "stack", captured=True) == tmp_path / "stack_captured"
    monkeypatch.chdir(tmp_path)
    assert stack_folder(type(tmp_path)(), captured=True).name == f"{tmp_path.name}_captured"
