"""Samples of several frames: exact round trips of any clip, and no frame can go, come or change places unnoticed."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.dataset.sample import MOST_FRAMES, Sample, StoredSample, file_names, sample_folder, write_sample
from simulator.errors import InputError
from simulator.io.exr import read_exr
from simulator.io.files import sha256_file
from simulator.types import Surroundings

ARRAYS = ("measurement", "noiseless", "rgb", "depth_m", "valid", "frame_edges_s", "global_measurements")
DTYPES = ("bool", "uint8", "int16", "uint16", "int32", "float16", "float32")


def any_values(rng: np.random.Generator, shape: tuple[int, ...], dtype: str) -> np.ndarray:
    """Every finite value of a type that 32-bit channels hold, also -0.0 and subnormal numbers."""
    if dtype == "bool":
        return rng.random(shape) > 0.5
    if dtype.startswith("float"):
        width, exponent_bit = (16, 2**10) if dtype == "float16" else (32, 2**23)
        bits = rng.integers(0, 2**width, shape, f"u{width // 8}")
        bits[bits & exponent_bit != 0] -= exponent_bit  # a cleared bit of the exponent: neither inf nor NaN
        return bits.view(dtype)
    limits = np.iinfo(dtype)
    return rng.integers(max(limits.min, -(2**24)), min(limits.max, 2**24), shape, dtype, endpoint=True)


@st.composite
def clip_samples(draw: st.DrawFn) -> Sample:
    """Any number of frames, any extras, arrays with any strides."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    sizes = st.integers(1, 5)
    frames, channels = draw(sizes), draw(sizes)
    scene, sensor = draw(st.tuples(sizes, sizes)), draw(st.tuples(sizes, sizes))

    def strided(*shape: int, dtype: str = "float32") -> Any:
        steps = [int(step) for step in rng.choice([-2, -1, 1, 2], len(shape))]
        order = rng.permutation(len(shape))
        full = [size * abs(step) for size, step in zip(shape, steps, strict=True)]
        base = np.zeros([full[axis] for axis in order], dtype).transpose(np.argsort(order))
        view = base[tuple(slice(None, None, step) for step in steps)]
        view[...] = any_values(rng, shape, dtype)
        return view

    extras = {}
    for name in draw(st.sets(st.sampled_from(["shape_id", "normal", "hidden1_rgb", "bands", "own"]))):
        components = [int(rng.integers(1, 4))] if name == "bands" or rng.random() < 0.5 else []
        extras[name] = strided(frames, *scene, *components, dtype=str(rng.choice(DTYPES)))

    def around(count: int, coarseness: int) -> Surroundings:
        beside = draw(st.tuples(sizes, sizes))
        depths_m = np.abs(strided(count, *beside)) + np.float32(1e-30)
        return Surroundings(np.abs(strided(count, *beside, 3)), depths_m, coarseness)

    times = st.floats(allow_nan=False, allow_infinity=False)
    edges = st.lists(times, min_size=frames + 1, max_size=frames + 1, unique=True).map(sorted)
    with_edges, with_global = frames > 1 or draw(st.booleans()), draw(st.booleans())
    return Sample(
        measurement=strided(channels, *sensor),
        noiseless=strided(channels, *sensor),
        rgb=strided(frames, *scene, 3),
        depth_m=strided(frames, *scene),
        valid=strided(frames, *scene, dtype="bool"),
        seed=0,
        channels=tuple(f"c{number}" for number in range(channels)),
        extras=extras,
        frame_edges_s=np.array(draw(edges)) if with_edges else None,
        global_measurements=strided(frames, channels, *sensor) if with_global else None,
        surroundings=draw(st.none() | st.builds(around, st.sampled_from([1, frames]), st.integers(1, 9))),
    )


def assert_same_bits(one: np.ndarray | None, other: np.ndarray | None) -> None:
    assert (one is None) == (other is None)
    if one is not None and other is not None:
        assert (one.dtype, one.shape) == (other.dtype, other.shape)
        assert one.tobytes() == other.tobytes()


@given(clip_samples())
@settings(max_examples=40, deadline=None)
def test_any_clip_comes_back_bit_by_bit(tmp_path_factory: pytest.TempPathFactory, sample: Sample) -> None:
    root = tmp_path_factory.getbasetemp() / "clips"
    write_sample(root, "train", 1, sample)
    folder = sample_folder(root, "train", 1)
    back = StoredSample(folder).sample()
    for name in ARRAYS:
        assert_same_bits(getattr(back, name), getattr(sample, name))
    assert set(back.extras) == set(sample.extras)
    for name, values in sample.extras.items():
        assert_same_bits(back.extras[name], values)
    beside, found = sample.surroundings, back.surroundings
    assert (found is None) == (beside is None)
    if found is not None and beside is not None:
        assert_same_bits(found.rgb, beside.rgb)
        assert_same_bits(found.depth_m, beside.depth_m)
        assert found.coarseness == beside.coarseness
    names = file_names(
        len(sample.rgb), sample.global_measurements is not None, 0 if beside is None else len(beside.rgb)
    )
    expected = {"sample.json", *names}
    found = {path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()}
    assert found == expected  # also after another sample lay in this folder


def test_what_lies_in_which_file(samples: ModuleType, tmp_path: Path) -> None:
    sample = samples.make_clip_sample(2)
    write_sample(tmp_path, "train", 0, sample)
    folder = sample_folder(tmp_path, "train", 0)
    names = [f"frames/{kind}.{frame:04d}.exr" for kind in ("global", "ground_truth") for frame in range(3)]
    paths = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*.*"))
    assert paths == [*names, "measurement.exr", "sample.json"]
    description = json.loads((folder / "sample.json").read_text())
    hashes = description.pop("files")
    assert hashes == {name: sha256_file(folder / name) for name in [*names, "measurement.exr"]}
    assert (description["frames"], description["global_measurements"]) == (3, True)
    assert description["frame_edges_s"] == sample.frame_edges_s.tolist()
    assert read_exr(folder / "measurement.exr")[1] == description
    for frame in range(3):
        truth, truth_metadata = read_exr(folder / f"frames/ground_truth.{frame:04d}.exr")
        measured, measured_metadata = read_exr(folder / f"frames/global.{frame:04d}.exr")
        assert truth_metadata == measured_metadata == description | {"frame": frame}
        np.testing.assert_array_equal(truth["G"], sample.rgb[frame, ..., 1])
        np.testing.assert_array_equal(truth["id"], sample.extras["shape_id"][frame])
        assert sorted(measured) == ["B", "G", "R"]
        np.testing.assert_array_equal(measured["B"], sample.global_measurements[frame, 2])


def test_a_still_says_nothing_of_time(samples: ModuleType, tmp_path: Path) -> None:
    """Its bytes are those that stills had before there were clips and extras: no new key."""
    write_sample(tmp_path, "train", 0, samples.make_sample(0))
    keys = json.loads((sample_folder(tmp_path, "train", 0) / "sample.json").read_text())
    assert " ".join(sorted(keys)) == "channels files frames id index label metadata scene_shape seed sensor_shape split"


def test_only_what_is_asked_for_is_read(samples: ModuleType, tmp_path: Path) -> None:
    sample = samples.make_clip_sample(0)
    write_sample(tmp_path, "train", 0, sample)
    folder = sample_folder(tmp_path, "train", 0)
    for name in ("frames/ground_truth.0000.exr", "frames/ground_truth.0001.exr", "frames/global.0000.exr"):
        (folder / name).unlink()
    stored = StoredSample(folder)
    assert (stored.frames, stored.label, stored.channels) == (3, sample.label, sample.channels)
    assert_same_bits(stored.frame_edges_s, sample.frame_edges_s)
    measurement, noiseless = stored.measurement()
    assert_same_bits(measurement, sample.measurement)
    assert_same_bits(noiseless, sample.noiseless)
    frame = stored.frame(2)
    assert_same_bits(frame.rgb, sample.rgb[2])
    assert_same_bits(frame.depth_m, sample.depth_m[2])
    assert_same_bits(frame.valid, sample.valid[2])
    assert_same_bits(frame.extras["shape_id"], sample.extras["shape_id"][2])
    assert_same_bits(stored.global_measurement(1), sample.global_measurements[1])
    write_sample(tmp_path, "train", 1, samples.make_sample(0))
    with pytest.raises(InputError, match="s00000001: "):
        StoredSample(sample_folder(tmp_path, "train", 1)).global_measurement(0)


def exchange(folder: Path, one: str, other: str) -> None:
    """Let two files of a sample change places, so that even the hashes in sample.json fit."""
    first, second = (folder / one).read_bytes(), (folder / other).read_bytes()
    (folder / one).write_bytes(second)
    (folder / other).write_bytes(first)
    description = json.loads((folder / "sample.json").read_text())
    hashes = description["files"]
    hashes[one], hashes[other] = hashes[other], hashes[one]
    (folder / "sample.json").write_text(json.dumps(description))


def edit(path: Path, **changes: object) -> None:
    content = {key: value for key, value in (json.loads(path.read_text()) | changes).items() if value is not None}
    path.write_text(json.dumps(content))


TRUTH, GLOBAL = "frames/ground_truth.000{}.exr", "frames/global.000{}.exr"
FAULTS: dict[str, tuple[Callable[[Path], object], str]] = {
    "missing frame": (lambda folder: (folder / TRUTH.format(1)).unlink(), r"ground_truth\.0001\.exr"),
    "missing global": (lambda folder: (folder / GLOBAL.format(2)).unlink(), r"global\.0002\.exr"),
    "no frames": (lambda folder: shutil.rmtree(folder / "frames"), r"ground_truth\.0000\.exr"),
    "emptied frame": (lambda folder: (folder / GLOBAL.format(0)).write_bytes(b""), r"global\.0000\.exr"),
    "exchanged frames": (
        lambda folder: exchange(folder, TRUTH.format(1), TRUTH.format(2)),
        r"ground_truth\.0001\.exr: .*2 .*1",
    ),
    "exchanged globals": (
        lambda folder: exchange(folder, GLOBAL.format(0), GLOBAL.format(1)),
        r"global\.0000\.exr: .*1 .*0",
    ),
    "truth for global": (
        lambda folder: exchange(folder, TRUTH.format(1), GLOBAL.format(1)),
        r"ground_truth\.0001\.exr",
    ),
    "measurement for global": (
        lambda folder: exchange(folder, "measurement.exr", GLOBAL.format(1)),
        r"measurement\.exr",
    ),
    "one frame more": (
        lambda folder: shutil.copy(folder / TRUTH.format(2), folder / TRUTH.format(3)),
        r"ground_truth\.0003\.exr",
    ),
    "frame of another sample": (
        lambda folder: shutil.copy(folder.parent / "s00000001" / TRUTH.format(1), folder / TRUTH.format(1)),
        r"ground_truth\.0001\.exr",
    ),
    "other times": (
        lambda folder: edit(folder / "sample.json", frame_edges_s=[0.0, 1.0, 2.0, 3.0]),
        r"measurement\.exr",
    ),
    "no times": (lambda folder: edit(folder / "sample.json", frame_edges_s=None), r"sample\.json"),
    "too few times": (lambda folder: edit(folder / "sample.json", frame_edges_s=[0.0, 1.0]), r"sample\.json"),
    "times backwards": (lambda folder: edit(folder / "sample.json", frame_edges_s=[0, 2, 1, 3]), r"sample\.json"),
    "times in words": (lambda folder: edit(folder / "sample.json", frame_edges_s=["a"] * 4), r"sample\.json"),
    "fewer frames": (lambda folder: edit(folder / "sample.json", frames=2), r"sample\.json"),
    "no number of frames": (lambda folder: edit(folder / "sample.json", frames=[3]), r"sample\.json"),
    "far too many frames": (lambda folder: edit(folder / "sample.json", frames=10**12), r"sample\.json"),
    "no globals": (lambda folder: edit(folder / "sample.json", global_measurements=False), r"sample\.json"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_is_named(samples: ModuleType, tmp_path: Path, fault: str) -> None:
    for index in (0, 1):
        write_sample(tmp_path, "train", index, samples.make_clip_sample(index))
    folder = sample_folder(tmp_path, "train", 0)
    spoil, words = FAULTS[fault]
    spoil(folder)
    with pytest.raises(InputError, match=words):
        StoredSample(folder).sample()


def test_names_of_frames_sort_and_end(samples: ModuleType, tmp_path: Path) -> None:
    names = file_names(MOST_FRAMES, global_measurements=True, surroundings=MOST_FRAMES)
    assert len(set(names)) == 3 * MOST_FRAMES + 1
    truths = names[1 : 1 + MOST_FRAMES]
    still = ["measurement.exr", "ground_truth.exr", "frames/global.0000.exr", "surroundings.exr"]
    assert file_names(1, global_measurements=True, surroundings=1) == still
    assert truths == sorted(truths)
    frames = (MOST_FRAMES + 1, 1, 1)
    pixel = {
        "rgb": np.zeros((*frames, 3), np.float32),
        "depth_m": np.ones(frames, np.float32),
        "valid": np.ones(frames, bool),
        "frame_edges_s": np.arange(MOST_FRAMES + 2.0),
    }
    with pytest.raises(InputError, match=r"^sample s00000000: "):
        write_sample(tmp_path, "train", 0, samples.make_sample(0, **pixel))
    assert list(tmp_path.iterdir()) == []


def test_several_frames_need_times(samples: ModuleType) -> None:
    with pytest.raises(InputError, match=r"^Sample\.frame_edges_s: "):
        samples.make_clip_sample(0, frame_edges_s=None)
    with pytest.raises(InputError, match=r"^Sample\.global_measurements: "):
        samples.make_clip_sample(0, global_measurements=np.zeros((2, 3, 24, 36), np.float32))
