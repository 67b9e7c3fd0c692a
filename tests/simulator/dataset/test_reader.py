"""Reading data sets: like a list, lazily, in any process, without running code that the data set names."""

import json
import multiprocessing
import pickle
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from simulator.camera.shutter import (
    DualRollingShutter,
    GlobalShutter,
    RollingShutter,
    RowShutter,
    Shutter,
    shutter_record,
)
from simulator.camera.slivers import split_measurement
from simulator.dataset.reader import Dataset, all_metadata, open_dataset, spread_positions
from simulator.dataset.verification import verify
from simulator.errors import InputError


def test_it_is_like_a_list_and_says_what_it_is(dataset: Path, samples: ModuleType) -> None:
    train = open_dataset(dataset)
    assert len(train) == 3
    assert train.ids == ("s00000000", "s00000001", "s00000002")  # whatever the order they were finished in
    for position in range(3):
        expected = samples.make_sample(position)
        for sample in (train[position], train[position - 3]):
            np.testing.assert_array_equal(sample.measurement, expected.measurement)
            np.testing.assert_array_equal(sample.depth_m, expected.depth_m)
    assert [sample.label for sample in train] == ["class 0", "class 1", "class 2"]
    assert [sample.label for sample in train[1:]] == ["class 1", "class 2"]
    for position in (3, -4):
        with pytest.raises(IndexError, match="has 3"):
            train[position]
    assert len(open_dataset(dataset, "validation")) == 1
    assert len(open_dataset(dataset, "test")) == 0
    assert list(open_dataset(dataset, "test")) == []
    assert train.config == {"seed": 7, "psf": {"far_cm": "inf"}}
    assert train.fingerprint == json.loads((dataset / "dataset.json").read_text())["fingerprint"]
    assert (train.metadata["exposure"], train.metadata["sensor_shape"]) == ({"full_scale": 0.5}, (24, 36))
    assert "3 samples" in repr(train)


def test_other_processes_read_it(dataset: Path) -> None:
    assert len(pickle.dumps(open_dataset(dataset))) < 2000
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        labels = pool.map(open_dataset(dataset).__getitem__, [2, 0])
    assert [sample.label for sample in labels] == ["class 2", "class 0"]


def test_a_plain_data_loader_makes_batches_of_it(dataset: Path, clips: Path) -> None:
    from torch.utils.data import DataLoader

    train = open_dataset(dataset)
    first, second = DataLoader(train, batch_size=2)
    for name in ("measurement", "noiseless", "rgb", "depth_m", "valid"):
        np.testing.assert_array_equal(first[name].numpy(), np.stack([getattr(train[n], name) for n in (0, 1)]))
        assert len(second[name]) == 1
    assert (first["label"], second["label"]) == (["class 0", "class 1"], ["class 2"])
    assert set(first) == {"measurement", "noiseless", "rgb", "depth_m", "valid", "label"}
    (batch,) = DataLoader(open_dataset(clips), batch_size=3)
    assert batch["global_measurements"].shape == (3, 3, 3, 24, 36)
    assert batch["extras"]["shape_id"].shape == (3, 3, 10, 12)
    assert batch["frame_edges_s"].shape == (3, 4)
    (alone,) = DataLoader(train[:1], batch_size=None)
    assert alone["measurement"].shape == (3, 24, 36)


def test_a_sample_is_a_mapping_of_what_it_has(samples: ModuleType) -> None:
    sample = samples.make_sample(label=None)
    assert list(sample) == ["measurement", "noiseless", "rgb", "depth_m", "valid"]
    assert sample["rgb"] is sample.rgb
    for name in ("label", "metadata", "extras", "frame_edges_s", "nothing"):
        with pytest.raises(KeyError, match=name):
            sample[name]
    assert sample == sample
    assert sample != samples.make_sample(label=None)


def test_nothing_heavy_or_foreign_is_imported(samples: ModuleType, tmp_path: Path) -> None:
    camera = {"shutter": {"type": "windows", "function": "./evil.py:windows"}}
    dataset = samples.make_dataset(
        tmp_path / "set",
        config={"scene": {"family": "./evil.py:scene"}, "camera": camera},
        time={"shutter": shutter_record(RowShutter(np.tile([0.0, 0.01], (24, 1))))},
    )
    (dataset / "evil.py").write_text("raise SystemExit('code of a data set was run')")
    code = (
        "import sys; from simulator.dataset.reader import open_dataset; from simulator.dataset.verification import verify\n"
        "print(len(list(open_dataset(sys.argv[1]))), [line.split(':')[0] for line in verify(sys.argv[1]).problems])\n"
        "names = 'torch mitsuba colour matplotlib scipy simulator.plugins psf_library scenes'.split()\n"
        "print([name for name in names if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code, str(dataset)], capture_output=True, text=True, cwd=dataset)
    assert done.stdout.splitlines() == ["3 ['evil.py']", "[]"], done.stderr


def test_clear_refusals(dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="gone: "):
        open_dataset(tmp_path / "gone")
    with pytest.raises(InputError, match=r"dataset\.json"):
        open_dataset(tmp_path)
    for split in ("training", "pilot", ""):
        with pytest.raises(InputError, match=r"^split: "):
            open_dataset(dataset, split)


# What a learner gets of clips: their times, the shutter, and the weights that take a measurement apart into slivers.


ROWS = 24  # of samples.SENSOR
INTERLACED = np.array([[row % 2 * 1e-3, row % 2 * 1e-3 + 2e-3] for row in range(48)])
SHUTTERS: dict[str, Shutter] = {
    "global": GlobalShutter(0.01),
    "rolling": RollingShutter(1.3e-3, 1e-4, "down", binning=2),
    "rolling up": RollingShutter(1e-4, 3e-4, "up"),
    "dual": DualRollingShutter(1.7e-3, 2e-4, "outside_in", binning=3),
    "dual centre": DualRollingShutter(2e-5, 1e-5, "centre_out"),
    "windows": RowShutter(INTERLACED, binning=2),
}


def opened(root: Path, samples: ModuleType, shutter: Shutter, edges_s: np.ndarray) -> tuple:
    def make(index: int):
        return samples.make_clip_sample(index, frames=len(edges_s) - 1, frame_edges_s=edges_s)

    time = {"shutter": shutter_record(shutter), "slivers": len(edges_s) - 1}
    dataset = open_dataset(samples.make_dataset(root, make, time=time))
    return dataset, dataset[1]


@pytest.mark.parametrize("kind", SHUTTERS)
@pytest.mark.parametrize(("slivers", "length", "longer"), [(10, 6, 1.0), (3, 7, 1.03), (1, 5, 1.2), (4, 1, 1.0)])
def test_weights_from_the_edges_of_slivers_are_means_over_the_finer_frames(
    samples: ModuleType, kind: str, slivers: int, length: int, longer: float
) -> None:
    shutter = SHUTTERS[kind]
    frame_edges_s = np.linspace(0, shutter.duration_s(ROWS) * longer, slivers * length + 1)
    dataset = Dataset(Path("nowhere"), "train", (), samples.make_info(time={"shutter": shutter_record(shutter)}))
    sample = samples.make_clip_sample(0, slivers, frame_edges_s=frame_edges_s[::length])
    found = dataset.sliver_weights(sample)
    of_frames = shutter.weights(ROWS, frame_edges_s)  # for the physical sensor: image row 0 is its last
    means = of_frames.reshape(slivers, length, -1).mean(axis=1)
    np.testing.assert_allclose(found, means[:, ::-1], rtol=0, atol=1e-12)  # float64
    seconds = np.diff(sample.frame_edges_s) @ found  # sum_n dt_n S_n is what each row was exposed for
    np.testing.assert_allclose(seconds, shutter.exposures_s(ROWS)[::-1], rtol=1e-12)


def test_slivers_of_a_measurement(samples: ModuleType, tmp_path: Path) -> None:
    """A rolling shutter from the top down that opens one row after the other: the stored image's last rows come first."""
    shutter = RollingShutter(exposure_s=1e-3, line_time_s=1e-3)
    dataset, sample = opened(tmp_path / "set", samples, shutter, np.linspace(0, 24e-3, 4))  # 8 rows a sliver
    slivers = split_measurement(sample.measurement, dataset.sliver_weights(sample))
    np.testing.assert_allclose(slivers[0, :, 16:], sample.measurement[:, 16:] / 8, rtol=1e-6)  # float32; 1 of 8 ms
    assert np.abs(slivers[0, :, :16]).max() < 1e-12  # 24 ms in thirds are not exact
    np.testing.assert_allclose(slivers[2, :, :8], sample.measurement[:, :8] / 8, rtol=1e-6)


def test_stills_are_one_sliver(dataset: Path) -> None:
    train = open_dataset(dataset)
    assert train.shutter is None
    weights = train.sliver_weights(train[0])
    np.testing.assert_array_equal(weights, np.ones((1, ROWS)))
    np.testing.assert_array_equal(split_measurement(train[0].measurement, weights)[0], train[0].measurement)


def test_the_shutter_and_the_times_are_said(samples: ModuleType, tmp_path: Path) -> None:
    for kind, shutter in SHUTTERS.items():
        root = tmp_path / kind
        dataset, sample = opened(root, samples, shutter, np.linspace(0, shutter.duration_s(ROWS), 4))
        assert verify(root).ok
        assert type(dataset.shutter) is type(shutter)
        assert dataset.shutter.windows_s(ROWS).tobytes() == shutter.windows_s(ROWS).tobytes()
        np.testing.assert_array_equal(dataset.sliver_weights(dataset.stored(1)), dataset.sliver_weights(sample))
        assert dataset.metadata["time"] == {"shutter": shutter_record(shutter), "slivers": 3}
        assert sample.frame_edges_s.shape == (4,)


def test_clips_are_read_in_part(clips: Path) -> None:
    train = open_dataset(clips)
    for path in clips.glob("train/*/*/frames/*.exr"):
        path.unlink()
    shutil.rmtree(clips / "train/0000/s00000001")
    assert [train.stored(position).label for position in (0, 2)] == ["class 0", "class 2"]
    assert train.stored(-1).measurement()[0].shape == (3, 24, 36)
    with pytest.raises(InputError, match=r"ground_truth\.0000\.exr: "):
        train[0]
    with pytest.raises(InputError, match="s00000001: "):
        train.stored(1)


def test_refusals_of_clips(clips: Path, samples: ModuleType, tmp_path: Path) -> None:
    train = open_dataset(clips)
    with pytest.raises(InputError, match=r"dataset\.json: "):
        train.sliver_weights(train[0])
    short, sample = opened(tmp_path / "short", samples, GlobalShutter(0.02), np.linspace(0, 0.01, 4))
    with pytest.raises(InputError, match=r"0 to 0\.01 s"):
        short.sliver_weights(sample)
    content = json.loads((clips / "dataset.json").read_text())
    for time in ({"shutter": {"type": "curtain"}}, []):
        (clips / "dataset.json").write_text(json.dumps(content | {"time": time}))
        assert any("dataset.json" in line and "time" in line for line in verify(clips).problems)
        with pytest.raises(InputError, match=r"dataset\.json: time"):
            _ = open_dataset(clips).shutter


@pytest.mark.parametrize(
    ("length", "count", "expected"),
    [(9, 3, [1, 4, 7]), (200, 8, [12, 37, 62, 87, 112, 137, 162, 187]), (2, 5, [0, 1]), (5, 1, [2])],
)
def test_spread_positions_are_the_middles_of_equal_parts(length: int, count: int, expected: list[int]) -> None:
    assert spread_positions(length, count) == expected


def test_metadata_of_all_samples_or_an_even_choice(samples: ModuleType, tmp_path: Path) -> None:
    root = samples.make_dataset(tmp_path / "set", lambda index: samples.make_sample(index, metadata={"n": index}))
    assert [one["n"] for one in all_metadata(root)] == [0, 1, 2, 0]
    assert [one["n"] for one in all_metadata(root, 2)] == [1, 0]
    (root / "train/0000/s00000001/sample.json").unlink()
    assert [one["n"] for one in all_metadata(root)] == [0, 2, 0]
