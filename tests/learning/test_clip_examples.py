"""Examples of clips: what is kept is what would be worked out anew, by whichever process, and of as many draws as asked."""

from __future__ import annotations

import errno
import os
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from learning.clip_examples import ClipExample, ClipExamples, KeptRecords
from learning.data import Draw, ExampleSet, Loader
from learning.simulate import Augmentation, SceneCamera
from simulator.dataset import open_dataset
from simulator.dataset.reader import Dataset
from simulator.io.files import StorageError

AUGMENT = Augmentation()


class Counted:
    """In place of the joint estimate: some numbers of the measurement, and how often they were asked for."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, measurement: Tensor) -> Tensor:
        assert measurement.shape == (1, 3, 48, 48)
        self.calls += 1
        return (measurement[:, None, :, 8:26, 9:27] * torch.arange(1.0, 5.0)[:, None, None, None]).contiguous()


def together(measurements: Tensor) -> Tensor:
    """The same numbers of several."""
    return torch.cat([Counted()(one[None]) for one in measurements])


def nothing(measurement: Tensor) -> None:
    """In place of a network that begins otherwise."""


@pytest.fixture
def train(clip_dataset: Path) -> Dataset:
    return open_dataset(clip_dataset, "train")


@pytest.fixture
def make(train: Dataset, tmp_path: Path) -> Callable[..., ClipExamples]:
    """Make examples, three draws of each, kept in ``tmp_path``."""

    def made(estimate: Any = None, *, augment: Augmentation | None = AUGMENT, **changes: Any) -> ClipExamples:
        given: dict[str, Any] = {
            "identity": {"seed": 5},
            "white": 1.5,
            "measured": False,
            "draws": 3,
            "cache": tmp_path,
        }
        noise = changes.pop("noise_db", None)
        examples = ExampleSet(train, augment=augment, noise_db=noise, seed=5)
        return ClipExamples(examples, Counted() if estimate is None else estimate, **given | changes)

    return made


def same(one: ClipExample, other: ClipExample) -> bool:
    return all(torch.equal(a, b) for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize("measured", [False, True])
def test_what_is_kept_is_what_would_be_worked_out(make: Any, train: Dataset, measured: bool) -> None:
    """Half precision, in which it is kept, is that of examples that are not kept, too; the measurement is exact."""
    estimate = Counted()
    kept, anew = make(estimate, measured=measured), make(cache=None, measured=measured)
    asked = estimate.calls
    examples = ExampleSet(train, augment=AUGMENT, seed=5)
    for draw in (Draw(0, 0), Draw(3, 1), Draw(7, 2), Draw(3, 0), Draw(4, 0), Draw(2, 2)):
        first, again = kept[draw], kept[draw]
        assert same(first, again)
        assert same(first, anew[draw])
        assert all(values.dtype == torch.float32 for values in first[:4])
        wanted = examples[draw]
        assert torch.equal(first.measurement, wanted.measurement)
        # Half precision: 11 bits, and steps of 2^-24 near 0, of white
        torch.testing.assert_close(first.radiance, wanted.radiance, rtol=2**-11, atol=1.5 * 2**-25)
        start = Counted()(wanted.measurement[None])[0]
        torch.testing.assert_close(first.start, start, rtol=2**-11, atol=2**-25)
    assert estimate.calls == asked + 6  # each draw once
    assert len(kept) == 8
    assert kept.dataset is train


def test_dim_scenes_are_kept_as_well_as_bright_ones(make: Any, train: Dataset, monkeypatch: Any) -> None:
    """In units of white: of radiance around 1e-5, half precision alone would leave two digits."""
    read = ExampleSet.__getitem__

    def dim(examples: ExampleSet, draw: Any) -> Any:
        example = read(examples, draw)
        return example._replace(radiance=1e-5 * example.radiance)

    monkeypatch.setattr(ExampleSet, "__getitem__", dim)
    found = make(white=1.5e-5)[Draw(3, 1)].radiance
    wanted = ExampleSet(train, augment=AUGMENT, seed=5)[Draw(3, 1)].radiance
    torch.testing.assert_close(found, wanted, rtol=2**-10, atol=1.5e-5 * 2**-25)


def test_two_processes_share_what_one_has_worked_out(make: Any, tmp_path: Path) -> None:
    first, second = Counted(), Counted()
    one, two = make(first), make(second)
    found = one[Draw(2, 1)]
    before = second.calls
    assert same(two[Draw(2, 1)], found)
    assert second.calls == before
    assert not same(two[Draw(2, 0)], found)  # which one has not written
    assert second.calls == before + 1
    assert len(list(tmp_path.glob("*.clips"))) == 1


def test_draws_are_as_many_as_asked(make: Any) -> None:
    examples = make()
    versions = [examples[Draw(4, number)] for number in range(7)]
    for number in range(3, 7):
        assert same(versions[number], versions[number - 3])
    for number in (1, 2):
        assert not torch.equal(versions[number].radiance, versions[0].radiance)
    assert same(examples[4], versions[0])
    assert not torch.equal(examples[5].radiance, versions[0].radiance)


def test_without_a_number_of_draws_each_is_new_and_none_is_kept(make: Any, tmp_path: Path) -> None:
    estimate = Counted()
    examples = make(estimate, draws=0)
    radiances = [examples[Draw(4, number)].radiance for number in range(6)]
    assert len({float(radiance.sum()) for radiance in radiances}) == 6
    assert torch.equal(examples[Draw(4, 0)].radiance, radiances[0])
    assert estimate.calls == 7
    assert not list(tmp_path.glob("*.clips"))


def test_clips_that_are_not_changed_have_one_version(make: Any, train: Dataset) -> None:
    estimate = Counted()
    examples = make(estimate, augment=None)
    asked = estimate.calls
    for number in (0, 1, 5):
        example = examples[Draw(6, number)]
        assert (example.measurement.numpy() == train[6].measurement).all()
    assert estimate.calls == asked + 1


def test_noise_alone_is_drawn_as_often(make: Any) -> None:
    """Of clips that are not changed, too: their levels and noise differ, what was there does not."""
    examples = make(augment=None, noise_db=(20.0, 40.0))
    versions = [examples[Draw(6, number)] for number in range(4)]
    assert same(versions[3], versions[0])
    for number in (1, 2):
        assert torch.equal(versions[number].radiance, versions[0].radiance)
        assert not torch.equal(versions[number].measurement, versions[0].measurement)
    anew = make(augment=None, noise_db=(20.0, 40.0), draws=0)
    assert not torch.equal(anew[Draw(6, 3)].measurement, versions[0].measurement)


def test_what_is_not_needed_is_empty(make: Any) -> None:
    bare = make(nothing)
    for example in (bare[Draw(1, 2)], bare[Draw(1, 2)]):
        assert [values.numel() for values in example] == [3 * 48 * 48, 4 * 3 * 16 * 16, 0, 0, 0, 0]


@pytest.mark.parametrize("augment", [AUGMENT, None])
@pytest.mark.parametrize("cache", [True, False])
@pytest.mark.parametrize("draws", [3, 0])
def test_global_measurements_are_of_the_clip_as_it_was_changed(
    make: Any, train: Dataset, augment: Augmentation | None, cache: bool, draws: int
) -> None:
    """By the data set's own camera, of the stored frames that are changed here by the same generator."""
    changes: dict[str, Any] = {} if cache else {"cache": None}
    examples, camera = make(augment=augment, measured=True, draws=draws, **changes), SceneCamera(train)
    noise = ExampleSet(train, augment=augment, seed=5)
    for position, number in ((0, 0), (5, 2)):
        clip = train[position].clip()
        if augment is not None:
            clip = augment.apply(clip, noise.generator(position, number))
        wanted = camera.global_measurements(clip, 4)
        for _ in range(2):
            found = examples[Draw(position, number)].measured.numpy()
            assert found.shape == (4, 3, 48, 48)
            np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-6 * wanted.max())  # float32


def test_other_examples_are_kept_apart(make: Any, tmp_path: Path) -> None:
    estimate = Counted()
    for count, changes in enumerate(({}, {"identity": {"seed": 6}}, {"draws": 4}, {"identity": {"seed": 5, "x": 1}})):
        make(estimate, **changes)[Draw(1, 1)]
        assert len(list(tmp_path.glob("*.clips"))) == count + 1
    assert estimate.calls == 8  # at each beginning, and each draw


def test_workers_get_the_same(make: Any) -> None:
    """Pickled, as where processes are spawned; and forked, each of which writes what it has worked out."""
    examples = make(measured=True)
    order = [[Draw(0, 0), Draw(1, 0)], [Draw(2, 1), Draw(0, 2)], [Draw(0, 3), Draw(7, 0)]]
    single = make(measured=True, cache=None)
    examples[Draw(2, 1)]
    for each in (examples, pickle.loads(pickle.dumps(examples))):
        loader = Loader(each, order, 2)
        batches = list(loader)
        loader.close()
        assert len(batches) == 3
        for batch, draws in zip(batches, order, strict=True):
            for index, draw in enumerate(draws):
                assert same(ClipExample(*(values[index] for values in batch)), single[draw])
    estimate = Counted()
    after = make(estimate, measured=True)
    before = estimate.calls
    after[Draw(7, 0)], after[Draw(0, 0)]
    assert estimate.calls == before  # the workers wrote them


@pytest.mark.parametrize("workers", [0, 2])
def test_what_is_begun_ahead_is_what_would_be_worked_out(make: Any, workers: int) -> None:
    """Every version once, of those that are not kept, whichever process does it; the starts come from what is given."""
    estimate, sizes = Counted(), []
    examples, anew = make(estimate), make(cache=None)
    examples[Draw(3, 1)]
    asked = estimate.calls

    def many(measurement: Tensor) -> Tensor:
        sizes.append(len(measurement))
        return together(measurement)

    draws = [Draw(position, number) for number in range(4) for position in range(8)]
    for rank in range(3):
        missing = examples.missing(draws, rank, 3)
        assert list(examples.estimate_ahead(missing, many, 5, workers)) == ([5, 3] if rank != 2 else [5, 2])
        assert not examples.missing(draws, rank, 3)
    assert sizes == [5, 3, 5, 3, 5, 2]  # 8 clips in 3 versions but one
    assert not examples.missing(draws)
    for draw in draws:
        assert same(examples[draw], anew[draw])
    assert estimate.calls == asked


def test_what_is_begun_ahead_is_kept_when_it_is_interrupted(make: Any) -> None:
    examples = make()
    draws = [Draw(position, 0) for position in range(8)]
    ahead = examples.estimate_ahead(
        examples.missing(draws), lambda seen: torch.cat([Counted()(one[None]) for one in seen]), 3, 2
    )
    assert next(ahead) == 3
    ahead.close()
    assert examples.missing(draws) == draws[3:]


@pytest.mark.parametrize("changes", [{"draws": 0}, {"cache": None}, {"draws": 0, "cache": None}])
def test_a_network_on_a_gpu_begins_by_itself_where_nothing_is_kept(make: Any, changes: dict[str, Any]) -> None:
    estimate = Counted()
    examples = make(estimate, on_gpu=True, **changes)
    assert not examples.missing([Draw(1, 1)])
    found, wanted = examples[Draw(1, 1)], make(**changes)[Draw(1, 1)]
    assert estimate.calls == 0
    assert same(found, wanted._replace(start=torch.empty(0)))


def test_a_full_disk_is_named(make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    examples = make()
    wanted = examples[Draw(0, 0)]
    given = []

    def full(descriptor: int, content: bytes, offset: int) -> int:
        given.append(offset)
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "pwrite", full)
    with pytest.raises(StorageError, match=r"\.clips: "):
        examples[Draw(0, 1)]
    assert len(given) == 1  # and no further try
    assert same(examples[Draw(0, 0)], wanted)
    monkeypatch.undo()
    assert same(examples[Draw(0, 1)], make(cache=None)[Draw(0, 1)])


LIKE: dict[str, Any] = {"a": np.zeros((2, 3), np.float32), "b": np.zeros(0, np.float16)}


def test_records_are_there_when_their_checksum_says_so(tmp_path: Path) -> None:
    path = tmp_path / "new" / "x.clips"
    records = KeptRecords(path, LIKE)
    values = {"a": np.arange(6, dtype=np.float32).reshape(2, 3), "b": np.zeros(0, np.float16)}
    assert records.read(0) is None
    records.write(3, values)
    for number in (0, 2, 4):
        assert records.read(number) is None
    for each in (records, KeptRecords(path, LIKE), pickle.loads(pickle.dumps(records))):
        found = each.read(3)
        assert found is not None
        assert list(found) == ["a", "b"]
        np.testing.assert_array_equal(found["a"], values["a"], strict=True)
        np.testing.assert_array_equal(found["b"], values["b"], strict=True)
    # Descriptors of this process mean nothing to one that is spawned.
    assert pickle.loads(pickle.dumps(records))._open() != records._open()
    # Cut off, or filled with zeros, as by a crash before the disk had it; or a bit that has fallen.
    whole = path.read_bytes()
    for damaged in (whole[:-1], whole[:-8] + bytes(8), whole[:-24] + bytes([whole[-24] ^ 4]) + whole[-23:]):
        assert damaged != whole
        path.write_bytes(damaged)
        assert records.read(3) is None
    path.write_bytes(whole)
    assert records.read(3) is not None


def test_a_system_that_takes_a_part_at_a_time_gets_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write = os.pwrite
    monkeypatch.setattr(os, "pwrite", lambda descriptor, content, offset: write(descriptor, content[:7], offset))
    records = KeptRecords(tmp_path / "x.clips", LIKE)
    records.write(2, LIKE)
    records.write(0, {"a": np.full((2, 3), 1.5, np.float32), "b": LIKE["b"]})
    found = records.read(0)
    assert found is not None
    assert (found["a"] == 1.5).all()


def test_a_place_that_cannot_be_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(StorageError, match=r"x\.clips: "):
        KeptRecords(tmp_path / "file" / "x.clips", LIKE)
