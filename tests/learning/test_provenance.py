"""Keys of earlier versions: refused with the new name in files, read in results."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import yaml

from learning.checkpoint import load_checkpoint, shipped_checkpoints
from learning.config import TrainConfig, TuneConfig, load_file
from learning.tune.study import load_tuned
from simulator.errors import InputError


@pytest.mark.parametrize(
    ("model", "content", "place"),
    [
        (TrainConfig, {"start": "x"}, "start.*init_from"),
        (TrainConfig, {"network": {"strength": 0.1}}, "network.strength.*regularisation_lambda"),
        (TuneConfig, {"data": {"validation": "d"}, "objective": "picture"}, "objective.*image"),
    ],
)
def test_old_keys_of_files_are_refused_with_the_new_name(tmp_path: Path, model: Any, content: Any, place: str) -> None:
    path = tmp_path / "old.yaml"
    training = {"name": "a", "output": "o", "data": {"train": "d"}, "steps": 1}
    path.write_text(yaml.safe_dump((training if model is TrainConfig else {}) | content))
    with pytest.raises(InputError, match=place):
        load_file(model, path)


def test_what_earlier_versions_wrote_is_read_with_the_new_names(tmp_path: Path) -> None:
    for path in shipped_checkpoints().values():
        checkpoint = load_checkpoint(path)
        assert not {"strength", "floor"} & checkpoint.architecture.keys()
    result = {"method": "cls", "noise_db": 40.0, "parameters": {"strength": 0.3, "floor": 1.0}, "score": 1.0}
    content = {"format": "flatlight tuned", "version": 1, "identity": {}, "trials": [], "results": [result]}
    (tmp_path / "tuned.json").write_text(json.dumps(content))
    parameters, _ = load_tuned(tmp_path / "tuned.json").parameters("cls", 30.0)
    assert parameters == {"regularisation_lambda": 0.3, "tikhonov": 1.0}
