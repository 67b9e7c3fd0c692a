"""``reconstruct`` as the terminal runs it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from learning.commands.reconstruct import reconstruct
from simulator.dataset import open_dataset
from simulator.errors import InputError
from simulator.io.exr import read_exr
from simulator.optics.stack_files import read_depths_m


def test_a_sample_becomes_a_folder(tiny_dataset: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "out"
    sample = open_dataset(tiny_dataset, "test").folder(0)
    reconstruct(sample, method="cls", set_=["strength=0.1", "pairwise=1"], output=folder, volume=True)
    out = capfd.readouterr().out
    assert "CLS + graph cut (strength 0.1" in out
    assert f"{folder}: depth.exr, depth.png, picture.exr, picture.png, reconstruction.json, volume.exr" in out
    record = json.loads((folder / "reconstruction.json").read_text())
    assert record["parameters"]["strength"] == 0.1
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


@pytest.mark.parametrize(("set_", "message"), [(["strength"], "expected KEY=VALUE"), (["=1"], "expected KEY=VALUE")])
def test_changes_need_a_key_and_a_value(tiny_dataset: Path, tmp_path: Path, set_: list[str], message: str) -> None:
    sample = open_dataset(tiny_dataset, "test").folder(0)
    with pytest.raises(InputError, match=message):
        reconstruct(sample, method="cls", set_=set_, output=tmp_path / "out")
    with pytest.raises(InputError, match="--white: got -1, expected a positive"):
        reconstruct(sample, method="cls", white=-1, output=tmp_path / "out")
    with pytest.raises(InputError, match="--scene: got '16', expected ROWSxCOLUMNS"):
        reconstruct(sample, method="cls", scene="16", output=tmp_path / "out")
    assert not (tmp_path / "out").exists()


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
    # Where the hand is and where it is not, read off the published tutorial's picture: palm, thumb's tip, three corners.
    palm = grey[65:90, 100:125].mean()
    assert palm > 120
    assert grey[38:44, 116:120].mean() > 80
    for corner in (grey[:30, 160:], grey[:20, :50], grey[110:, :60]):
        assert corner.mean() < palm / 2
