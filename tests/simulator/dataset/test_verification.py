"""verify: silent on a whole data set, and no fault of any kind stays unnamed."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from simulator.dataset.manifest import ManifestWriter
from simulator.dataset.sample import write_sample
from simulator.dataset.skipped import SkippedWriter
from simulator.dataset.verification import verify
from simulator.errors import InputError

FIRST = Path("train/0000/s00000000")


def test_a_whole_data_set(dataset: Path) -> None:
    steps: list[tuple[int, int]] = []
    for workers in (1, 2):
        report = verify(dataset, workers=workers, progress=lambda done, total: steps.append((done, total)))
        assert report.ok, report.problems
        assert report.counts == report.wanted == {"train": 3, "validation": 1, "test": 0}
        assert str(report).splitlines()[-1] == "all is well"
    assert steps == [(number, 4) for number in (1, 2, 3, 4)] * 2


def flip(path: Path, position: int = -20) -> None:
    data = bytearray(path.read_bytes())
    data[position] ^= 4
    path.write_bytes(data)


def edit(path: Path, **changes: object) -> None:
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def tear(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-10])


def resize(root: Path, samples: ModuleType) -> None:
    sample = samples.make_sample(0, sensor=(20, 30), scene=(6, 8))
    with ManifestWriter(root) as manifest:
        manifest.append(write_sample(root, "train", 0, sample), 0.1)


FAULTS: dict[str, tuple[Callable[[Path], object], str]] = {
    "flipped bit": (lambda root: flip(root / FIRST / "measurement.exr"), "measurement.exr has other content"),
    "truncated": (lambda root: tear(root / FIRST / "ground_truth.exr"), "ground_truth.exr is truncated or corrupt"),
    "emptied": (lambda root: (root / FIRST / "ground_truth.exr").write_bytes(b""), "is not an OpenEXR file"),
    "no truth": (lambda root: (root / FIRST / "ground_truth.exr").unlink(), "ground_truth.exr cannot be read"),
    "no measurement": (lambda root: (root / FIRST / "measurement.exr").unlink(), "measurement.exr cannot be read"),
    "no description": (lambda root: (root / FIRST / "sample.json").unlink(), "sample.json: No such file"),
    "edited description": (lambda root: edit(root / FIRST / "sample.json", label="x"), "digest differs"),
    "edited label": (lambda root: edit(root / FIRST / "sample.json", label="x"), "speaks of another sample"),
    "swapped pair": (
        lambda root: shutil.copy(root / "train/0000/s00000001/ground_truth.exr", root / FIRST),
        "ground_truth.exr does not belong",
    ),
    "swapped folder": (
        lambda root: (shutil.rmtree(root / FIRST), shutil.copytree(root / "train/0000/s00000001", root / FIRST)),
        "s00000000: sample.json speaks of another sample",
    ),
    "extra file": (lambda root: (root / FIRST / "notes.txt").touch(), "unexpected file notes.txt"),
    "missing sample": (lambda root: shutil.rmtree(root / FIRST), "train/s00000000: in manifest.jsonl but not on disk"),
    "extra sample": (
        lambda root: shutil.copytree(root / FIRST, root / "train/0009/s00009000"),
        "train/0009/s00009000: on disk but not in manifest",
    ),
    "torn manifest": (lambda root: tear(root / "manifest.jsonl"), "the last line is torn"),
    "bad manifest": (
        lambda root: (root / "manifest.jsonl").write_bytes(b"x\n" + (root / "manifest.jsonl").read_bytes()),
        "manifest.jsonl:1: not a manifest line",
    ),
    "no manifest": (lambda root: (root / "manifest.jsonl").unlink(), "train: 0 of 3 samples are finished"),
    "leftover": (lambda root: (root / "train/0000/.tmp-s00000007-ab").mkdir(), ".tmp-s00000007-ab: left by a run"),
    "no info": (lambda root: (root / "dataset.json").unlink(), "not a data set"),
    "damaged info": (lambda root: tear(root / "dataset.json"), "unreadable or damaged"),
    "fewer wanted": (lambda root: edit(root / "dataset.json", counts={"train": 2, "validation": 1}), "says 2"),
    "split not wanted": (lambda root: edit(root / "dataset.json", counts={"train": 3}), "has no such split"),
    "other size": (lambda root: edit(root / "dataset.json", sensor_shape=[24, 35]), r"measurement is \(24, 36\)"),
    "other scene size": (lambda root: edit(root / "dataset.json", scene_shape=[9, 9]), r"ground truth is \(10, 12\)"),
    "other channels": (lambda root: edit(root / "dataset.json", channels=["G"]), "channels is"),
    "damaged PSF": (lambda root: flip(root / "psf/depth_0000.exr"), "depth_0000.exr is damaged"),
    "swapped PSFs": (
        lambda root: shutil.copy(root / "psf/depth_0001.exr", root / "psf/depth_0000.exr"),
        "depth_0000.exr is damaged",
    ),
    "no PSF": (lambda root: shutil.rmtree(root / "psf"), "no PSF stack"),
    "missing depth": (lambda root: (root / "psf/depth_0001.exr").unlink(), "cannot read .*depth_0001.exr"),
    "another PSF": (lambda root: edit(root / "psf/psf.json", fingerprint="b" * 64), "made with psf = aaa"),
    "another exposure": (lambda root: edit(root / "dataset.json", exposure={"full_scale": 1.0}), "full_scale = 0.5"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_is_named(dataset: Path, fault: str) -> None:
    spoil, words = FAULTS[fault]
    spoil(dataset)
    report = verify(dataset)
    assert not report.ok
    assert any(re.search(words, line) for line in report.problems), report


def exchange(one: Path, other: Path) -> None:
    first, second = one.read_bytes(), other.read_bytes()
    one.write_bytes(second)
    other.write_bytes(first)


FRAMES = FIRST / "frames"
CLIP_FAULTS: dict[str, tuple[Callable[[Path], object], str]] = {
    "no frame": (
        lambda root: (root / FRAMES / "ground_truth.0001.exr").unlink(),
        r"frames/ground_truth\.0001\.exr cannot be read",
    ),
    "flipped bit": (
        lambda root: flip(root / FRAMES / "global.0002.exr"),
        r"frames/global\.0002\.exr has other content",
    ),
    "torn": (lambda root: tear(root / FRAMES / "ground_truth.0000.exr"), r"ground_truth\.0000\.exr is truncated"),
    "exchanged": (
        lambda root: exchange(root / FRAMES / "ground_truth.0001.exr", root / FRAMES / "ground_truth.0002.exr"),
        r"ground_truth\.0001\.exr is frame 2 of this sample, not frame 1",
    ),
    "one more": (
        lambda root: shutil.copy(root / FRAMES / "global.0002.exr", root / FRAMES / "global.0003.exr"),
        r"unexpected file frames/global\.0003\.exr",
    ),
    "other file": (lambda root: (root / FRAMES / "notes.txt").touch(), r"unexpected file frames/notes\.txt"),
    "other folder": (
        lambda root: shutil.copytree(root / FRAMES, root / FRAMES / "old"),
        r"unexpected file frames/old$",
    ),
    "a still's truth": (lambda root: (root / FIRST / "ground_truth.exr").touch(), r"unexpected file ground_truth\.exr"),
    "other times": (lambda root: edit(root / FIRST / "sample.json", frame_edges_s=[0, 1, 2, 3]), "digest differs"),
}


@pytest.mark.parametrize("fault", CLIP_FAULTS)
def test_every_fault_of_a_clip_is_named(clips: Path, fault: str) -> None:
    assert verify(clips).ok
    spoil, words = CLIP_FAULTS[fault]
    spoil(clips)
    problems = verify(clips).problems
    assert all("train/s00000000: " in line for line in problems)
    assert any(re.search(words, line) for line in problems), problems


def test_frames_beside_a_still_are_one_fault(dataset: Path, clips: Path) -> None:
    shutil.copytree(clips / FRAMES, dataset / FRAMES)
    assert verify(dataset).problems == ("train/s00000000: unexpected file frames",)


def test_only_the_damaged_sample_is_counted_out(dataset: Path) -> None:
    flip(dataset / FIRST / "measurement.exr")
    report = verify(dataset)
    assert report.counts == {"train": 2, "validation": 1, "test": 0}
    assert all("s00000000" in line for line in report.problems)
    assert "train: 2 of 3 intact" in str(report)


def test_skipped_samples_are_counted_and_no_fault(dataset: Path) -> None:
    edit(dataset / "dataset.json", counts={"train": 5, "validation": 1, "test": 0})
    with SkippedWriter(dataset) as skipped:
        skipped.append("train", 4, "clip.webm is truncated")
        skipped.append("train", 0, "left out once, and made since")
    report = verify(dataset)
    assert report.problems == ("train: 3 of 5 samples are finished and 1 skipped; run generate again to resume",)
    with SkippedWriter(dataset) as skipped:
        skipped.append("train", 3, "clip.webm is truncated")
    report = verify(dataset)
    assert report.ok, report.problems
    assert (report.counts["train"], report.skipped, report.wanted["train"]) == (3, {"train": 2}, 5)
    assert str(report).startswith("train: 3 of 5 intact, 2 skipped (skipped.jsonl), validation: 1 of 1 intact, ")
    (dataset / "skipped.jsonl").write_text("{}\n")
    assert any("skipped.jsonl:1: not a line" in line for line in verify(dataset).problems)


def test_a_sample_of_another_size_is_noticed(dataset: Path, samples: ModuleType) -> None:
    resize(dataset, samples)
    assert [line.split(": ", 1)[1] for line in verify(dataset).problems] == [
        "measurement is (20, 30), dataset.json says (24, 36)",
        "ground truth is (6, 8), dataset.json says (10, 12)",
    ]


def test_no_such_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        verify(tmp_path / "gone")
