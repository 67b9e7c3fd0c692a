"""The command says what became of a training."""

from pathlib import Path

import pytest
import yaml

from learning.commands.train import train


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
