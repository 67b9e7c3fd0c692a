"""The command: a table in the terminal, and one clear line per mistake in its file."""

from pathlib import Path
from typing import Any

import pytest
import yaml

from learning.commands.evaluate import evaluate
from simulator.errors import InputError


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
