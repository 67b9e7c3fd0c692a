"""Samples: exact round trips, the same bytes for the same sample, and files that cannot be mixed up."""

import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from simulator.assembly import Assembly
from simulator.config import load_config
from simulator.dataset import open_dataset, verify
from simulator.dataset.sample import StoredSample, sample_folder, sample_id, sample_index, write_sample
from simulator.errors import InputError
from simulator.io.exr import read_exr
from simulator.io.files import sha256_bytes, sha256_file
from simulator.seeds import generator


def test_a_still_comes_back_from_its_folder(samples: ModuleType, tmp_path: Path) -> None:
    """All arrays of any sample, bit by bit: test_sample_clips.py."""
    sample = samples.make_sample(5)
    record = write_sample(tmp_path, "validation", 12_345, sample)
    folder = tmp_path / "validation" / "0012" / "s00012345"
    assert (record.id, record.split, record.seed, record.label) == ("s00012345", "validation", 7, "class 2")
    assert sorted(path.name for path in folder.iterdir()) == ["ground_truth.exr", "measurement.exr", "sample.json"]
    back = StoredSample(folder).sample()
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
    back = StoredSample(sample_folder(tmp_path, "train", 0)).sample().metadata
    assert back == {"far_m": "inf", "shape": [1, 2], "path": "a/b", "count": 3, "f": 0.5}


@pytest.mark.parametrize("name", ["measurement.exr", "ground_truth.exr", "sample.json"])
def test_missing_files_and_those_of_another_sample_are_named(samples: ModuleType, tmp_path: Path, name: str) -> None:
    for index in (0, 1):
        write_sample(tmp_path, "train", index, samples.make_sample(index))
    first, second = (sample_folder(tmp_path, "train", index) for index in (0, 1))
    if name != "sample.json":
        (first / name).write_bytes((second / name).read_bytes())
        with pytest.raises(InputError, match=name):
            StoredSample(first).sample()
    (first / name).unlink()
    with pytest.raises(InputError, match=name):
        StoredSample(first).sample()


@pytest.mark.parametrize(
    "content",
    [
        *(b"", b"{", b"[]", b"{}", b'{"files": 3}', b"null", b"\xff"),
        *({"channels": [1, 2, 3]}, {"channels": None}, {"metadata": []}, {"files": {}}),
        {"extras": {"a": {"channels": ["a"], "components": None, "dtype": "object"}}},
    ],
)
def test_unusable_descriptions(samples: ModuleType, tmp_path: Path, content: bytes | dict) -> None:
    write_sample(tmp_path, "train", 0, samples.make_sample(0))
    path = sample_folder(tmp_path, "train", 0) / "sample.json"
    changed = content if isinstance(content, bytes) else json.dumps(json.loads(path.read_text()) | content).encode()
    path.write_bytes(changed)
    with pytest.raises(InputError, match=r"sample\.json: "):
        StoredSample(path.parent).sample()


@pytest.mark.parametrize(
    "changes",
    [
        *({"measurement": values} for values in (np.zeros((24, 36), np.float32), np.zeros((3, 24, 36)))),
        {"noiseless": np.zeros((3, 24, 35), np.float32)},
        {"rgb": np.zeros((10, 12, 3), np.float32)},
        {"depth_m": np.zeros((1, 10, 11), np.float32)},
        {"valid": np.zeros((1, 10, 12), np.float32)},
        *({"channels": names} for names in (("R", "G"), ("R", "R", "G"), ("noiseless.R", "G", "B"))),
        {"label": 3},
        *({"frame_edges_s": np.array(edges)} for edges in ([0.0, 1, 2], [0, 1], [1.0, 1.0], [0.0, np.inf])),
        {"global_measurements": np.zeros((2, 3, 24, 36), np.float32)},
    ],
)
def test_contradictions_are_refused(samples: ModuleType, changes: dict) -> None:
    with pytest.raises(InputError, match=rf"^Sample\.{'seed' if 'label' in changes else next(iter(changes))}: "):
        samples.make_sample(0, **changes)


def test_values_that_cannot_be_stored_leave_nothing(samples: ModuleType, tmp_path: Path) -> None:
    depth = np.full((1, *samples.SCENE), np.inf, np.float32)
    with pytest.raises(InputError, match=r"ground_truth\.exr: "):
        write_sample(tmp_path, "train", 0, samples.make_sample(0, depth_m=depth))
    with pytest.raises(InputError, match=r"^sample s00000000\.metadata\.a: "):
        write_sample(tmp_path, "train", 0, samples.make_sample(0, metadata={"a": float("nan")}))
    assert [path for path in tmp_path.rglob("*") if path.name.startswith((".tmp", "s0"))] == []


def test_ids_sort_like_numbers() -> None:
    numbers = [0, 9, 10, 9_999, 10_000, 10_001, 123_456, 99_999_999]
    ids = [sample_id(number) for number in numbers]
    assert sorted(ids) == ids
    assert [sample_index(identifier) for identifier in ids] == numbers
    for bad in (-1, 100_000_000):
        with pytest.raises(InputError, match=r"^index: "):
            sample_id(bad)
    for bad in ("", "00000012", "s12", "s0000001x", "s0000001²", "s-0000012"):
        with pytest.raises(InputError, match=r"^identifier: "):
            sample_index(bad)
    with pytest.raises(InputError, match=r"^split: "):
        sample_folder(Path(), "pilot", 0)


def test_wrong_extras_are_refused(samples: ModuleType, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^Sample\.extras\['a'\]: "):
        samples.make_sample(0, extras={"a": np.zeros((1, 3, 3), np.float32)})
    with pytest.raises(InputError, match=r"^extras\['a'\]: "):
        write_sample(tmp_path, "train", 0, samples.make_sample(0, extras={"a": np.zeros((1, *samples.SCENE))}))
    assert not (tmp_path / "train").exists()


@pytest.mark.filterwarnings("ignore:the PSF's sampling error")
@pytest.mark.slow
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
