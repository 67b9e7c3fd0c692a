"""The cache of decoded samples: never another data set's, never a half one, written once by many."""

from __future__ import annotations

import errno
import hashlib
import json
import multiprocessing
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from learning.data import Draw, Example, ExampleSet
from learning.sample_cache import Arrays, SampleCache
from simulator.dataset.reader import Dataset, open_dataset
from simulator.errors import InputError
from simulator.io.exr import read_exr, write_exr
from simulator.io.files import StorageError


@pytest.fixture
def validation(tiny_dataset: Path) -> Dataset:
    return open_dataset(tiny_dataset, "validation")


def caches(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.is_dir())


def same(one: Example, other: Example) -> bool:
    return all(torch.equal(a, b) for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize("noise_db", [None, (20, 50)])
def test_a_cached_example_is_the_same_and_needs_no_samples(
    tiny_dataset: Path, tmp_path: Path, noise_db: tuple[float, float] | None
) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(tiny_dataset, copy)
    plain = ExampleSet(open_dataset(copy, "validation"), noise_db=noise_db)
    expected = [plain[Draw(position, 2)] for position in range(8)]
    dataset = open_dataset(copy, "validation")
    ExampleSet(dataset, noise_db=noise_db, cache=tmp_path / "cache")
    shutil.rmtree(copy / "validation")
    cached = ExampleSet(dataset, noise_db=noise_db, cache=tmp_path / "cache")
    assert all(same(cached[Draw(position, 2)], expected[position]) for position in range(8))
    assert same(cached[-1], cached[7])
    with pytest.raises(IndexError):
        cached[8]


def test_what_a_caller_changes_stays_the_callers(validation: Dataset, tmp_path: Path) -> None:
    examples = ExampleSet(validation, cache=tmp_path)
    examples[0].measurement.zero_()
    assert examples[0].measurement.max() > 0.1


def test_samples_that_were_made_again_are_read_again(learning_trial: Any, tmp_path: Path) -> None:
    counts = {"train": 2, "validation": 0, "test": 0}
    folder = learning_trial.generate(dataset=counts, psf={"as_captured": None})
    old = ExampleSet(open_dataset(folder), cache=tmp_path / "cache")[1]
    shutil.rmtree(folder)
    learning_trial.generate("seed=12", dataset=counts, psf={"as_captured": None})
    dataset = open_dataset(folder)
    new = ExampleSet(dataset, cache=tmp_path / "cache")[1]
    assert same(new, ExampleSet(dataset)[1])
    assert not torch.equal(new.measurement, old.measurement)
    part = ExampleSet(dataset[1:], cache=tmp_path / "cache")
    assert len(part) == 1
    assert same(part[0], new)
    redrawn = ExampleSet(dataset, noise_db=(20, 20), cache=tmp_path / "cache")
    assert same(redrawn[1], ExampleSet(dataset, noise_db=(20, 20))[1])
    assert len(caches(tmp_path / "cache")) == 4


def test_a_sample_that_was_replaced_is_read_again(learning_trial: Any, tmp_path: Path) -> None:
    """By its digest: the data set's configuration, and so its fingerprint, stay."""
    folder = learning_trial.generate(dataset={"train": 2, "validation": 0, "test": 0}, psf={"as_captured": None})
    before = open_dataset(folder)
    ExampleSet(before, cache=tmp_path / "cache")
    path = before.folder(1) / "ground_truth.exr"
    planes, metadata = read_exr(path)
    write_exr(
        path, {name: values * np.float32(0.5) if name in "RGB" else values for name, values in planes.items()}, metadata
    )
    manifest = folder / "manifest.jsonl"
    lines = [json.loads(line) for line in manifest.read_text().splitlines()]
    for line in lines:
        if line["id"] == before.ids[1]:
            line["digest"] = hashlib.sha256(path.read_bytes()).hexdigest()
    manifest.write_text("".join(json.dumps(line) + "\n" for line in lines))
    dataset = open_dataset(folder)
    assert dataset.fingerprint == before.fingerprint
    cached = ExampleSet(dataset, cache=tmp_path / "cache")
    assert same(cached[1], ExampleSet(dataset)[1])
    assert same(cached[0], ExampleSet(dataset)[0])
    assert len(caches(tmp_path / "cache")) == 2


@pytest.mark.parametrize("damage", ["truncated", "absent", "header", "empty folder"])
def test_a_half_written_cache_is_redone(validation: Dataset, tmp_path: Path, damage: str) -> None:
    expected = ExampleSet(validation, cache=tmp_path)[7]
    (own,) = caches(tmp_path)
    path = own / "radiance.npy"
    if damage == "truncated":
        os.truncate(path, path.stat().st_size - 100)
    elif damage == "header":
        path.write_bytes(b"\0" * path.stat().st_size)
    else:
        for file in own.iterdir() if damage == "empty folder" else [path]:
            file.unlink()
    assert same(ExampleSet(validation, cache=tmp_path)[7], expected)
    assert caches(tmp_path) == [own]
    assert {file.name for file in own.iterdir()} == {f"{name}.npy" for name in Arrays._fields}


def test_a_sample_that_cannot_be_read_leaves_no_cache(learning_trial: Any, tmp_path: Path) -> None:
    counts = {"train": 2, "validation": 0, "test": 0}
    dataset = open_dataset(learning_trial.generate(dataset=counts, psf={"as_captured": None}))
    path = dataset.folder(1) / "ground_truth.exr"
    planes, metadata = read_exr(path)
    path.write_bytes(path.read_bytes()[:-50])
    with pytest.raises(InputError, match=r"ground_truth\.exr"):
        ExampleSet(dataset, cache=tmp_path / "cache")
    assert caches(tmp_path / "cache") == []
    write_exr(path, planes, metadata)
    assert same(ExampleSet(dataset, cache=tmp_path / "cache")[1], ExampleSet(dataset)[1])


def test_a_disk_that_cannot_be_read_is_not_one_that_cannot_be_written(validation: Dataset, tmp_path: Path) -> None:
    def read(position: int) -> Arrays:
        raise OSError(errno.EIO, "Input/output error")

    with pytest.raises(InputError) as error:
        SampleCache.filled(tmp_path, validation, "measurement", read)
    assert not isinstance(error.value, StorageError)
    assert str(error.value).startswith(f"{validation.folder(0)} cannot be read (Input/output error)")
    assert caches(tmp_path) == []


class _Counted(ExampleSet):
    """Notes every sample that it reads."""

    log: Path

    def _read(self, position: int) -> Arrays:
        with self.log.open("a") as file:
            file.write(f"{position}\n")
        return super()._read(position)


def _fill(dataset: Dataset, folder: Path, barrier: Any, results: Any) -> None:
    barrier.wait()
    examples = _Counted(dataset, cache=folder)
    results.put([examples[position].measurement.sum().item() for position in range(8)])


def test_processes_that_start_together_write_one_cache(validation: Dataset, tmp_path: Path) -> None:
    _Counted.log = tmp_path / "log"
    context = multiprocessing.get_context("fork")
    barrier, results = context.Barrier(4), context.Queue()
    arguments = (validation, tmp_path / "cache", barrier, results)
    processes = [context.Process(target=_fill, args=arguments) for _ in range(4)]
    for process in processes:
        process.start()
    sums = [results.get(timeout=60) for _ in processes]
    for process in processes:
        process.join(timeout=60)
        assert process.exitcode == 0
    assert sums == [[ExampleSet(validation)[position].measurement.sum().item() for position in range(8)]] * 4
    assert sorted(map(int, _Counted.log.read_text().split())) == list(range(8))
    assert len(caches(tmp_path / "cache")) == 1


def test_a_cache_that_cannot_be_written_is_refused(validation: Dataset, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(StorageError, match=r"cannot write .*file"):
        ExampleSet(validation, cache=tmp_path / "file")
