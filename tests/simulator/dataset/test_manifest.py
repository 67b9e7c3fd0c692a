"""The manifest: survives any crash of its writer with every finished line."""

import errno
import os
import shutil
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from simulator.dataset.manifest import (
    MANIFEST,
    WRITERS,
    FailedWriter,
    ManifestWriter,
    load_failed,
    load_manifest,
    load_skipped,
)
from simulator.dataset.sample import SampleRecord, sample_id
from simulator.errors import InputError
from simulator.io import files
from simulator.io.files import StorageError


def record(index: int, split: str = "train", digest: str = "a" * 64) -> SampleRecord:
    return SampleRecord(sample_id(index), split, digest, 7, "läbel")


def write(root: Path, *records: SampleRecord) -> bytes:
    with ManifestWriter(root) as writer:
        for item in records:
            writer.append(item, seconds=1.23456)
    return (root / MANIFEST).read_bytes()


def test_lines_come_back_in_order_and_the_last_of_duplicates_wins(tmp_path: Path) -> None:
    assert load_manifest(tmp_path).entries == {}
    data = write(tmp_path, record(10_001), record(2, "test"), record(9_999), record(10_000))
    write(tmp_path, record(0))
    manifest = load_manifest(tmp_path)
    assert manifest.ids("train") == ["s00000000", "s00009999", "s00010000", "s00010001"]
    assert manifest.ids("test") == ["s00000002"]
    assert manifest.ids("validation") == []
    entry = manifest.entries["test", "s00000002"]
    assert (entry.digest, entry.seed, entry.label, entry.seconds) == ("a" * 64, 7, "läbel", 1.2346)
    assert not manifest.torn
    assert data.count(b"\n") == 4
    assert max(map(len, data.splitlines())) < 200  # short lines: they are read thousands at a time
    write(tmp_path, record(2), record(2, digest="b" * 64))
    manifest = load_manifest(tmp_path)
    assert [manifest.entries[split, "s00000002"].digest[0] for split in ("train", "test")] == ["b", "a"]
    assert manifest.duplicates == 1


def test_a_line_torn_anywhere_costs_only_itself(tmp_path: Path) -> None:
    whole = write(tmp_path, record(0), record(1))
    first = whole.index(b"\n") + 1
    for length in range(first + 1, len(whole)):
        (tmp_path / MANIFEST).write_bytes(whole[:length])
        manifest = load_manifest(tmp_path)
        assert manifest.torn
        assert manifest.ids("train") == ["s00000000"]
    assert write(tmp_path, record(1)) == whole  # the torn piece was cut before the new line
    (tmp_path / MANIFEST).write_bytes(whole[:5])
    assert write(tmp_path) == b""
    (tmp_path / MANIFEST).write_bytes(whole[:first] + b"\0" * 10_000)  # blocks that a power cut left empty
    assert write(tmp_path, record(1)) == whole


@pytest.mark.parametrize(
    "line",
    [
        *(b"", b"hello", b"[]", b"{}", b'{"id": "s1"}'),
        b'{"id":"x","split":"train","digest":"' + b"a" * 64 + b'","seed":7,"label":null,"seconds":1}',
        b'{"id":"s00000001","split":"pilot","digest":"' + b"a" * 64 + b'","seed":7,"label":null,"seconds":1}',
        b'{"id":"s00000001","split":"train","digest":3,"seed":7,"label":null,"seconds":1}',
        *(
            b'{"id":"s00000001","split":"train","digest":"' + b"a" * 64 + b'","seed":7,"label":null,' + times + b"}"
            for times in (b'"seconds":NaN', b'"seconds":1e999', b'"seconds":-1', b'"seconds":1' + b"0" * 400)
        ),
        b'{"id":"s00000001","split":"train","digest":"'
        + b"a" * 64
        + b'","seed":7,"label":null,"seconds":1,"stages":[NaN]}',
    ],
)
def test_bad_lines_before_the_end_are_named(tmp_path: Path, line: bytes) -> None:
    whole = write(tmp_path, record(0))
    (tmp_path / MANIFEST).write_bytes(whole + line + b"\n" + whole)
    with pytest.raises(InputError, match=r"manifest\.jsonl:2: "):
        load_manifest(tmp_path)


def test_one_writer_at_a_time(tmp_path: Path) -> None:
    with ManifestWriter(tmp_path) as writer:
        with pytest.raises(InputError, match="another process"):
            ManifestWriter(tmp_path)
        writer.append(record(0), 1.0)
    write(tmp_path, record(1))
    assert load_manifest(tmp_path).ids("train") == ["s00000000", "s00000001"]
    (tmp_path / "file").touch()
    with pytest.raises(StorageError, match="file/no"):
        ManifestWriter(tmp_path / "file/no")
    write(tmp_path / "new/one", record(2))  # a folder that is not there is made


def test_a_full_disk_tears_no_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = os.write
    with ManifestWriter(tmp_path) as writer:
        writer.append(record(0), 1.0)
        before = (tmp_path / MANIFEST).read_bytes()
        taken = iter([10])

        def full(descriptor: int, data) -> int:
            size = next(taken, None)
            if size is None:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return real(descriptor, data[:size])

        monkeypatch.setattr(files.os, "write", full)
        with pytest.raises(StorageError, match="disk is full"):
            writer.append(record(1), 1.0)
        assert (tmp_path / MANIFEST).read_bytes() == before
        monkeypatch.undo()
        writer.append(record(2), 1.0)
    assert load_manifest(tmp_path).ids("train") == ["s00000000", "s00000002"]


def test_a_list_of_skipped_samples_that_was_torn_or_spoilt(tmp_path: Path) -> None:
    path = tmp_path / "skipped.jsonl"
    path.write_text('{"id":"s00000003","split":"train","reason":"bad"}\n{"id":"s0000')
    assert load_skipped(tmp_path) == {("train", "s00000003"): "bad"}
    path.write_text('{"id":"s00000003","split":"all","reason":"bad"}\n')
    with pytest.raises(InputError, match=r"skipped\.jsonl:1: "):
        load_skipped(tmp_path)


def test_lists_are_read_while_those_of_writers_come_and_go(tmp_path: Path) -> None:
    """As between a listing of ``writers/`` and one of a folder in it, when the last shard to end has merged them."""
    done = threading.Event()

    def come_and_go() -> None:
        while not done.is_set():
            for name in "abc":
                (tmp_path / WRITERS / name).mkdir(parents=True)
            shutil.rmtree(tmp_path / WRITERS)

    with ThreadPoolExecutor(1) as pool:
        going = pool.submit(come_and_go)
        try:
            for _ in range(3000):
                assert not load_manifest(tmp_path).entries
        finally:
            done.set()
        going.result()


def test_failures_come_back_in_order(tmp_path: Path) -> None:
    assert load_failed(tmp_path) == {}
    with FailedWriter(tmp_path) as failed:
        for index, split in ((5, "test"), (3, "train")):
            failed.append(split, index, "SystemExit: 0", 3, "Traceback")
    found = load_failed(tmp_path)
    assert list(found) == [("train", "s00000003"), ("test", "s00000005")]
    assert vars(found["test", "s00000005"]) == {"reason": "SystemExit: 0", "attempts": 3, "traceback": "Traceback"}
    (tmp_path / "failed.jsonl").write_text(
        '{"id":"s00000003","split":"train","reason":"bad","attempts":"3","traceback":""}\n'
    )
    with pytest.raises(InputError, match=r"failed\.jsonl:1: "):
        load_failed(tmp_path)
