"""Places in object stores, against a server that knows ``If-None-Match``."""

import errno
import io
import os
import pickle
import tracemalloc
from collections.abc import Iterator
from itertools import count
from pathlib import Path, PurePosixPath

import pytest

from simulator.errors import InputError
from simulator.io import store
from simulator.io.files import StorageError, committed_folder, read_text, sha256_bytes, sha256_file, write_atomic
from simulator.io.lines import StoredLines, read_lines
from simulator.io.store import StorePath, check_store, place, relative_name

NUMBERS = count()


@pytest.fixture
def root(bucket: str) -> StorePath:
    """A place that is empty yet."""
    return StorePath(f"{bucket}/tests/{next(NUMBERS)}")


def test_places_are_named_like_paths() -> None:
    path = place("s3://bucket//a/b/")
    assert isinstance(path, StorePath)
    assert (str(path), path.name, str(path.parent), str(path.parent.parent)) == (
        "s3://bucket/a/b",
        "b",
        "s3://bucket/a",
        "s3://bucket/a",
    )
    assert str(path / "c/d" / "e.json") == "s3://bucket/a/b/c/d/e.json"
    assert (path / "c").relative_to(path) == PurePosixPath("c")
    assert relative_name(path / "c/d", path) == relative_name(Path("x/c/d"), Path("x")) == "c/d"
    assert pickle.loads(pickle.dumps(path)) == path == path.resolve() == path.absolute()
    assert len({path, place("s3://bucket/a/b")}) == 1
    assert sorted([path / "b", path / "a"]) == [path / "a", path / "b"]
    for other in (place("s3://another/a"), place("gs://bucket/a")):
        with pytest.raises(ValueError, match="below"):
            path.relative_to(other)
    with pytest.raises(TypeError):
        os.stat(path)  # type: ignore[arg-type]  # nothing takes it for a file of the disk


@pytest.mark.parametrize(
    "text", ["s3://", "s3://bucket", "s3://bucket/", "ftp://host/x", "s3:///x", "s3://bucket/a/../b", "://x"]
)
def test_what_is_no_address(text: str) -> None:
    with pytest.raises(InputError, match="expected s3://"):
        place(text)
    with pytest.raises(InputError, match=r"without '\.\.'"):
        place("s3://bucket/a") / ".."  # type: ignore[operator]


def test_reading_writing_listing(root: StorePath) -> None:
    assert not root.exists()
    assert list(root.iterdir()) == list(root.glob("*")) == []
    for name in ("a.json", "psf/psf.json", "psf/deep/x.exr", "psf.txt"):
        (root / name).write_bytes(name.encode())
    assert (root / "a.json").read_bytes() == (root / "a.json").open().read() == b"a.json"
    assert (root / "a.json").is_file()
    assert not (root / "a.json").is_dir()
    assert (root / "psf").is_dir()  # and not for the sake of psf.txt
    assert not (root / "ps").exists()
    assert not (root / "psf").is_file()
    assert sorted(path.name for path in root.iterdir()) == ["a.json", "psf", "psf.txt"]
    assert [relative_name(path, root) for path in root.glob("psf/*")] == ["psf/psf.json"]
    assert sorted(relative_name(path, root) for path in root.rglob("*.json")) == ["a.json", "psf/psf.json"]
    with pytest.raises(FileNotFoundError):
        (root / "none").read_bytes()
    (root / "a.json").unlink()
    (root / "a.json").unlink()
    (root / "psf").remove_all()
    assert [path.name for path in root.iterdir()] == ["psf.txt"]


def test_large_objects_are_read_part_by_part(root: StorePath) -> None:
    """A list of a million samples takes the memory of a part, and of what is too large no more than that is fetched."""
    path = root / "manifest.jsonl"
    lines = [b'{"number": %d, "digest": "%064d"}\n' % (number, number) for number in range(300_000)]
    data = b"".join(lines)
    path.write_bytes(data)
    assert len(data) > 3 * store._PART_BYTES
    assert list(read_lines(path)) == lines
    assert sha256_file(path) == sha256_bytes(data)
    with path.open() as file:
        file.seek(-20, io.SEEK_END)
        assert file.read() == data[-20:]
        file.seek(len(data) + 5)
        assert file.read() == b""
        file.seek(store._PART_BYTES - 3)
        assert file.read(6) == data[store._PART_BYTES - 3 :][:6]
    tracemalloc.start()
    with pytest.raises(InputError, match="larger than 1024 KiB"):
        read_text(path, "anything", max_bytes=1 << 20)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2.5 * store._PART_BYTES < len(data)
    with path.open() as file:
        file.read(10)
        path.write_bytes(data[::-1])
        with pytest.raises(OSError, match=r"(?i)precondition"):
            file.read()  # two halves of two objects are none


@pytest.mark.slow
def test_more_objects_than_one_answer_lists(root: StorePath) -> None:
    for number in range(1005):
        (root / f"x/{number:04d}").write_bytes(b"")
    assert len(list((root / "x").iterdir())) == len(list(root.rglob("*"))) == 1005
    (root / "x").remove_all()
    assert not root.exists()


def test_creating_never_overwrites(root: StorePath) -> None:
    assert (root / "a").create(b"1")
    assert not (root / "a").create(b"2")
    assert (root / "a").read_bytes() == b"1"
    check_store(root)
    assert [path.name for path in root.iterdir()] == ["a"]


def test_a_store_that_overwrites_is_refused(root: StorePath, monkeypatch: pytest.MonkeyPatch) -> None:
    """As s3fs did with small files until July 2025."""

    def overwriting(self: StorePath, data: bytes) -> bool:
        self.write_bytes(data)
        return True

    monkeypatch.setattr(StorePath, "create", overwriting)
    with pytest.raises(InputError, match="If-None-Match"):
        check_store(root)
    assert list(root.iterdir()) == []


def test_a_folder_is_whole_once_its_description_is_there(root: StorePath, monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[str] = []
    write, create = StorePath.write_bytes, StorePath.create
    monkeypatch.setattr(StorePath, "write_bytes", lambda self, data: (written.append(self.name), write(self, data)))
    monkeypatch.setattr(StorePath, "create", lambda self, data: (written.append(self.name), create(self, data))[1])

    def commit(text: bytes) -> None:
        with committed_folder(root / "s1", "sample.json") as made:
            (made / "frames").mkdir()
            write_atomic(made / "frames/0.exr", b"frame")
            write_atomic(made / "sample.json", text)
            write_atomic(made / "measurement.exr", b"light")

    commit(b"{}")
    assert written[-1] == "sample.json"
    assert sorted(written[:-1]) == ["0.exr", "measurement.exr"]
    assert (root / "s1/frames/0.exr").read_bytes() == b"frame"
    commit(b"{}")  # by a writer that died before it told
    with pytest.raises(InputError, match=str(root / "s1")):
        commit(b'{"other": 1}')
    assert (root / "s1/sample.json").read_bytes() == b"{}"
    with pytest.raises(ZeroDivisionError), committed_folder(root / "s2", "sample.json"):
        raise ZeroDivisionError
    assert not (root / "s2").exists()


def test_lines_come_in_batches(root: StorePath, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("simulator.io.lines._BATCH_LINES", 3)
    with StoredLines(root / "manifest.jsonl") as lines:
        for number in range(7):
            lines.append_line({"id": number})
        assert [path.name.split(".")[2] for path in sorted(root.iterdir())] == ["0000", "0001"]
    with StoredLines(root / "manifest.jsonl") as lines:  # opened again, it adds to what is there
        lines.append_line({"id": 7})
    assert sum(1 for path in root.iterdir() for _ in read_lines(path)) == 8
    found = [line for path in root.iterdir() for line in read_lines(path)]
    assert sorted(found) == [b'{"id":%d}\n' % number for number in range(8)]
    assert list(read_lines(root / "manifest.jsonl")) == []


def test_what_a_store_refuses_is_a_storage_error_with_a_cure(root: StorePath, bucket: str) -> None:
    with pytest.raises(StorageError, match=r"bucket\) does not exist"):
        write_atomic(StorePath("s3://no-such-bucket/x"), b"")
    with pytest.raises(InputError, match="cannot be read"):
        sha256_file(root / "none")


@pytest.mark.slow
def test_a_store_that_cannot_be_reached(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")  # not allowed without AWS_ALLOW_HTTP: refused at once
    store._client.cache_clear()
    with pytest.raises(StorageError, match="cannot be written") as caught:
        write_atomic(StorePath("s3://bucket/x"), b"")
    assert isinstance(caught.value.__cause__, OSError)
    assert caught.value.__cause__.errno == errno.EIO
    store._client.cache_clear()


@pytest.fixture(autouse=True)
def fresh_clients() -> Iterator[None]:
    """A client keeps the environment of its making."""
    store._client.cache_clear()
    yield
    store._client.cache_clear()
