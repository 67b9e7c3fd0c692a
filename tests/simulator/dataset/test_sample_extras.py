"""What is known of a scene beside colour and depth is stored with the sample and comes back as it was."""

import json
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from simulator.assembly import Assembly
from simulator.config import load_config
from simulator.dataset import open_dataset, verify
from simulator.dataset.sample import read_sample, sample_folder, write_sample
from simulator.errors import InputError
from simulator.io.exr import read_exr
from simulator.seeds import generator

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


def test_round_trip(samples: ModuleType, tmp_path: Path) -> None:
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
