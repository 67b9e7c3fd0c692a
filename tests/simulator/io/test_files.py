"""Atomic writing: nothing half-written, nothing lost, and clear words when the disk refuses."""

import errno
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from simulator.errors import InputError
from simulator.io import files
from simulator.io.files import (
    StorageError,
    committed_file,
    committed_folder,
    expanded,
    leftovers,
    not_plain,
    read_limited,
    remove_leftovers,
    sha256_bytes,
    sha256_file,
    write_atomic,
)
from simulator.io.lines import read_lines

SHA256_ABC = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"  # FIPS 180-4, example B.1


def refuse_writes(monkeypatch: pytest.MonkeyPatch, number: int, after: int = 0) -> None:
    """Make ``os.write`` take ``after`` bytes in all and then fail with this errno, as a full disk does."""
    left = after
    real = os.write

    def write(descriptor: int, data) -> int:
        nonlocal left
        if left <= 0:
            raise OSError(number, os.strerror(number))
        taken = real(descriptor, bytes(data)[: min(left, 3)])
        left -= taken
        return taken

    monkeypatch.setattr(files.os, "write", write)


def test_names_that_no_file_can_have(tmp_path: Path) -> None:
    assert expanded("~/x", tmp_path) == Path.home() / "x"
    assert expanded(f"a/{'ü' * 127}", tmp_path).parent == tmp_path / "a"
    for text in ("~nobody-at-all/x", f"a/{'ü' * 128}", "x/" * 2500):
        with pytest.raises(InputError, match=r"^'"):
            expanded(text, tmp_path)


def test_write_atomic_replaces_and_respects_the_umask(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(b"old")
    mask = os.umask(0o027)
    try:
        write_atomic(path, b"new")
    finally:
        os.umask(mask)
    assert path.read_bytes() == b"new"
    assert path.stat().st_mode & 0o777 == 0o640
    assert [entry.name for entry in tmp_path.iterdir()] == ["x"]


@pytest.mark.parametrize(
    ("name", "words"),
    [("ENOSPC", "full"), ("EDQUOT", "quota"), ("EFBIG", "bigger"), ("EIO", "disk"), ("EACCES", "permission")],
)
def test_full_disk_keeps_the_old_file_and_says_how_to_resume(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, words: str
) -> None:
    path = tmp_path / "x"
    refuse_writes(monkeypatch, getattr(errno, name), after=8)
    write_atomic(path, b"old")  # three bytes at a time: short writes are continued
    with pytest.raises(StorageError, match=words) as caught:
        write_atomic(path, b"0123456789")
    assert str(path) in str(caught.value)
    assert path.read_bytes() == b"old"
    assert list(leftovers(tmp_path)) == []


def test_a_refused_check_leaves_nothing(tmp_path: Path) -> None:
    def check(path: Path) -> None:
        assert path.read_bytes() == b"data"  # the check sees the whole file, under a temporary name
        assert path.name != "x"
        raise InputError("x", "refused")

    with pytest.raises(InputError, match=r"^x: "):
        write_atomic(tmp_path / "x", b"data", check)
    assert list(tmp_path.iterdir()) == []


def test_missing_folder_and_file_in_the_way(tmp_path: Path) -> None:
    with pytest.raises(StorageError, match="does not exist"):
        write_atomic(tmp_path / "no" / "x", b"")
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(StorageError, match="file, not a folder"), committed_folder(tmp_path / "file" / "s1"):
        pass


def test_committed_folder_appears_at_once_and_replaces(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "s1"
    for content in (b"first", b"second"):
        with committed_folder(folder) as temporary:
            (temporary / "f").write_bytes(content)
            assert not folder.exists() or (folder / "f").read_bytes() == b"first"
        assert (folder / "f").read_bytes() == content
    assert [entry.name for entry in folder.parent.iterdir()] == ["s1"]


def test_a_folder_that_several_write_at_once_is_whole_at_the_end(tmp_path: Path) -> None:
    folder = tmp_path / "s1"

    def write(number: int) -> None:
        for _ in range(150):
            with committed_folder(folder) as temporary:
                for name in "ab":
                    (temporary / name).write_text(str(number))

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(write, range(4)))
    assert (folder / "a").read_text() == (folder / "b").read_text()
    assert list(tmp_path.iterdir()) == [folder]


def test_committed_folder_is_dropped_when_the_block_raises(tmp_path: Path) -> None:
    def interrupted() -> None:
        with committed_folder(tmp_path / "s1") as temporary:
            (temporary / "f").write_bytes(b"half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert list(tmp_path.iterdir()) == []


def test_leftovers_of_a_killed_writer_are_found_and_removed(tmp_path: Path) -> None:
    (tmp_path / "train" / ".tmp-s1-ab" / "inner").mkdir(parents=True)
    (tmp_path / "train" / "s2").mkdir()
    (tmp_path / ".tmp-x-cd").write_bytes(b"")
    assert {path.name for path in leftovers(tmp_path)} == {".tmp-s1-ab", ".tmp-x-cd"}
    assert remove_leftovers(tmp_path) == 2
    assert sorted(str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*")) == ["train", "train/s2"]


def test_sha256_of_a_published_example(tmp_path: Path) -> None:
    (tmp_path / "abc").write_bytes(b"abc")
    assert sha256_file(tmp_path / "abc") == sha256_bytes(b"abc") == SHA256_ABC
    with pytest.raises(InputError, match="gone: "):
        sha256_file(tmp_path / "gone")


def test_a_committed_file_appears_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "made" / "on the way" / "x"
    with committed_file(path) as temporary:
        temporary.write_bytes(b"half")
        assert not path.exists()
        temporary.write_bytes(b"whole")
    assert path.read_bytes() == b"whole"
    with pytest.raises(KeyError), committed_file(path) as temporary:
        {}[temporary.write_bytes(b"half")]
    with pytest.raises(StorageError), committed_file(path):
        pass  # nobody wrote it
    assert path.read_bytes() == b"whole"
    assert [entry.name for entry in path.parent.iterdir()] == ["x"]


def test_what_is_neither_a_file_nor_a_folder(tmp_path: Path) -> None:
    """Everything is found, and nothing is looked at beyond a link."""
    root = tmp_path / "root"
    (root / "a" / "b").mkdir(parents=True)
    (root / "a" / "file").touch()
    assert list(not_plain(root)) == []
    (tmp_path / "outside").mkdir()
    os.mkfifo(tmp_path / "outside" / "pipe")
    (root / "a" / "b" / "link").symlink_to(tmp_path / "outside")
    (root / "a" / "gone").symlink_to(tmp_path / "nothing")
    os.mkfifo(root / "pipe")
    assert sorted(not_plain(root)) == [root / "a/b/link", root / "a/gone", root / "pipe"]
    with pytest.raises(InputError, match="nowhere"):
        list(not_plain(tmp_path / "nowhere"))


def test_reading_is_limited(tmp_path: Path) -> None:
    path = tmp_path / "x"
    path.write_bytes(b"12345")
    assert read_limited(path, "digits", 5) == b"12345"
    with pytest.raises(InputError, match="expected digits"):
        read_limited(path, "digits", 4)
    os.mkfifo(tmp_path / "pipe")
    for place in (tmp_path / "pipe", tmp_path, tmp_path / "gone"):
        with pytest.raises(InputError, match=place.name):
            read_limited(place, "digits")
    with path.open("ab") as file:
        file.truncate(1 << 40)
    with pytest.raises(InputError, match="line of more than"):
        list(read_lines(path))
