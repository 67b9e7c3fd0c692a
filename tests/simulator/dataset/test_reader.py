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

from simulator.camera.shutter import RowShutter, shutter_record
from simulator.dataset.dataset_info import DatasetInfo, read_info, write_info
from simulator.dataset.reader import open_dataset
from simulator.errors import InputError


def test_it_is_like_a_list(dataset: Path, samples: ModuleType) -> None:
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


def test_what_the_data_set_says_of_itself(dataset: Path) -> None:
    train = open_dataset(str(dataset))
    assert train.config == {"seed": 7, "psf": {"far_cm": "inf"}}
    assert train.fingerprint == json.loads((dataset / "dataset.json").read_text())["fingerprint"]
    assert train.metadata["exposure"] == {"full_scale": 0.5}
    assert train.metadata["sensor_shape"] == (24, 36)
    assert "3 samples" in repr(train)


def test_it_is_lazy_and_small_to_send(dataset: Path) -> None:
    train = open_dataset(dataset)
    assert len(pickle.dumps(train)) < 2000
    shutil.rmtree(dataset / "train/0000/s00000001")
    assert train[0].label == "class 0"
    with pytest.raises(InputError, match="s00000001"):
        train[1]


def test_other_processes_read_it(dataset: Path) -> None:
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        labels = pool.map(open_dataset(dataset).__getitem__, [2, 0])
    assert [sample.label for sample in labels] == ["class 2", "class 0"]


def test_torch_data_loader(dataset: Path) -> None:
    data = pytest.importorskip("torch.utils.data", reason="extra learn")
    torch = pytest.importorskip("torch")
    loader = data.DataLoader(open_dataset(dataset), batch_size=None, num_workers=1, multiprocessing_context="spawn")
    assert [sample.label for sample in loader] == ["class 0", "class 1", "class 2"]
    loader = data.DataLoader(
        open_dataset(dataset), batch_size=2, collate_fn=lambda group: np.stack([sample.measurement for sample in group])
    )
    assert [torch.from_numpy(batch).shape for batch in loader] == [(2, 3, 24, 36), (1, 3, 24, 36)]


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
        "print(len(list(open_dataset(sys.argv[1]))), verify(sys.argv[1]).ok)\n"
        "names = 'torch mitsuba colour matplotlib scipy pebble simulator.plugins psf_library scenes'.split()\n"
        "print([name for name in names if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code, str(dataset)], capture_output=True, text=True, cwd=dataset)
    assert done.stdout.splitlines() == ["3 True", "[]"], done.stderr


def test_clear_refusals(dataset: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="gone"):
        open_dataset(tmp_path / "gone")
    with pytest.raises(InputError, match=r"dataset\.json"):
        open_dataset(tmp_path)
    for split in ("training", "pilot", ""):
        with pytest.raises(InputError, match=r"split .*train, validation, test"):
            open_dataset(dataset, split)


def test_info_round_trip(tmp_path: Path, samples: ModuleType) -> None:
    info = samples.make_info()
    write_info(tmp_path, info)
    back = read_info(tmp_path)
    assert back.config["psf"] == {"far_cm": "inf"}
    assert {**vars(back), "config": None} == {**vars(info), "config": None}
    content = json.loads((tmp_path / "dataset.json").read_text())
    assert (content["format"], content["format_version"]) == ("flatlight-dataset", 1)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("format", "other", "format must be"),
        ("format_version", 2, "format version 2, this package reads 1"),
        ("counts", None, "counts"),
        ("counts", {"train": -1}, "counts"),
        ("counts", {"pilot": 1}, "counts"),
        ("counts", {"train": True}, "counts"),
        ("fingerprint", "abc", "64 hexadecimal digits"),
        ("scene_shape", [1, 2, 3], "two sizes"),
        ("sensor_shape", [0, 2], "two sizes"),
        ("channels", [], "tuple of names"),
        ("channels", "RGB", "tuple of names"),
        ("name", 3, "name"),
        ("exposure", "missing", "lacks exposure"),
    ],
)
def test_damaged_info_is_named(dataset: Path, key: str, value: object, words: str) -> None:
    path = dataset / "dataset.json"
    content = json.loads(path.read_text())
    content[key] = value
    if value == "missing":
        del content[key]
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=rf"dataset\.json.*{words}"):
        read_info(dataset)


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe", b"[" * 100_000])
def test_unreadable_info(dataset: Path, content: bytes) -> None:
    (dataset / "dataset.json").write_bytes(content)
    with pytest.raises(InputError, match=r"\.json"):
        read_info(dataset)


def test_info_checks_what_it_is_given(samples: ModuleType) -> None:
    assert isinstance(samples.make_info(), DatasetInfo)
    with pytest.raises(InputError, match="scene_shape"):
        samples.make_info(scene_shape=[10, 12])
