"""Whose folder it is."""

from pathlib import Path
from typing import Any

import pytest

from learning.training.folder import DESCRIPTION, STATE, check_folder, described, sole_use
from simulator.errors import InputError

CONFIG: dict[str, Any] = {"output": "a", "steps": 5, "seed": 1, "data": {"train": "x", "workers": 2, "cache": True}}


def test_what_does_not_matter(tmp_path: Path) -> None:
    with sole_use(tmp_path / "a", described(CONFIG, {"white": 1.0})):
        pass
    (tmp_path / "a" / STATE).touch()
    free = {"output": "b", "steps": 9, "data": {"train": "x", "workers": 0, "cache": False}}
    check_folder(tmp_path / "a", described(CONFIG | free, {"white": 1.0}))
    with pytest.raises(InputError, match=r"another configuration(.|\n)*\nseed: 1 -> 2\ndata sets.white: 1.0 -> 2.0$"):
        check_folder(tmp_path / "a", described(CONFIG | {"seed": 2}, {"white": 2.0}))


def test_what_never_saved_anything_is_no_hindrance(tmp_path: Path) -> None:
    with sole_use(tmp_path, described(CONFIG, {})):
        pass
    other = described(CONFIG | {"seed": 2}, {})
    check_folder(tmp_path, other)
    with sole_use(tmp_path, other):
        pass
    (tmp_path / STATE).touch()
    check_folder(tmp_path, other)
    with pytest.raises(InputError, match="seed: 2 -> 1"):
        check_folder(tmp_path, described(CONFIG, {}))


def test_a_file_and_a_damaged_description(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="is a file"):
        check_folder(tmp_path / "file", {})
    (tmp_path / DESCRIPTION).write_text("{")
    with pytest.raises(InputError, match=f"{DESCRIPTION} cannot be read"):
        check_folder(tmp_path, {})


def test_one_training_at_a_time(tmp_path: Path) -> None:
    (tmp_path / ".tmp-state.pt-1").touch()
    with sole_use(tmp_path, {}):
        assert [path.name for path in tmp_path.iterdir()] == [DESCRIPTION]
        with pytest.raises(InputError, match="another process trains in"), sole_use(tmp_path, {}):
            pass
    with sole_use(tmp_path, {}):
        pass
