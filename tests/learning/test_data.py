"""The examples of a data set: what was stored, or the same with other noise, in every process alike."""

from __future__ import annotations

import errno
import hashlib
import json
import multiprocessing
import os
import pickle
import shutil
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy import stats
from torch.utils.data import DataLoader, default_collate

from learning.data import (
    CACHE,
    Arrays,
    Batches,
    Draw,
    Example,
    ExampleSet,
    Loader,
    SampleCache,
    check_dataset,
    measured_psnr_db,
)
from learning.simulate import Augmentation, SceneCamera
from simulator.dataset.reader import Dataset, open_dataset
from simulator.dataset.sample import StoredSample, sample_index
from simulator.errors import InputError
from simulator.io.exr import read_exr, write_exr
from simulator.io.files import StorageError


@pytest.fixture(scope="module")
def train(tiny_dataset: Path) -> Dataset:
    return open_dataset(tiny_dataset, "train")


@pytest.fixture
def validation(tiny_dataset: Path) -> Dataset:
    return open_dataset(tiny_dataset, "validation")


def with_noise(dataset: Dataset, **noise: Any) -> Dataset:
    """Return the data set as if its configuration had said another noise."""
    camera = dataset.config["camera"] | {"noise": noise}
    info = replace(dataset.info, config=dataset.config | {"camera": camera})
    return Dataset(dataset.root, dataset.split, dataset.ids, info)


def copied(root: Path, folder: Path) -> Dataset:
    """Return a copy of the validation split, to be damaged."""
    shutil.copytree(root / "validation", folder / "validation")
    for name in ("dataset.json", "manifest.jsonl"):
        shutil.copy(root / name, folder / name)
    return open_dataset(folder, "validation")


def same(one: Example, other: Example) -> bool:
    return all(torch.equal(a, b) for a, b in zip(one, other, strict=True))


def same_measurement(one: Example, other: Example) -> bool:
    return torch.equal(one.measurement, other.measurement)


def test_an_example_is_the_stored_sample(train: Dataset) -> None:
    examples, sample = ExampleSet(train), train[5]
    example = examples[5]
    assert len(examples) == len(train) == 32
    assert (example.measurement.numpy() == sample.measurement).all()
    assert (example.radiance.permute(1, 2, 0).numpy() == sample.rgb[0]).all()
    assert (example.depth_m[0].numpy() == sample.depth_m[0]).all()
    assert example.valid[0].logical_not().nonzero().tolist() == [[0, 0]]
    assert [values.dtype for values in example] == [torch.float32] * 3 + [torch.bool]
    batch = default_collate([examples[Draw(0, 0)], example])
    assert isinstance(batch, Example)
    assert [tuple(values.shape) for values in batch] == [(2, 3, 48, 48), (2, 3, 16, 16), (2, 1, 16, 16), (2, 1, 16, 16)]


@pytest.mark.parametrize("asked_db", [20.0, 50.0])
def test_redrawn_noise_has_mean_zero_and_the_asked_psnr(train: Dataset, asked_db: float) -> None:
    dataset = with_noise(train, type="gaussian", psnr_db=40)  # neither clipped nor quantised, which would bias both
    examples = ExampleSet(dataset, noise_db=(asked_db, asked_db))
    errors = []
    for position in range(32):
        noiseless = dataset[position].noiseless.astype(np.float64)
        draws = [examples[Draw(position, number)].measurement.numpy() for number in range(5)]
        errors += [(draw - noiseless) / noiseless.max() for draw in draws]
    error = np.stack(errors)
    assert error.size > 1e6
    deviation = 10 ** (-asked_db / 20)
    # Of N values, the mean is off by 1 / sqrt(N) of a deviation and the PSNR by 20 lg(1 + 1 / sqrt(2 N)) = 0.006 dB.
    assert abs(error.mean()) < 5 * deviation / np.sqrt(error.size)
    assert -10 * np.log10(np.mean(error**2)) == pytest.approx(asked_db, abs=0.03)
    # White and Gaussian: neighbours, channels and draws know nothing of each other.
    scaled = error / deviation
    assert stats.kstest(scaled[::16].ravel(), "norm").pvalue > 1e-3
    for shifted in (np.roll(scaled, 1, -1), np.roll(scaled, 1, 1), np.roll(scaled, 1, 0)):
        assert abs(np.mean(scaled * shifted)) < 5 / np.sqrt(error.size)


def test_half_of_the_levels_lie_in_the_upper_quarter(train: Dataset) -> None:
    """20 to 50 dB: 50 - 30 u^2, u uniform; sqrt((50 - level) / 30) is uniform, and 1 / 2 at 42.5 dB."""
    dataset = with_noise(train[:4], type="gaussian", psnr_db=40)
    examples = ExampleSet(dataset, noise_db=(20, 50))
    levels_db = []
    for position in range(4):
        noiseless = dataset[position].noiseless
        for number in range(60):
            error = examples[Draw(position, number)].measurement.numpy() - noiseless
            levels_db.append(20 * np.log10(noiseless.max() / error.std()))
    # Measured on 6912 values, a level is off by 0.08 dB at most times.
    assert 19.7 < min(levels_db) < 23
    assert 49.5 < max(levels_db) < 50.3
    shares = np.sqrt(np.clip(50 - np.array(levels_db), 0, None) / 30)
    assert stats.kstest(shares, "uniform").pvalue > 1e-3
    assert abs(np.count_nonzero(np.array(levels_db) > 42.5) - 120) < 31  # four deviations of 7.7


def test_redrawn_measurements_are_clipped_and_quantised_as_the_data_sets_are(train: Dataset) -> None:
    plain = ExampleSet(with_noise(train, type="gaussian", psnr_db=40), noise_db=(20, 20))
    levels = 2.0**12
    stored = ExampleSet(train, noise_db=(20, 20))
    clipped = 0
    for position in range(4):
        noisy = plain[position].measurement.double().numpy()
        expected = np.clip(noisy, 0, 1 - 1 / levels)
        got = stored[position].measurement.double().numpy()
        clipped += np.count_nonzero(expected != noisy)
        assert (got * levels == np.round(got * levels)).all()
        # Half a step, and float32 on top.
        assert np.abs(got - expected).max() <= 0.5 / levels + 1e-7
    assert clipped > 0
    none = ExampleSet(with_noise(train, type="none"), noise_db=(20, 20))
    assert same(none[3], plain[3])


def test_levels_of_noise_are_of_the_light_above_the_black_level(learning_trial: Any) -> None:
    """A dim image: its light is a hundredth of its black level, 64 of 4096, and means of 8 x 8 pixels have fine steps."""
    noise = {"type": "physical"}
    root = learning_trial.generate(camera={"noise": noise}, dataset={"train": 2, "validation": 0, "test": 0})
    bright = open_dataset(root, "train")
    factor = 100 * (bright[0].noiseless.max() - 64 / 4096) / (64 / 4096)
    full_scale = float(bright.info.exposure["full_scale"] * factor)
    dim = {"camera": {"noise": noise, "exposure": {"full_scale": full_scale}}, "dataset": {"output": "dim", "train": 2}}
    train = open_dataset(learning_trial.generate("dataset.validation=0", "dataset.test=0", **dim), "train")
    examples = ExampleSet(train, noise_db=(30, 30))
    for position in range(2):
        noiseless = train[position].noiseless.astype(np.float64)
        light = noiseless.max() - 64 / 4096
        assert light < 2e-2 * noiseless.max()
        error = examples[position].measurement.double().numpy() - noiseless
        assert 20 * np.log10(light / error.std()) == pytest.approx(30, abs=0.2)
    own = [train.stored(position).measurement() for position in range(2)]
    by_hand = [20 * np.log10((clean.max() - 64 / 4096) / (noisy - clean).std()) for noisy, clean in own]
    assert measured_psnr_db(train) == pytest.approx(np.mean(by_hand), abs=0.1)


def test_noise_depends_on_seed_split_sample_and_draw_alone(tiny_dataset: Path, train: Dataset) -> None:
    def drawn(dataset: Dataset, position: int, number: int, seed: int = 3) -> torch.Tensor:
        examples = ExampleSet(with_noise(dataset, type="none"), noise_db=(30, 30), seed=seed)
        noiseless = torch.from_numpy(dataset[position].noiseless)
        return (examples[Draw(position, number)].measurement - noiseless) / noiseless.max()

    first = drawn(train, 4, 7)
    assert torch.equal(first, drawn(train, 4, 7))
    assert torch.equal(first, drawn(train[4:5], 0, 7))  # the sample counts, not its place
    validation = open_dataset(tiny_dataset, "validation")
    for other in (drawn(train, 4, 8), drawn(train, 5, 7), drawn(train, 4, 7, seed=4), drawn(validation, 4, 7)):
        assert torch.corrcoef(torch.stack([first.ravel(), other.ravel()]))[0, 1].abs() < 0.07  # 5 / sqrt(6912)


AUGMENT = Augmentation()


@pytest.fixture(params=["tiny", "wide"])
def either(request: pytest.FixtureRequest) -> Dataset:
    """Scenes that end with their image, and scenes that go on beside it."""
    return open_dataset(request.getfixturevalue(f"{request.param}_dataset"), "train")


def test_scenes_are_seen_anew(either: Dataset) -> None:
    """Truth and measurement of the same changed scene: what the camera sees of it, with the data set's own noise."""
    dataset = with_noise(either, type="none")
    examples, camera = ExampleSet(dataset, augment=AUGMENT, seed=3), SceneCamera(dataset)
    assert len(examples) == len(dataset)
    for number in range(6):
        example, sample = examples[Draw(1, number)], dataset[1]
        rng = np.random.default_rng(np.random.SeedSequence(3, spawn_key=(6, 0, sample_index(dataset.ids[1]), number)))
        clip = AUGMENT.apply(sample.clip(), rng)
        assert (example.radiance.permute(1, 2, 0).numpy() == clip.rgb[0]).all()
        assert (example.depth_m[0].numpy() == clip.depth_m[0]).all()
        assert (example.valid[0].numpy() == clip.valid[0]).all()
        assert [values.dtype for values in example] == [torch.float32] * 3 + [torch.bool]
        noiseless = camera.sensor.noiseless(camera.exposure(clip))
        stored = ExampleSet(either, augment=AUGMENT, seed=3)[Draw(1, number)]
        assert torch.equal(stored.radiance, example.radiance)
        sigma, seen = 0.01 * noiseless.max(), np.minimum(noiseless, 4095 / 4096)
        error = stored.measurement.numpy() - seen
        # 40 dB and 12 bits, clipped at both ends: a few deviations; all of it where there is light, but not too much.
        assert np.abs(error).max() < 6 * sigma
        middle = (noiseless > 5 * sigma) & (noiseless < 1 - 5 * sigma)
        assert error[middle].std() == pytest.approx(sigma, rel=0.1)
        redrawn = ExampleSet(either, augment=AUGMENT, seed=3, noise_db=(60, 60))[Draw(1, number)]
        assert torch.equal(redrawn.radiance, example.radiance)
        assert np.abs(redrawn.measurement.numpy() - seen).max() < 0.6 * sigma + 0.5 / 4096


@pytest.mark.parametrize("noise_db", [None, (20, 50)])
def test_changes_depend_on_seed_and_draw_alone(either: Dataset, tmp_path: Path, noise_db: Any) -> None:
    plain, again, cached = (
        ExampleSet(either, noise_db=noise_db, augment=AUGMENT, seed=3, cache=cache) for cache in (None, None, tmp_path)
    )
    for draw in (Draw(0, 0), Draw(3, 5), Draw(1, 2)):
        assert same(plain[draw], again[draw])
        assert same(plain[draw], cached[draw])
    first = plain[Draw(2, 4)]
    for other in (plain[Draw(2, 5)], ExampleSet(either, noise_db=noise_db, augment=AUGMENT, seed=4)[Draw(2, 4)]):
        assert not torch.equal(other.measurement, first.measurement)
        assert not torch.equal(other.radiance, first.radiance)
    ExampleSet(either, noise_db=noise_db, cache=tmp_path)  # another kind of cache, which lies beside it
    assert len(caches(tmp_path)) == 2


def test_samples_that_do_not_say_what_was_beside_them_cannot_be_seen_anew(
    wide_dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As versions before this one stored them; what was measured of them serves as ever."""
    monkeypatch.setattr(StoredSample, "surroundings", lambda stored: None)
    dataset = open_dataset(wide_dataset, "validation")
    assert ExampleSet(dataset, noise_db=(20, 50))[0].measurement.shape == (3, 48, 48)
    for cache in (None, tmp_path):
        examples = ExampleSet(dataset, augment=AUGMENT, cache=cache)
        with pytest.raises(InputError, match=r"^data\.augment: "):
            examples[0]


@pytest.mark.parametrize("method", ["fork", pytest.param("spawn", marks=pytest.mark.slow)])
def test_workers_change_nothing(train: Dataset, tmp_path: Path, method: str) -> None:
    def batches(examples: ExampleSet, workers: int) -> list[Example]:
        # Read to the end: Python, ending a spawned worker that still sends a batch, can abort it within torch's C++
        order = [Batches(len(examples), 5, seed=1).batch(number) for number in range(7)]
        context = method if workers else None
        return list(DataLoader(examples, batch_sampler=order, num_workers=workers, multiprocessing_context=context))

    chosen: Any = {"noise_db": (20, 50), "augment": AUGMENT, "seed": 2}
    alone = batches(ExampleSet(train, **chosen), 0)
    assert len(alone) == 7
    for cache in (None, tmp_path):
        shared = batches(ExampleSet(train, **chosen, cache=cache), 2)
        assert all(same(one, other) for one, other in zip(alone, shared, strict=True))


def test_a_pickled_set_is_small_and_the_same(train: Dataset, tmp_path: Path) -> None:
    examples = ExampleSet(train, noise_db=(20, 50), cache=tmp_path)
    expected = examples[Draw(3, 1)]
    pickled = pickle.dumps(examples)
    assert len(pickled) < 30_000  # the samples are 2 MB
    assert same(pickle.loads(pickled)[Draw(3, 1)], expected)
    anew, few = (ExampleSet(each, augment=AUGMENT, cache=tmp_path) for each in (train, train[:4]))
    expected = anew[Draw(3, 1)]
    assert len(pickle.dumps(anew)) < len(pickle.dumps(few)) + 5_000  # with the camera's PSFs, but no samples
    assert same(pickle.loads(pickle.dumps(anew))[Draw(3, 1)], expected)


@pytest.mark.parametrize("noise_db", [(0, 20), (50, 20), (20, 121), (float("nan"), 30)])
def test_levels_that_make_no_sense_are_refused(train: Dataset, noise_db: tuple[float, float]) -> None:
    with pytest.raises(InputError, match=r"^noise_db: "):
        ExampleSet(train, noise_db=noise_db)


@pytest.mark.parametrize("override", ["camera.sensor.readout=bayer", "scene.flat=true"])
def test_mosaics_and_scenes_without_depth_are_refused(learning_trial: Any, override: str) -> None:
    counts = {"train": 2, "validation": 0, "test": 0}
    dataset = open_dataset(learning_trial.generate(override, dataset=counts, psf={"as_captured": None}))
    with pytest.raises(InputError, match="out: "):
        check_dataset(dataset)


def test_an_example_of_a_clip_is_its_slivers_means(clip_dataset: Path) -> None:
    """Eight frames are stored, four slivers told apart; flat scenes are no fault of clips."""
    dataset = open_dataset(clip_dataset, "train")
    check_dataset(dataset)
    examples, sample = ExampleSet(dataset), dataset[3]
    example = examples[3]
    assert examples.timing is not None
    assert examples.timing.frames == 4
    np.testing.assert_allclose(examples.timing.frame_edges_s, np.arange(5) * 4e-3, rtol=1e-12)
    assert [tuple(values.shape) for values in example] == [(3, 48, 48), (4, 3, 16, 16), (4, 1, 16, 16), (4, 1, 16, 16)]
    means = sample.rgb.reshape(4, 2, 16, 16, 3).mean(axis=1)
    np.testing.assert_allclose(example.radiance.permute(0, 2, 3, 1).numpy(), means, rtol=1e-6)
    assert (example.depth_m[:, 0].numpy() == sample.depth_m[1::2]).all()
    assert (example.measurement.numpy() == sample.measurement).all()


def test_clips_are_seen_anew_from_all_their_frames(clip_dataset: Path, tmp_path: Path) -> None:
    """Not from the slivers' means: rows see how things move within a sliver. With the cache as without."""
    dataset = open_dataset(clip_dataset, "train")
    still = Augmentation(flip=False, reverse=False, colour=0, exposure=0)
    for cache in (None, tmp_path):
        unchanged = ExampleSet(dataset, noise_db=(120, 120), augment=still, cache=cache)
        for position in (0, 5):
            example, sample = unchanged[position], dataset[position]
            # 120 dB of noise and 12 bits
            assert np.abs(example.measurement.numpy() - sample.noiseless).max() < 2**-12
            assert torch.equal(example.radiance, ExampleSet(dataset)[position].radiance)
    examples = ExampleSet(dataset, augment=Augmentation(), cache=tmp_path)
    assert not same_measurement(examples[Draw(0, 0)], examples[Draw(0, 1)])
    assert same(examples[Draw(1, 2)], ExampleSet(dataset, augment=Augmentation())[Draw(1, 2)])


def test_a_still_among_clips_and_other_times_are_refused(clip_dataset: Path, tmp_path: Path) -> None:
    shutil.copytree(clip_dataset, tmp_path / "out")
    dataset = open_dataset(tmp_path / "out", "train")
    path = dataset.folder(1) / "sample.json"
    content = json.loads(path.read_text())
    content["frame_edges_s"][-1] *= 1.01
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="s00000001: frame_edges_s"):
        ExampleSet(dataset)[1]


def test_an_empty_split_is_refused(train: Dataset) -> None:
    for look in (check_dataset, ExampleSet):
        with pytest.raises(InputError, match="out: "):
            look(train[:0])


@pytest.mark.parametrize("bad", [np.nan, np.inf])
@pytest.mark.parametrize(("file", "channel"), [("measurement.exr", "G"), ("ground_truth.exr", "Z")])
def test_values_that_make_no_sense_are_refused(
    tiny_dataset: Path, tmp_path: Path, bad: float, file: str, channel: str
) -> None:
    dataset = copied(tiny_dataset, tmp_path)
    path = dataset.folder(1) / file
    planes, metadata = read_exr(path)
    planes[channel] = planes[channel].copy()
    planes[channel][3, 4] = bad
    with pytest.MonkeyPatch.context() as patch:  # our writer refuses it: another program would have written this
        patch.setattr(np, "isfinite", lambda values: np.ones(np.shape(values), bool))
        write_exr(path, planes, metadata)
    for look in (check_dataset, lambda dataset: ExampleSet(dataset)[1]):
        with pytest.raises(InputError, match=rf"{path.parent.name}/{file}: .*'{channel}'"):
            look(dataset)
    path = dataset.folder(0) / "ground_truth.exr"
    planes, metadata = read_exr(path)
    write_exr(path, planes | {"Z": -planes["Z"]}, metadata)  # behind the mask
    with pytest.raises(InputError, match="s00000000: "):
        ExampleSet(dataset)[0]


def caches(folder: Path) -> list[Path]:
    return sorted(path for path in folder.iterdir() if path.is_dir())


@pytest.mark.parametrize("augment", [None, AUGMENT])
@pytest.mark.parametrize("noise_db", [None, (20, 50)])
def test_a_cached_example_needs_no_picture(
    tiny_dataset: Path, tmp_path: Path, noise_db: Any, augment: Augmentation | None
) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(tiny_dataset, copy)
    plain = ExampleSet(open_dataset(copy, "validation"), noise_db=noise_db, augment=augment)
    expected = [plain[Draw(position, 2)] for position in range(8)]
    dataset = open_dataset(copy, "validation")
    ExampleSet(dataset, noise_db=noise_db, augment=augment, cache=tmp_path / "cache")
    for picture in (copy / "validation").rglob("*.exr"):
        picture.unlink()
    cached = ExampleSet(dataset, noise_db=noise_db, augment=augment, cache=tmp_path / "cache")
    assert all(same(cached[Draw(position, 2)], expected[position]) for position in range(8))
    assert same(cached[-1], cached[7])
    with pytest.raises(IndexError):
        cached[8]


def test_what_a_caller_changes_stays_the_callers(validation: Dataset, tmp_path: Path) -> None:
    examples = ExampleSet(validation, cache=tmp_path)
    examples[0].measurement.zero_()
    assert examples[0].measurement.max() > 0.1


def test_a_sample_that_was_replaced_is_read_again(learning_trial: Any, tmp_path: Path) -> None:
    """By its digest: the data set's configuration, and so its fingerprint, stay."""
    folder = learning_trial.generate(dataset={"train": 2, "validation": 0, "test": 0}, psf={"as_captured": None})
    before = open_dataset(folder)
    ExampleSet(before, cache=tmp_path / "cache")
    path = before.folder(1) / "ground_truth.exr"
    planes, metadata = read_exr(path)
    halved = {name: planes[name] * np.float32(0.5) for name in "RGB"}
    write_exr(path, planes | halved, metadata)
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
    part = ExampleSet(dataset[1:], cache=tmp_path / "cache")  # samples and kind of measurement count too
    assert len(part) == 1
    assert same(part[0], cached[1])
    redrawn = ExampleSet(dataset, noise_db=(20, 20), cache=tmp_path / "cache")
    assert same(redrawn[1], ExampleSet(dataset, noise_db=(20, 20))[1])
    assert len(caches(tmp_path / "cache")) == 4


@pytest.mark.parametrize("damage", ["truncated", "absent", "header", "length"])
def test_a_half_written_cache_is_redone(validation: Dataset, tmp_path: Path, damage: str) -> None:
    expected = ExampleSet(validation, cache=tmp_path)[7]
    (own,) = caches(tmp_path)
    path = own / CACHE
    if damage == "truncated":
        os.truncate(path, path.stat().st_size - 100)
    elif damage == "header":
        path.write_bytes(b"\0" * path.stat().st_size)
    elif damage == "length":
        np.save(path, np.load(path)[:-1])
    else:
        path.unlink()
    assert same(ExampleSet(validation, cache=tmp_path)[7], expected)
    assert caches(tmp_path) == [own]
    assert [file.name for file in own.iterdir()] == [CACHE]


def test_a_sample_that_cannot_be_read_leaves_no_cache(learning_trial: Any, tmp_path: Path) -> None:
    counts = {"train": 2, "validation": 0, "test": 0}
    dataset = open_dataset(learning_trial.generate(dataset=counts, psf={"as_captured": None}))
    path = dataset.folder(1) / "ground_truth.exr"
    planes, metadata = read_exr(path)
    path.write_bytes(path.read_bytes()[:-50])
    with pytest.raises(InputError, match=r"ground_truth\.exr: "):
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
    assert error.value.path == str(validation.folder(0))
    assert "(Input/output error)" in error.value.reason
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
    with pytest.raises(StorageError, match="file: "):
        ExampleSet(validation, cache=tmp_path / "file")


@pytest.mark.parametrize(("length", "batch"), [(32, 8), (10, 4), (7, 3), (3, 8), (1, 2)])
def test_an_epoch_leaves_no_sample_out(length: int, batch: int) -> None:
    stream = [draw for draws in islice(Batches(length, batch, seed=5), 4 * length) for draw in draws]
    epochs = [stream[start : start + length] for start in range(0, len(stream), length)]
    for number, epoch in enumerate(epochs):
        if len(epoch) == length:  # batches may end within an epoch
            assert sorted(epoch) == [Draw(position, number) for position in range(length)]
    orders = {tuple(draw.position for draw in epoch) for epoch in epochs}
    assert length < 10 or len(orders) == len(epochs)  # a permutation that repeats would be no accident


def test_a_batch_follows_from_seed_and_number() -> None:
    batches = list(islice(Batches(10, 4, seed=5), 30))
    assert all(len(batch) == 4 for batch in batches)
    assert list(islice(Batches(10, 4, seed=5, first=13), 17)) == batches[13:]
    assert list(islice(Batches(10, 4, seed=6), 30)) != batches
    once = Batches(10, 4, seed=5)
    assert next(iter(once)) == next(iter(once)) == once.batch(0) == batches[0]
    assert once.batch(20) == batches[20]
    assert once.batch(2) == batches[2]  # ends one epoch and begins the next


@pytest.mark.parametrize("world_size", [1, 2, 3, 6])
def test_ranks_share_each_batch(world_size: int) -> None:
    whole = list(islice(Batches(10, 6, seed=5, first=2), 8))
    ranks = (Batches(10, 6, seed=5, first=2, rank=rank, world_size=world_size) for rank in range(world_size))
    parts = [list(islice(rank, 8)) for rank in ranks]
    for number, batch in enumerate(whole):
        assert [draw for part in parts for draw in part[number]] == batch
        assert {len(part[number]) for part in parts} == {6 // world_size}


def test_workers_end_with_their_loader_and_hand_over_bad_input_as_it_is(
    tiny_dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    examples = ExampleSet(open_dataset(tiny_dataset, "train"))
    before = set(multiprocessing.active_children())
    loader = Loader(examples, [[0, 1], [2, len(examples)]], 2)
    batches = iter(loader)
    assert torch.equal(next(batches).measurement[1], examples[1].measurement)
    workers = set(multiprocessing.active_children()) - before
    assert len(workers) == 2
    loader.close()
    assert not any(worker.is_alive() for worker in workers)

    bad = ExampleSet(open_dataset(tiny_dataset, "train"))
    monkeypatch.setattr(bad, "_read", refused)
    loader = Loader(bad, [[0]], 1)
    with pytest.raises(InputError) as error:  # whose traceback refers to the loader's iterator
        next(iter(loader))
    loader.close()
    assert (error.value.path, error.value.reason) == ("sample 0", "damaged")
    assert set(multiprocessing.active_children()) <= before


def refused(position: int) -> Any:
    raise InputError(f"sample {position}", "damaged")
