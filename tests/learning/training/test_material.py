"""What a training learns from is what its file says, and is validated with the same camera."""

from pathlib import Path
from typing import Any

import pytest

from learning.config.train import TrainConfig
from learning.display import measure_white
from learning.training.material import find_material, open_examples
from simulator.dataset import open_dataset
from simulator.errors import InputError

COUNTS = {"train": 0, "validation": 2, "test": 0}


def config(train: Path, **data: Any) -> TrainConfig:
    return TrainConfig.model_validate({"name": "x", "output": "x", "steps": 1, "data": {"train": str(train), **data}})


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("camera.exposure.full_scale=6e-6", r"gain differs: .*/out [\d.]+ and .*camera\.exposure\.full_scale\)"),
        ("camera.noise={type: physical}", r"offset differs: .*\(camera\.noise\.type, camera\.sensor\.black_level_dn\)"),
        ("forward.vignetting=false", r"irradiance differs: .*forward\.vignetting\)"),
        ("camera.mask.seed=5", r"mask differs: .*camera\.mask, camera\.mask_to_sensor_mm\)"),
        ("psf.far_cm=25", r"range of depths, 1/m differs: .*\[100\.0, 4\.0\].*psf\.far_cm\)"),
        (
            "camera.scene_to_camera=[[0.9, 0.1, 0.0], [0.1, 0.8, 0.2], [0.0, 0.1, 0.7]]",
            r"scene_to_camera differs: .*\[0\.9, 0\.1, 0\.0\].*\(camera\.scene_to_camera\)",
        ),
    ],
)
def test_another_camera_is_refused(tiny_dataset: Path, learning_trial: Any, override: str, message: str) -> None:
    other = learning_trial.generate(override, dataset=COUNTS, psf={"as_captured": None})
    with pytest.raises(InputError, match=r"data\.validation: " + message):
        find_material(config(tiny_dataset, validation=str(other)))


def test_finer_psfs_of_the_same_camera_are_welcome(tiny_dataset: Path, learning_trial: Any) -> None:
    other = learning_trial.generate("psf.depths=4", dataset=COUNTS, psf={"as_captured": None})
    material = find_material(config(tiny_dataset, validation=str(other)))
    assert material.validation.root == other
    assert len(material.capture.stack.depths_m) == 3
    assert material.capture.white == measure_white(open_dataset(tiny_dataset, "train")) != 1


def test_a_relative_cache_lies_beside_the_file(
    tiny_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from learning.config.load import load_file

    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "work").mkdir()
    path = tmp_path / "work" / "train.yaml"
    path.write_text(f"name: x\noutput: x\nsteps: 1\ndata: {{train: '{tiny_dataset}', cache: kept}}\n")
    monkeypatch.chdir(tmp_path / "elsewhere")
    said: list[str] = []
    open_examples(open_dataset(tiny_dataset, "validation"), load_file(TrainConfig, path), said.append)
    assert any((tmp_path / "work" / "kept").glob("*/measurement.npy"))
    assert list((tmp_path / "elsewhere").iterdir()) == []
    assert said == [f"validation: 8 samples, kept decoded in {tmp_path / 'work' / 'kept'}"]
