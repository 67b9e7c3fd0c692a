"""The command says what became of a training."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from PIL import Image

from learning.commands import evaluate, reconstruct, train, tune
from learning.tune import load_tuned
from simulator.dataset import open_dataset
from simulator.errors import InputError
from simulator.io.exr import read_exr
from simulator.optics.stack_files import read_depths_m


def test_command(tiny_dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plain = {
        "name": "tiny",
        "output": "out",
        "data": {"train": str(tiny_dataset), "cache": str(tmp_path / "cache"), "workers": 0},
        "network": {"size": "tiny"},
        "steps": 3,
        "batch": 4,
    }
    path = tmp_path / "tiny.yaml"
    path.write_text(yaml.safe_dump(plain))
    train(path, ["steps=2"])
    out = capsys.readouterr()
    assert "2 steps" in out.out
    assert (tmp_path / "out" / "best.safetensors").exists()  # relative to the file
    assert "best after step 2: PSNR" in out.out
    assert "step 2: validation loss" in out.err
    train(path, ["steps=2"])
    assert "finished before" in capsys.readouterr().out


SEARCH = {
    "cls": {
        "regularisation_lambda": {"values": [0.03, 0.3], "high": 10},
        "cost": {"values": ["spread"]},
        "measure": {"values": ["gradient"]},
        "light": {"values": ["label"]},
        "contrast": {"values": [8.0], "low": 8, "high": 8},
        "steps_between_planes": {"values": [4], "low": 4, "high": 4},
        "window_px": {"values": [1.0], "low": 1, "high": 1},
        "pairwise": {"values": [0.1, 1.0], "high": 100},
    }
}


@pytest.mark.slow
def test_the_command_tunes_and_goes_on(tiny_dataset: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "tune.yaml"
    data = {"validation": str(tiny_dataset), "scenes": 4, "allow_few_scenes": True}
    path.write_text(
        json.dumps({"data": data, "methods": ["cls"], "noise_db": [30, 40], "search": SEARCH}), encoding="utf-8"
    )
    tune(path, ["noise_db=[40]"])
    out, err = capfd.readouterr()
    lines = out.splitlines()
    assert lines[-1] == f"wrote {tmp_path / 'tuned.json'}"
    assert lines[0].split()[:3] == ["method", "noise", "dB"]
    assert lines[1].split()[:2] == ["cls", "40"]
    assert lines[2].startswith("constant guess")
    assert "cls at 40 dB: PSNR" in err
    tuned = load_tuned(tmp_path / "tuned.json")
    parameters, level = tuned.parameters("cls", 33)
    assert level == 40
    first = tuned.content["results"][0]
    trials = {
        (t["parameters"]["regularisation_lambda"], t["parameters"]["pairwise"]): t["score"]
        for t in tuned.content["trials"]
        if all(
            t["parameters"][name] == parameters[name]
            for name in parameters
            if name not in ("regularisation_lambda", "pairwise")
        )
    }
    best = parameters["regularisation_lambda"], parameters["pairwise"]
    # Within the least gain of the best of all trials, and worse ones above and below it, or a limit.
    assert trials[best] == first["score"] <= min(trials.values()) * (1 + 2e-3)
    for axis, value in enumerate(best):
        others = {pair[axis] for pair in trials if pair[1 - axis] == best[1 - axis]}
        assert (min(others) < value < max(others)) or first["at_limit"]
    tune(path, None)
    again = load_tuned(tmp_path / "tuned.json")
    assert again.levels_db("cls") == [30.0, 40.0]
    assert again.content["trials"][: len(tuned.content["trials"])] == tuned.content["trials"]


def test_an_unknown_parameter_is_refused(tiny_dataset: Path, tmp_path: Path) -> None:
    path = tmp_path / "tune.yaml"
    data = {"validation": str(tiny_dataset), "scenes": 4, "allow_few_scenes": True}
    path.write_text(json.dumps({"data": data, "methods": ["cls"]}), encoding="utf-8")
    with pytest.raises(InputError, match=r"^search\.cls: "):
        tune(path, ["search.cls.tau.values=[1.0]"])
    with pytest.raises(InputError, match=r"^search\.cls\.regularisation_lambda: "):
        tune(path, ["search.cls.regularisation_lambda.values=[1.0, 0.1]"])


def _write(tmp_path: Path, tiny_dataset: Path, **changes: Any) -> Path:
    content: dict[str, Any] = {
        "name": "trial",
        "output": "out",
        "data": {"test": str(tiny_dataset), "training": str(tiny_dataset), "scenes": 2},
        "methods": [{"name": "CLS", "classical": "cls", "parameters": {}}],
        "perceptual": "none",
        "time": {"repeats": 1},
        "figures": {"montage": 1},
    }
    path = tmp_path / "evaluate.yaml"
    path.write_text(yaml.safe_dump(content | changes), encoding="utf-8")
    return path


def test_a_table_is_printed(tmp_path: Path, tiny_dataset: Path, capsys: pytest.CaptureFixture[str]) -> None:
    evaluate(_write(tmp_path, tiny_dataset), ["output=elsewhere"])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split()[:3] == ["method", "PSNR", "dB"]
    assert [line.split()[0] for line in lines[1:5]] == ["CLS", "constant", "mean", "black"]
    assert lines[5] == f"look at {tmp_path / 'elsewhere' / 'report.md'}"
    assert (tmp_path / "elsewhere" / "report.md").is_file()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"methods": []}, "methods"),
        ({"methods": [{"name": "A", "checkpoints": []}]}, "at least one file"),
        ({"methods": [{"name": "A", "checkpoints": ["a", "a"]}]}, "each of them once"),
        ({"methods": [{"name": "A"}]}, "either checkpoints"),
        ({"methods": [{"name": "A", "checkpoints": ["a"], "classical": "cls"}]}, "either checkpoints"),
        ({"methods": [{"name": "A", "checkpoints": ["a"], "tuned": "b"}]}, "belong to classical methods"),
        ({"methods": [{"name": "A", "classical": "cls"}]}, "either tuned"),
        (
            {"methods": [{"name": "A", "checkpoints": ["a"]}, {"name": "A", "checkpoints": ["b"]}]},
            "'A' is the name of two methods",
        ),
        ({"data": {"test": "x"}}, "classical methods need data.training"),
        ({"data": {"test": "x", "stack": "captured"}}, "name its folder in data.training"),
        ({"depth_bins_cm": [5, 4]}, "increasing"),
        ({"noise_db": [20, 20]}, "each of them once"),
        ({"noise_db": [2000]}, "0 to 100 dB"),
        ({"speed": 1}, "speed"),
    ],
)
def test_a_mistake_in_the_file_is_named(
    tmp_path: Path, tiny_dataset: Path, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message) as error:
        evaluate(_write(tmp_path, tiny_dataset, **changes))
    assert "evaluate.yaml:" in str(error.value)


def test_a_sample_becomes_a_folder(tiny_dataset: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "out"
    sample = open_dataset(tiny_dataset, "test").folder(0)
    reconstruct(sample, method="cls", set_=["regularisation_lambda=0.1", "pairwise=1"], output=folder, volume=True)
    out = capfd.readouterr().out
    assert "CLS + graph cut (regularisation_lambda 0.1" in out
    assert f"{folder}: depth.exr, depth.png, picture.exr, picture.png, reconstruction.json, volume.exr" in out
    record = json.loads((folder / "reconstruction.json").read_text())
    assert record["parameters"]["regularisation_lambda"] == 0.1
    assert record["method"] == "cls"
    assert record["camera"]["depths_m"] == read_depths_m(tiny_dataset / "psf").tolist()
    assert set(record["seconds"]) == {"inversion", "graph cut", "assembly"}
    assert len(read_exr(folder / "volume.exr")[0]) == 9


def test_no_result_takes_the_place_of_another_by_default(
    tiny_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    test, train = (open_dataset(tiny_dataset, split).folder(0) for split in ("test", "train"))
    for sample, method in ((test, "cls"), (train, "cls"), (test, "admm")):
        reconstruct(sample, method=method, set_=["iterations=2"] if method == "admm" else None)
    assert {path.name for path in tmp_path.iterdir()} == {
        f"test_{test.name}_cls",
        f"train_{train.name}_cls",
        f"test_{test.name}_admm",
    }
    assert "replaced" not in capfd.readouterr().out
    reconstruct(test / "measurement.exr", method="cls")
    assert "reconstruction.json; replaced an earlier reconstruction" in capfd.readouterr().out
    assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.parametrize(("set_", "message"), [(["regularisation_lambda"], "^--set: "), (["=1"], "^--set: ")])
def test_changes_need_a_key_and_a_value(tiny_dataset: Path, tmp_path: Path, set_: list[str], message: str) -> None:
    sample = open_dataset(tiny_dataset, "test").folder(0)
    with pytest.raises(InputError, match=message):
        reconstruct(sample, method="cls", set_=set_, output=tmp_path / "out")
    with pytest.raises(InputError, match=r"^--white: "):
        reconstruct(sample, method="cls", white=-1, output=tmp_path / "out")
    with pytest.raises(InputError, match=r"^--scene: "):
        reconstruct(sample, method="cls", scene="16", output=tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.shared
@pytest.mark.parametrize("method", ["cls", "admm"])
def test_the_diffuser_cameras_hand(shared_data: Path, tmp_path: Path, method: str) -> None:
    tutorial = shared_data / "diffusercam" / "tutorial"
    folder = tmp_path / "hand"
    raw, psf = tutorial / "rawdata_hand_sample.tif", str(tutorial / "psf_sample.tif")
    reconstruct(raw, method=method, stack=psf, binning=8, output=folder)
    assert not (folder / "depth.png").exists()
    grey = np.asarray(Image.open(folder / "picture.png"))[..., 0].astype(float)
    assert grey.shape == (150, 200)
    # Where the hand is and where it is not, read off the published tutorial's image: palm, thumb's tip, three corners.
    palm = grey[65:90, 100:125].mean()
    assert palm > 120
    assert grey[38:44, 116:120].mean() > 80
    for corner in (grey[:30, 160:], grey[:20, :50], grey[110:, :60]):
        assert corner.mean() < palm / 2
