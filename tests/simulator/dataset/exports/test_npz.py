"""NPZ: NumPy reads every sample without pickles, under the names of the sample's mapping."""

import json
import zipfile
from pathlib import Path

import numpy as np

from simulator.dataset.exports import export
from simulator.dataset.reader import open_dataset


def test_numpy_reads_every_sample(clips: Path, tmp_path: Path) -> None:
    export(clips, "npz", tmp_path / "out")
    expected = open_dataset(clips, "train")
    assert len(list((tmp_path / "out").rglob("*.npz"))) == 4
    for position, sample in enumerate(expected):
        path = tmp_path / f"out/train/0000/{expected.ids[position]}.npz"
        with np.load(path, allow_pickle=False) as found:
            named = {name for name in sample if name != "extras"} | {f"extras/{name}" for name in sample.extras}
            assert set(found) == named | {"sample_json"}
            assert str(found["label"]) == sample.label
            assert json.loads(str(found["sample_json"])) == expected.stored(position).description
            np.testing.assert_array_equal(found["extras/shape_id"], sample.extras["shape_id"])
            for name in named - {"label", "extras/shape_id"}:
                assert found[name].dtype == sample[name].dtype
                np.testing.assert_array_equal(found[name], sample[name])


def test_a_still_without_a_label(samples, tmp_path: Path) -> None:
    root = samples.make_dataset(tmp_path / "set", lambda index: samples.make_sample(index, label=None))
    export(root, "npz", tmp_path / "out")
    path = tmp_path / "out/validation/0000/s00000000.npz"
    with np.load(path, allow_pickle=False) as found:
        assert set(found) == {"measurement", "noiseless", "rgb", "depth_m", "valid", "sample_json"}
    with zipfile.ZipFile(path) as archive:
        for member in archive.infolist():
            assert (member.date_time, member.compress_type) == ((1980, 1, 1, 0, 0, 0), zipfile.ZIP_DEFLATED)
            assert (member.create_system, member.external_attr) == (3, 0o644 << 16)
