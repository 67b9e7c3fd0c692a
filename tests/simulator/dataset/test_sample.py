"""Samples: exact round trips, the same bytes for the same sample, and files that cannot be mixed up."""

import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from simulator.assembly import Assembly
from simulator.config import load_config
from simulator.dataset import open_dataset, verify
from simulator.dataset.sample import read_sample, sample_folder, sample_id, sample_index, write_sample
from simulator.errors import InputError
from simulator.io.exr import read_exr
from simulator.io.files import sha256_bytes, sha256_file
from simulator.seeds import generator

ARRAYS = ("measurement", "noiseless", "rgb", "depth_m", "valid")


def test_round_trip(samples: ModuleType, tmp_path: Path) -> None:
    sample = samples.make_sample(5)
    record = write_sample(tmp_path, "validation", 12_345, sample)
    folder = tmp_path / "validation" / "0012" / "s00012345"
    assert (record.id, record.split, record.seed, record.label) == ("s00012345", "validation", 7, "class 2")
    assert sorted(path.name for path in folder.iterdir()) == ["ground_truth.exr", "measurement.exr", "sample.json"]
    back = read_sample(folder)
    for name in ARRAYS:
        values = getattr(back, name)
        assert values.dtype == getattr(sample, name).dtype
        np.testing.assert_array_equal(values, getattr(sample, name))
    assert (back.seed, back.label, back.channels, back.metadata) == (7, "class 2", ("R", "G", "B"), sample.metadata)


def test_what_lies_in_which_file(samples: ModuleType, tmp_path: Path) -> None:
    sample = samples.make_sample(1)
    write_sample(tmp_path, "train", 0, sample)
    folder = sample_folder(tmp_path, "train", 0)
    measured, metadata = read_exr(folder / "measurement.exr")
    truth, truth_metadata = read_exr(folder / "ground_truth.exr")
    assert sorted(measured) == ["B", "G", "R", "noiseless.B", "noiseless.G", "noiseless.R"]
    assert sorted(truth) == ["B", "G", "R", "Z", "valid"]
    np.testing.assert_array_equal(measured["G"], sample.measurement[1])
    np.testing.assert_array_equal(measured["noiseless.B"], sample.noiseless[2])
    np.testing.assert_array_equal(truth["B"], sample.rgb[0, ..., 2])
    np.testing.assert_array_equal(truth["Z"], sample.depth_m[0])
    assert set(np.unique(truth["valid"])) == {0.0, 1.0}
    description = json.loads((folder / "sample.json").read_text())
    hashes = description.pop("files")
    assert description == metadata == truth_metadata
    assert hashes == {f"{name}.exr": sha256_file(folder / f"{name}.exr") for name in ("measurement", "ground_truth")}


def test_other_channels_and_no_label(samples: ModuleType, tmp_path: Path) -> None:
    planes = np.random.default_rng(0).random((5, 8, 9), dtype=np.float32)
    names = tuple(f"{nm}nm" for nm in (450, 500, 550, 600, 650))
    sample = samples.make_sample(0, measurement=planes, noiseless=planes[::-1], channels=names, label=None)
    write_sample(tmp_path, "train", 0, sample)
    back = read_sample(sample_folder(tmp_path, "train", 0))
    assert back.channels == names
    assert back.label is None
    np.testing.assert_array_equal(back.measurement, planes)


def test_same_sample_same_bytes_and_digest(samples: ModuleType, tmp_path: Path) -> None:
    records = [write_sample(tmp_path / name, "train", 3, samples.make_sample(3)) for name in "ab"]
    assert records[0] == records[1]
    contents = [
        {path.name: path.read_bytes() for path in sample_folder(tmp_path / name, "train", 3).iterdir()} for name in "ab"
    ]
    assert contents[0] == contents[1]
    lines = "".join(f"{name} {sha256_bytes(contents[0][name])}\n" for name in sorted(contents[0]))
    assert records[0].digest == sha256_bytes(lines.encode())
    again = write_sample(tmp_path / "a", "train", 3, samples.make_sample(3))  # a folder that no manifest knew of
    assert again == records[0]
    others = {write_sample(tmp_path / "c", "train", 3, samples.make_sample(4)).digest}
    others.add(write_sample(tmp_path / "c", "test", 3, samples.make_sample(3)).digest)
    others.add(write_sample(tmp_path / "c", "train", 3, samples.make_sample(3, metadata={})).digest)
    assert len(others - {records[0].digest}) == 3


def test_metadata_become_plain(samples: ModuleType, tmp_path: Path) -> None:
    metadata = {"far_m": float("inf"), "shape": (1, 2), "path": Path("a/b"), "count": np.int64(3), "f": np.float32(0.5)}
    write_sample(tmp_path, "train", 0, samples.make_sample(0, metadata=metadata))
    back = read_sample(sample_folder(tmp_path, "train", 0)).metadata
    assert back == {"far_m": "inf", "shape": [1, 2], "path": "a/b", "count": 3, "f": 0.5}


@pytest.mark.parametrize("missing", ["measurement.exr", "ground_truth.exr", "sample.json"])
def test_missing_files_are_named(samples: ModuleType, tmp_path: Path, missing: str) -> None:
    write_sample(tmp_path, "train", 0, samples.make_sample(0))
    folder = sample_folder(tmp_path, "train", 0)
    (folder / missing).unlink()
    with pytest.raises(InputError, match=missing):
        read_sample(folder)


@pytest.mark.parametrize("name", ["measurement.exr", "ground_truth.exr"])
def test_files_of_another_sample_are_refused(samples: ModuleType, tmp_path: Path, name: str) -> None:
    for index in (0, 1):
        write_sample(tmp_path, "train", index, samples.make_sample(index))
    first, second = (sample_folder(tmp_path, "train", index) for index in (0, 1))
    (first / name).write_bytes((second / name).read_bytes())
    with pytest.raises(InputError, match=name):
        read_sample(first)


@pytest.mark.parametrize("content", [b"", b"{", b"[]", b"{}", b'{"files": 3}', b"null", b"\xff"])
def test_unusable_descriptions(samples: ModuleType, tmp_path: Path, content: bytes) -> None:
    write_sample(tmp_path, "train", 0, samples.make_sample(0))
    folder = sample_folder(tmp_path, "train", 0)
    (folder / "sample.json").write_bytes(content)
    with pytest.raises(InputError, match=r"sample\.json"):
        read_sample(folder)


@pytest.mark.parametrize("change", [{"channels": [1, 2, 3]}, {"channels": None}, {"metadata": []}, {"files": {}}])
def test_descriptions_with_wrong_fields(samples: ModuleType, tmp_path: Path, change: dict) -> None:
    write_sample(tmp_path, "train", 0, samples.make_sample(0))
    path = sample_folder(tmp_path, "train", 0) / "sample.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(InputError, match=r"sample\.json"):
        read_sample(path.parent)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"measurement": np.zeros((24, 36), np.float32)}, "measurement"),
        ({"measurement": np.zeros((3, 24, 36))}, "got float64"),
        ({"noiseless": np.zeros((3, 24, 35), np.float32)}, "like measurement"),
        ({"rgb": np.zeros((10, 12, 3), np.float32)}, r"\(T, h, w, 3\)"),
        ({"depth_m": np.zeros((1, 10, 11), np.float32)}, "like rgb"),
        ({"valid": np.zeros((1, 10, 12), np.float32)}, "bool"),
        ({"channels": ("R", "G")}, "3 different names"),
        ({"channels": ("R", "R", "G")}, "3 different names"),
        ({"channels": ("noiseless.R", "G", "B")}, "none starting"),
        ({"label": 3}, "text or None"),
        ({"frame_edges_s": np.arange(3.0)}, "frame_edges_s"),
        ({"frame_edges_s": np.arange(2)}, "got int64"),
        ({"frame_edges_s": np.array([1.0, 1.0])}, "finite and increasing"),
        ({"frame_edges_s": np.array([0.0, np.inf])}, "finite and increasing"),
        ({"global_measurements": np.zeros((2, 3, 24, 36), np.float32)}, r"\(1, 3, 24, 36\) like measurement"),
    ],
)
def test_contradictions_are_refused(samples: ModuleType, changes: dict, words: str) -> None:
    with pytest.raises(InputError, match=words):
        samples.make_sample(0, **changes)


def test_values_that_cannot_be_stored_leave_nothing(samples: ModuleType, tmp_path: Path) -> None:
    depth = np.full((1, *samples.SCENE), np.inf, np.float32)
    with pytest.raises(InputError, match="'Z'"):
        write_sample(tmp_path, "train", 0, samples.make_sample(0, depth_m=depth))
    with pytest.raises(InputError, match=r"s00000000\.metadata\.a"):
        write_sample(tmp_path, "train", 0, samples.make_sample(0, metadata={"a": float("nan")}))
    assert [path for path in tmp_path.rglob("*") if path.name.startswith((".tmp", "s0"))] == []


def test_ids_sort_like_numbers() -> None:
    numbers = [0, 9, 10, 9_999, 10_000, 10_001, 123_456, 99_999_999]
    ids = [sample_id(number) for number in numbers]
    assert sorted(ids) == ids
    assert [sample_index(identifier) for identifier in ids] == numbers
    for bad in (-1, 100_000_000):
        with pytest.raises(InputError, match="sample index"):
            sample_id(bad)
    for bad in ("", "00000012", "s12", "s0000001x", "s0000001²", "s-0000012"):
        with pytest.raises(InputError, match="sample id"):
            sample_index(bad)
    with pytest.raises(InputError, match="split"):
        sample_folder(Path(), "pilot", 0)


# What is known of a scene beside colour and depth is stored with the sample and comes back as it was.


pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")


def all_extras(scene: tuple[int, int]) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(4)
    frame = (1, *scene)
    return {
        "shape_id": rng.integers(-1, 40, frame, np.int32),
        "normal": rng.normal(size=(*frame, 3)).astype(np.float32),
        "albedo": rng.random((*frame, 3), np.float32),
        "motion": rng.normal(size=(*frame, 3)).astype(np.float32),
        "motion_valid": rng.random(frame) > 0.5,
        "hidden1_rgb": rng.random((*frame, 3), np.float32),
        "hidden1_depth_m": rng.random(frame, np.float32),
        "hidden1_valid": rng.random(frame) > 0.5,
        "bands": rng.random((*frame, 5), np.float32),
    }


def test_extras_come_back(samples: ModuleType, tmp_path: Path) -> None:
    extras = all_extras(samples.SCENE)
    write_sample(tmp_path, "train", 0, samples.make_sample(0, extras=extras))
    folder = sample_folder(tmp_path, "train", 0)
    back = read_sample(folder).extras
    assert set(back) == set(extras)
    for name, values in extras.items():
        assert (name, back[name].dtype, back[name].shape) == (name, values.dtype, values.shape)
        np.testing.assert_array_equal(back[name], values)
    truth, _ = read_exr(folder / "ground_truth.exr")
    np.testing.assert_array_equal(truth["N.Y"], extras["normal"][0, ..., 1])
    np.testing.assert_array_equal(truth["hidden1.Z"], extras["hidden1_depth_m"][0])
    np.testing.assert_array_equal(truth["band004"], extras["bands"][0, ..., 4])
    listed = json.loads((folder / "sample.json").read_text())["extras"]
    assert listed["shape_id"] == {"channels": ["id"], "components": None, "dtype": "int32"}


def test_samples_without_extras_say_nothing_of_them(samples: ModuleType, tmp_path: Path) -> None:
    """They keep the bytes that they had before there were any: no new key, no new channel."""
    write_sample(tmp_path, "train", 0, samples.make_sample(0))
    folder = sample_folder(tmp_path, "train", 0)
    assert "extras" not in json.loads((folder / "sample.json").read_text())
    assert sorted(read_exr(folder / "ground_truth.exr")[0]) == ["B", "G", "R", "Z", "valid"]
    assert read_sample(folder).extras == {}


def test_wrong_extras_are_refused(samples: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"extras\['a'\]"):
        samples.make_sample(0, extras={"a": np.zeros((1, 3, 3), np.float32)})
    with pytest.raises(InputError, match=r"extras\['a'\].*float64"):
        write_sample(tmp_path, "train", 0, samples.make_sample(0, extras={"a": np.zeros((1, *samples.SCENE))}))
    assert not (tmp_path / "train").exists()
    write_sample(tmp_path, "train", 0, samples.make_sample(0, extras={"a": np.zeros((1, *samples.SCENE), bool)}))
    path = sample_folder(tmp_path, "train", 0) / "sample.json"
    content = json.loads(path.read_text())
    content["extras"]["a"]["dtype"] = "object"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match="is not a sample description"):
        read_sample(path.parent)


def test_a_data_set_holds_what_its_renderer_was_asked_for(trial) -> None:
    scene = {"family": "flying_things", "size": [16, 20], "samples_per_pixel": 1, "objects": 4}
    render = {"backend": "scalar", "outputs": ["shape_id", "normal", "albedo", "hidden"], "hidden_layers": 2}
    root = trial.generate(scene=scene, render=render, dataset={"train": 2, "validation": 0, "test": 0})
    expected = Assembly(load_config(trial.path), "scalar_rgb").source.clip(1, generator(11, "train", 1, "scene")).extras
    layers = {f"hidden{layer}_{what}" for layer in (1, 2) for what in ("rgb", "depth_m", "valid")}
    assert set(expected) == {"shape_id", "normal", "albedo"} | layers
    found = open_dataset(root, "train")[1].extras
    assert set(found) == set(expected)
    for name, values in expected.items():
        assert found[name].dtype == values.dtype
        np.testing.assert_array_equal(found[name], values)
    assert np.ptp(found["shape_id"]) > 1
    assert verify(root).ok
