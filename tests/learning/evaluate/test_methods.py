"""Methods that know the test scenes are refused, by the fingerprint and split that their files record."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from learning.evaluate.methods import check_learned, check_tuned
from learning.tune.study import Study
from simulator.dataset.reader import open_dataset
from simulator.errors import InputError


def _record(train: str, validation: str) -> dict[str, Any]:
    return {"data sets": {"train": {"fingerprint": train}, "validation": {"fingerprint": validation}, "white": 1.0}}


@pytest.mark.parametrize(
    ("split", "message"), [("train", "learned from the scenes"), ("validation", "was chosen among its own steps by")]
)
def test_a_network_that_knows_the_scenes_is_refused(tiny_dataset: Path, split: str, message: str) -> None:
    test = open_dataset(tiny_dataset, split)
    of_it = {"train": "0" * 64, "validation": "1" * 64} | {split: test.fingerprint}
    with pytest.raises(InputError, match=r"^Net: "):
        check_learned("Net", Path("net.safetensors"), _record(**of_it), test)
    start = {"init_from": {"record": _record(**of_it)}, **_record("2" * 64, "3" * 64)}
    with pytest.raises(InputError, match=message):  # what it was warm-started with knew them
        check_learned("Net", Path("net.safetensors"), start, test)
    decides = open_dataset(tiny_dataset, "test")
    check_learned("Net", Path("net.safetensors"), _record(test.fingerprint, test.fingerprint), decides)
    check_learned("Net", Path("net.safetensors"), {}, test)  # nothing is known


def test_only_the_split_that_was_tuned_on_is_refused(tiny_dataset: Path, tmp_path: Path) -> None:
    test = open_dataset(tiny_dataset, "test")
    for split in ("test", "validation"):
        path = tmp_path / f"{split}.json"
        study = Study(path, {"data": test.fingerprint, "split": split}, {})
        study.add_result({"method": "cls", "noise_db": 40.0, "parameters": {}, "score": 1.0})
    check_tuned("CLS", tmp_path / "validation.json", test)
    with pytest.raises(InputError, match=r"^CLS: "):
        check_tuned("CLS", tmp_path / "test.json", test)
