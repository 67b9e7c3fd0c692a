"""Listing folders: what systems leave behind is not seen, links are followed once, an unreadable folder is named."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

from simulator.errors import InputError
from simulator.importers.listing import counting_fault, is_hidden, list_folder, walk


@pytest.mark.parametrize("name", ["._00000.jpg", ".DS_Store", ".ipynb_checkpoints", "__MACOSX", "Thumbs.db"])
def test_what_systems_leave_behind_is_hidden(tmp_path: Path, name: str) -> None:
    assert is_hidden(name)
    (tmp_path / name).mkdir()
    (tmp_path / name / "00000.jpg").touch()
    (tmp_path / "00001.jpg").touch()
    assert list_folder(tmp_path) == ([], ["00001.jpg"])
    assert list(walk(tmp_path)) == [(tmp_path, ["00001.jpg"])]
    assert list(walk(tmp_path / name)) == [(tmp_path / name, ["00000.jpg"])]  # it was asked for
    assert list_folder(tmp_path / "none") == ([], [])


def test_no_folder_is_given_twice(tmp_path: Path) -> None:
    """Under a second name its pictures would be a second sequence, and splits could share it."""
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "1.png").touch()
    for name in ("a", "c"):
        (tmp_path / name).symlink_to(tmp_path / "b", target_is_directory=True)
    assert list(walk(tmp_path)) == [(tmp_path, []), (tmp_path / "b", ["1.png"])]


def test_links_are_followed_but_never_in_a_circle(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "1.png").touch()
    root = tmp_path / "root"
    (root / "a").mkdir(parents=True)
    (root / "a" / "up").symlink_to(root, target_is_directory=True)
    (root / "linked").symlink_to(tmp_path / "elsewhere", target_is_directory=True)
    assert list(walk(root)) == [(root, []), (root / "a", []), (root / "linked", ["1.png"])]


def test_a_folder_that_may_not_be_read_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "shut").mkdir()
    scandir = os.scandir

    def refuse(path: Any) -> Any:
        if Path(path).name == "shut":
            raise PermissionError(13, "Permission denied", str(path))
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refuse)
    with pytest.raises(InputError, match=r"^path: "):
        list(walk(tmp_path))


def test_only_counts_have_gaps() -> None:
    every_fifth = [f"{number:05d}.jpg" for number in range(0, 30, 5)]
    assert counting_fault(every_fifth) is None
    assert counting_fault([*every_fifth[:2], *every_fifth[3:]]) is not None
    assert counting_fault(["1305031102.175304.png", "1305031102.211214.png", "1305031102.243211.png"]) is None
    assert counting_fault(["a.png", "b.png", "c.png"]) is None
    assert counting_fault(["a1.png", "a2.png", "b3.png", "b9.png"]) is None
    two = counting_fault(["s3_1.png", "s3_2.png", "s3_4.png", "s3_5.png", "s3_6.png", "s3_7.png", "s3_9.png"])
    assert two is not None
    assert "after s3_2.png (the next is s3_4.png, and 1 times more)" in two
