"""Every preset of a training can be loaded, and its first line says what it is for."""

from pathlib import Path

import pytest
import yaml

from learning.config.load import load_file
from learning.config.train import TrainConfig
from learning.presets import preset_texts
from simulator.presets import preset_names, preset_text


@pytest.mark.parametrize("name", sorted(name for name, text in preset_texts().items() if "\n# Train: " in text))
def test_preset(name: str, tmp_path: Path) -> None:
    text = preset_texts()[name]
    path = tmp_path / f"{name}.yaml"
    path.write_text(text, encoding="utf-8")
    config = load_file(TrainConfig, path)
    assert text.startswith("# ")
    assert "flatlight train FILE" in text
    assert config.output == f"out/{name}"
    outputs = {yaml.safe_load(preset_text(each))["dataset"]["output"] for each in preset_names()}
    assert config.data.train in outputs  # what `flatlight generate` writes beside it


def test_names_are_offered_and_not_taken() -> None:
    assert not set(preset_texts()) & set(preset_names())
    offered = preset_names(others=True)
    assert set(preset_texts()) <= set(offered)
    assert len(offered) == len(set(offered))
