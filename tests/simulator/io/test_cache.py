"""The cache computes once, survives damage and two writers, and never stands in the way."""

import io
import multiprocessing
import time

import numpy as np
import pytest

from simulator.io.cache import cache_folder, cached

ENTRY = ({"values": np.arange(12, dtype=np.float32).reshape(3, 4), "other": np.array([1.5])}, {"a": [1, 2], "b": "µ"})


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("FLATLIGHT_CACHE_DIR", str(tmp_path / "cache"))
    return tmp_path / "cache"


class Counter:
    def __init__(self):
        self.calls = 0

    def __call__(self):
        self.calls += 1
        return ENTRY


def _same(entry):
    arrays, metadata = entry
    assert set(arrays) == {"values", "other"}
    for name, array in ENTRY[0].items():
        np.testing.assert_array_equal(arrays[name], array)
        assert arrays[name].dtype == array.dtype
    assert metadata == ENTRY[1]


def test_the_second_call_does_not_compute(folder):
    compute = Counter()
    for _ in range(3):
        _same(cached("psf", "abc", compute))
    assert compute.calls == 1
    assert [path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()] == ["psf/abc.npz"]
    for kind, key in (("psf", "b"), ("mask", "abc")):
        cached(kind, key, compute)
    assert compute.calls == 3


def _flipped(data: bytes) -> bytes:
    """One bit inside the first array: the archive's checksum knows."""
    at = data.index(np.arange(12, dtype=np.float32).tobytes()) + 20
    return data[:at] + bytes([data[at] ^ 4]) + data[at + 1 :]


def _saved(**arrays: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


DAMAGED = {
    "truncated": lambda data: data[: len(data) // 2],
    "empty": lambda data: b"",
    "noise": lambda data: np.random.default_rng(0).bytes(len(data)),
    "one bit": _flipped,
    "without metadata": lambda data: _saved(**ENTRY[0]),
    "pickled": lambda data: _saved(values=np.array([{"a": 1}], object), metadata=np.array("{}")),
    "another file": lambda data: b"PK\x03\x04 no archive at all",
}


@pytest.mark.parametrize("how", DAMAGED)
def test_a_damaged_entry_is_computed_again_and_mended(folder, how):
    compute = Counter()
    cached("psf", "abc", compute)
    path = folder / "psf" / "abc.npz"
    path.write_bytes(DAMAGED[how](path.read_bytes()))
    _same(cached("psf", "abc", compute))
    assert compute.calls == 2
    _same(cached("psf", "abc", compute))
    assert compute.calls == 2  # mended


def test_a_place_that_cannot_be_written_to_is_warned_about(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("not a folder")
    monkeypatch.setenv("FLATLIGHT_CACHE_DIR", str(tmp_path / "file" / "cache"))
    with pytest.warns(UserWarning, match=r"not cached: .*abc\.npz"):
        _same(cached("psf", "abc", Counter()))
    monkeypatch.setenv("FLATLIGHT_CACHE_DIR", str(tmp_path))
    (tmp_path / "psf" / "abc.npz").mkdir(parents=True)
    with pytest.warns(UserWarning, match=r"not cached: .*abc\.npz"):
        _same(cached("psf", "abc", Counter()))


def test_a_computation_that_fails_leaves_nothing(folder):
    def fail():
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        cached("psf", "abc", fail)
    assert not [path for path in folder.rglob("*") if path.is_file()]


def _write(folder: str, barrier, number: int, results) -> None:
    """Compute another entry than the other process, write it at the same moment, and report what came back."""
    import os

    os.environ["FLATLIGHT_CACHE_DIR"] = folder

    def compute():
        barrier.wait(timeout=60)
        return {"values": np.full((300, 300), number, np.float32)}, {"number": number}

    arrays, metadata = cached("psf", "abc", compute)
    results.put((number, metadata["number"], float(arrays["values"].mean())))


def test_two_processes_that_write_at_once_leave_one_whole_entry(folder):
    context = multiprocessing.get_context("spawn")
    barrier, results = context.Barrier(2), context.Queue()
    writers = [context.Process(target=_write, args=(str(folder), barrier, n, results)) for n in (1, 2)]
    for writer in writers:
        writer.start()
    answers = sorted(results.get(timeout=60) for _ in writers)
    for writer in writers:
        writer.join(timeout=60)
        assert writer.exitcode == 0
    assert answers == [(1, 1, 1.0), (2, 2, 2.0)]  # both computed, and each has its own
    arrays, metadata = cached("psf", "abc", Counter())
    assert np.all(arrays["values"] == metadata["number"])
    assert [path.name for path in folder.rglob("*") if path.is_file()] == ["abc.npz"]


def test_a_reader_never_meets_half_an_entry(folder):
    """Many writers of one key and a reader: the entry is absent or whole, whatever the moment."""
    from concurrent.futures import ThreadPoolExecutor

    def write(number):
        from simulator.io.cache import _store

        _store(folder / "psf" / "abc.npz", {"values": np.full(20000, number, np.float32)}, {"number": number})

    with ThreadPoolExecutor(4) as pool:
        jobs = [pool.submit(write, n) for n in range(40)]
        seen = 0
        end = time.monotonic() + 20
        while not all(job.done() for job in jobs) and time.monotonic() < end:
            if (folder / "psf" / "abc.npz").exists():
                with np.load(folder / "psf" / "abc.npz") as file:
                    assert np.all(file["values"] == file["values"][0])
                seen += 1
        for job in jobs:
            job.result()
    assert seen > 0


def test_the_folder_is_the_users_choice(monkeypatch, tmp_path):
    monkeypatch.setenv("FLATLIGHT_CACHE_DIR", str(tmp_path / "mine"))
    assert cache_folder() == tmp_path / "mine"
    monkeypatch.delenv("FLATLIGHT_CACHE_DIR")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert cache_folder().name == "flatlight"
