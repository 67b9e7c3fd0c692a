"""HDF5: h5py gives back the arrays that the reader gives, stacked; what cannot be stacked is refused."""

import json
from pathlib import Path
from types import ModuleType

import h5py
import numpy as np
import pytest

from simulator.dataset.exports import export
from simulator.dataset.reader import open_dataset
from simulator.errors import InputError
from simulator.types import Surroundings


def test_stills(dataset: Path, tmp_path: Path) -> None:
    export(dataset, "hdf5", tmp_path / "out")
    expected = open_dataset(dataset, "train")
    with h5py.File(tmp_path / "out/train-000000.h5") as file:
        images = {"measurement", "noiseless", "rgb", "depth_m", "valid"}
        assert set(file) == images | {"id", "label", "channels", "sample_json"}
        for name in images:
            wanted = np.stack([sample[name] for sample in expected])
            assert file[name].dtype == wanted.dtype
            np.testing.assert_array_equal(file[name][:], wanted)
        assert file["measurement"].chunks == (1, 3, 24, 36)
        assert file["rgb"].chunks == (1, 1, 10, 12, 3)
        assert (file["rgb"].compression, file["rgb"].shuffle) == ("gzip", True)
        assert list(file["id"].asstr()) == list(expected.ids)
        assert list(file["label"].asstr()) == [sample.label for sample in expected]
        for position, text in enumerate(file["sample_json"].asstr()):
            assert json.loads(text) == expected.stored(position).description
        assert list(file["channels"].asstr()) == ["R", "G", "B"]


def test_clips_with_all_that_a_sample_can_have(samples: ModuleType, tmp_path: Path) -> None:
    around = Surroundings(np.ones((3, 5, 6, 3), np.float32), np.full((3, 5, 6), 0.1, np.float32), 4)
    names = (None, "Öffnen", "Etwas\nlangsam öffnen")

    def make(index: int):
        return samples.make_clip_sample(index, label=names[index], surroundings=around)

    root = samples.make_dataset(tmp_path / "set", make)
    export(root, "hdf5", tmp_path / "out")
    expected = list(open_dataset(root, "train"))
    with h5py.File(tmp_path / "out/train-000000.h5") as file:
        assert list(file["label"].asstr()) == [name or "" for name in names]
        for name in ("frame_edges_s", "global_measurements", "valid"):
            np.testing.assert_array_equal(file[name][:], np.stack([sample[name] for sample in expected]))
        ids = np.stack([sample.extras["shape_id"] for sample in expected])
        np.testing.assert_array_equal(file["extras/shape_id"][:], ids)
        assert file["extras/shape_id"].dtype == np.int32
        np.testing.assert_array_equal(file["surroundings/depth_m"][1], around.depth_m)


def test_a_file_by_size(dataset: Path, tmp_path: Path) -> None:
    result = export(dataset, "hdf5", tmp_path / "out", splits=["train"], shard_bytes=50_000)
    assert result.shards == {"train": 2}
    found = []
    for number in range(2):
        with h5py.File(tmp_path / f"out/train-{number:06d}.h5") as file:
            found.append(file["measurement"][:])
    wanted = np.stack([sample.measurement for sample in open_dataset(dataset, "train")])
    np.testing.assert_array_equal(np.concatenate(found), wanted)


def test_clips_of_different_lengths_are_refused(samples: ModuleType, tmp_path: Path) -> None:
    """The first training sample has three frames, the second one four; wherever the files are cut."""
    root = samples.make_dataset(tmp_path / "set", lambda index: samples.make_clip_sample(index, frames=3 + index % 2))
    for number, shard_bytes in enumerate((10, 10**9)):
        with pytest.raises(InputError, match=r"--to: .*train/s00000000 .*train/s00000001; webdataset and npz"):
            export(root, "hdf5", tmp_path / f"out{number}", shard_bytes=shard_bytes)
    assert export(root, "npz", tmp_path / "npz").samples == 4
