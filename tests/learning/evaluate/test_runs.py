"""Cameras: the numbers of the test's, the PSFs that were asked for, one white."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from learning.camera import CaptureModel, camera_identity, measure_reference_white
from learning.evaluate.methods import ClassicalEntry, LearnedEntry
from learning.evaluate.runs import Cameras, ResultCache
from simulator.dataset.reader import Dataset, open_dataset
from simulator.errors import InputError
from simulator.optics.stack_files import read_psf_stack, write_psf_stack


def _entry(capture: CaptureModel, file: str = "a.safetensors") -> LearnedEntry:
    return LearnedEntry("net", Path(file), "0" * 64, capture, {}, {})


@pytest.fixture(scope="module")
def test_split(tiny_dataset: Path) -> Dataset:
    return open_dataset(tiny_dataset, "test")


def test_numbers_are_the_tests_and_psfs_and_white_the_methods(test_split: Dataset, tiny_camera: CaptureModel) -> None:
    stack = replace(tiny_camera.stack, values=np.asarray(tiny_camera.stack.values) * 2)
    trained = replace(tiny_camera.with_stack(stack), gain=123.0, offset=tiny_camera.offset + 0.5, white=0.77)
    entry = _entry(trained)
    assumed = Cameras(test_split, None, [entry]).assumed(entry, "own")
    assert assumed.gain == tiny_camera.gain
    np.testing.assert_array_equal(assumed.offset, tiny_camera.offset)
    assert assumed.white == 0.77
    np.testing.assert_array_equal(assumed.stack.values, stack.values)


def test_classical_methods_believe_the_training_set(test_split: Dataset, tiny_dataset: Path) -> None:
    entry = ClassicalEntry("CLS", "cls", None, {})
    cameras = Cameras(test_split, tiny_dataset, [entry])
    assert cameras.test.white == measure_reference_white(open_dataset(tiny_dataset, "train"))
    for name, folder in (("own", "psf"), ("nominal", "psf"), ("captured", "psf_captured")):
        found = cameras.assumed(entry, name).stack
        np.testing.assert_array_equal(found.values, read_psf_stack(tiny_dataset / folder).values)
    nominal, captured = (camera_identity(cameras.assumed(entry, name)) for name in ("nominal", "captured"))
    assert nominal != captured
    assert nominal == camera_identity(cameras.assumed(entry, "own"))


def test_a_stack_may_lie_in_any_folder(test_split: Dataset, tiny_camera: CaptureModel, tmp_path: Path) -> None:
    stack = replace(tiny_camera.stack, values=np.asarray(tiny_camera.stack.values)[..., ::-1].copy())
    write_psf_stack(tmp_path / "mine", stack)
    entry = _entry(tiny_camera)
    assumed = Cameras(test_split, None, [entry], lambda name: tmp_path / name).assumed(entry, "mine")
    np.testing.assert_array_equal(assumed.stack.values, stack.values)


def test_methods_of_two_whites_are_refused(test_split: Dataset, tiny_camera: CaptureModel) -> None:
    other = _entry(replace(tiny_camera, white=tiny_camera.white * 1.01), "b.safetensors")  # another seed of one network
    with pytest.raises(InputError, match=r"^methods: net \(b\.safetensors\) .*net \(a\.safetensors\)"):
        Cameras(test_split, None, [_entry(tiny_camera), other])
    near = _entry(
        replace(tiny_camera, white=tiny_camera.white * 1.0003)
    )  # learned from the same data, rendered elsewhere
    assert Cameras(test_split, None, [_entry(tiny_camera), near]).test.white == tiny_camera.white


def test_a_method_of_another_camera_is_refused_by_name(test_split: Dataset, tiny_camera: CaptureModel) -> None:
    entry = _entry(replace(tiny_camera, sensor_shape=(64, 64)))
    with pytest.raises(InputError, match=r"^net: "):
        Cameras(test_split, None, [entry]).assumed(entry, "own")


@pytest.mark.parametrize("change", ["gain", "white", "values", "offset"])
def test_whatever_a_camera_holds_is_in_its_identity(tiny_capture: CaptureModel, change: str) -> None:
    if change == "values":
        values = np.array(tiny_capture.stack.values)
        values[0, 0, 16, 16] += 1e-3
        other = tiny_capture.with_stack(replace(tiny_capture.stack, values=values))
    else:
        other = replace(tiny_capture, **{change: getattr(tiny_capture, change) * 1.001})
    assert camera_identity(other) != camera_identity(tiny_capture)


KEY = {"method": {"checkpoint": "ab"}, "noise": {"db": 20.0, "seed": 0}}


def test_a_result_comes_back_under_its_key_alone(tmp_path: Path) -> None:
    cache = ResultCache(tmp_path / "new" / "cache")
    result = {"scores": [{"psnr": math.inf, "ssim": 0.1 + 0.2}]}
    cache.save(KEY, result)
    assert ResultCache(cache.folder).load(KEY) == result
    assert cache.load(KEY | {"noise": {"db": 30.0, "seed": 0}}) is None


def test_arrays_come_back_exactly(tmp_path: Path) -> None:
    cache = ResultCache(tmp_path)
    image = np.random.default_rng(0).random((3, 4, 5)).astype(np.float32)
    cache.save_arrays(KEY, {"image": image})
    found = cache.load_arrays(KEY)
    assert found is not None
    np.testing.assert_array_equal(found["image"], image)
    assert cache.load_arrays(KEY | {"scene": 1}) is None


@pytest.mark.parametrize("damage", [b"", b"{", b"[]", b'{"key": 1}', b'{"key": {}, "result": {}}', b"PK\x03\x04broken"])
def test_damaged_files_count_as_missing(tmp_path: Path, damage: bytes) -> None:
    cache = ResultCache(tmp_path)
    cache.save(KEY, {"scores": []})
    cache.save_arrays(KEY, {"image": np.zeros(3)})
    for path in tmp_path.iterdir():
        path.write_bytes(damage)
    assert cache.load(KEY) is None
    assert cache.load_arrays(KEY) is None
