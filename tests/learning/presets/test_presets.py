"""Every preset of a training can be loaded, and its first line says what it is for."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from learning.config import DenoiserConfig, EvaluateConfig, TrainConfig, TuneConfig, load_file
from learning.presets import preset_texts
from simulator.config import load_config
from simulator.presets import preset_names, preset_text


@pytest.mark.parametrize("name", sorted(name for name, text in preset_texts().items() if "\n# Train: " in text))
def test_preset(name: str, tmp_path: Path) -> None:
    text = preset_texts()[name]
    denoiser = name.startswith("denoiser")
    config = load_file(DenoiserConfig if denoiser else TrainConfig, _written(name, tmp_path))
    assert text.startswith("# ")
    assert f"flatlight {'train-denoiser' if denoiser else 'train'} FILE" in text
    assert config.output == f"out/{name}"
    outputs = {yaml.safe_load(preset_text(each))["dataset"]["output"] for each in preset_names()}
    assert config.data.train in outputs  # what `flatlight generate` writes beside it


def test_names_are_offered_and_not_taken() -> None:
    assert not set(preset_texts()) & set(preset_names())
    offered = preset_names(others=True)
    assert set(preset_texts()) <= set(offered)
    assert len(offered) == len(set(offered))


def _written(name: str, tmp_path: Path) -> Path:
    path = tmp_path / f"{name}.yaml"
    path.write_text(preset_texts()[name], encoding="utf-8")
    return path


def test_the_tuning_is_on_the_validation_split_of_the_training_data(tmp_path: Path) -> None:
    config = load_file(TuneConfig, _written("tune_64", tmp_path))
    assert "flatlight tune FILE" in preset_texts()["tune_64"]
    assert str(config.data.validation) == yaml.safe_load(preset_text("flying_things_64"))["dataset"]["output"]
    assert config.data.split == "validation"


def test_the_refinement_goes_on_from_what_the_training_writes(tmp_path: Path) -> None:
    first, further = (
        load_file(TrainConfig, _written(name, tmp_path)) for name in ("flatnet3d_64", "flatnet3d_refined_64")
    )
    assert further.init_from == f"{first.output}/best.safetensors"
    assert further.network.numbers == first.network.numbers | {"refinements": 1}
    assert (further.data, further.loss) == (first.data, first.loss)


def test_the_evaluation_reads_what_trainings_and_tuning_write(tmp_path: Path) -> None:
    config = load_file(EvaluateConfig, _written("evaluate_64", tmp_path))
    presets = preset_texts()
    networks = ("flatnet3d_refined_64", "flatnet3d_64", "flatnet2d_64")
    for method, preset in zip(config.methods, networks, strict=False):
        output = yaml.safe_load(presets[preset])["output"]
        assert method.checkpoints is not None
        assert method.checkpoints[0] == f"{output}/best.safetensors"
        assert len(method.checkpoints) == 3
    tuning = load_file(TuneConfig, _written("tune_64", tmp_path))
    assert [method.classical for method in config.methods[len(networks) :]] == tuning.methods
    assert {method.tuned for method in config.methods[len(networks) :]} == {str(tuning.output)}
    assert config.noise_db == tuning.noise_db
    assert config.data.training == yaml.safe_load(preset_text("flying_things_64"))["dataset"]["output"]


def test_the_commands_at_its_head_make_the_data_that_it_reads(tmp_path: Path) -> None:
    head = preset_texts()["evaluate_64"].split("# First:")[0].replace("\\\n#", " ")
    commands = [line.split("flatlight generate ", 1)[1].split() for line in head.splitlines() if "generate" in line]
    path = tmp_path / "flying_things_64.yaml"
    path.write_text(preset_text("flying_things_64"), encoding="utf-8")
    config = load_file(EvaluateConfig, _written("evaluate_64", tmp_path))
    made = [load_config(path, words[2::2]) for words in commands]
    assert [str(one.dataset.output) for one in made] == [config.data.training, config.data.test]
    assert made[0].psf.as_captured is not None  # pyright: ignore[reportAttributeAccessIssue]
    assert (made[1].psf.model, made[1].psf.depths) == ("exact", 25)  # pyright: ignore[reportAttributeAccessIssue]
    assert (made[1].dataset.train, made[1].dataset.validation, made[1].dataset.test) == (0, 0, 240)
