"""verify: silent on a whole data set, and no fault of any kind stays unnamed."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from simulator.dataset.checksums import CHECKSUMS, write_seal
from simulator.dataset.fingerprint import hash_parts
from simulator.dataset.manifest import ManifestWriter, SkippedWriter
from simulator.dataset.sample import write_sample
from simulator.dataset.verification import verify
from simulator.errors import InputError

FIRST = Path("train/0000/s00000000")
FRAMES = FIRST / "frames"


def test_a_whole_data_set_and_frames_beside_a_still(dataset: Path, clips: Path) -> None:
    steps: list[tuple[int, int]] = []
    for workers in (1, 2):
        report = verify(dataset, workers=workers, progress=lambda done, total: steps.append((done, total)))
        assert report.ok, report.problems
        assert report.counts == report.wanted == {"train": 3, "validation": 1, "test": 0}
        assert str(report).splitlines()[-1] == "all is well"
    assert steps == [(number, 4) for number in (1, 2, 3, 4)] * 2
    shutil.copytree(clips / FRAMES, dataset / FRAMES)
    assert verify(dataset).problems == ("train/s00000000: unexpected file frames",)
    with pytest.raises(InputError, match="gone: "):
        verify(dataset / "gone")


def flip(path: Path, position: int = -20) -> None:
    data = bytearray(path.read_bytes())
    data[position] ^= 4
    path.write_bytes(data)


def edit(path: Path, **changes: object) -> None:
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


def edit_sealed(path: Path, **changes: object) -> None:
    """What an edit is told as by the values, not by the seal."""
    edit(path, **changes)
    write_seal(path.parent)


def tear(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-10])


FAULTS: dict[str, tuple[Callable[[Path], object], str]] = {
    "flipped bit": (lambda root: flip(root / FIRST / "measurement.exr"), "measurement.exr"),
    "no measurement": (lambda root: (root / FIRST / "measurement.exr").unlink(), "measurement.exr"),
    "no description": (lambda root: (root / FIRST / "sample.json").unlink(), "sample.json"),
    "edited description": (lambda root: edit(root / FIRST / "sample.json", label="x"), "digest"),
    "swapped folder": (
        lambda root: (shutil.rmtree(root / FIRST), shutil.copytree(root / "train/0000/s00000001", root / FIRST)),
        "s00000000: sample.json",
    ),
    "extra file": (lambda root: (root / FIRST / "notes.txt").touch(), "notes.txt"),
    "missing sample": (lambda root: shutil.rmtree(root / FIRST), "train/s00000000: .*manifest.jsonl"),
    "extra sample": (
        lambda root: shutil.copytree(root / FIRST, root / "train/0009/s00009000"),
        "train/0009/s00009000: .*manifest",
    ),
    "torn manifest": (lambda root: tear(root / "manifest.jsonl"), "manifest.jsonl"),
    "bad manifest": (
        lambda root: (root / "manifest.jsonl").write_bytes(b"x\n" + (root / "manifest.jsonl").read_bytes()),
        "manifest.jsonl:1: ",
    ),
    "no manifest": (lambda root: (root / "manifest.jsonl").unlink(), "train: 0 of 3"),
    "leftover": (lambda root: (root / "train/0000/.tmp-s00000007-ab").mkdir(), r"\.tmp-s00000007-ab: left by"),
    "no info": (lambda root: (root / "dataset.json").unlink(), "dataset.json"),
    "damaged info": (lambda root: tear(root / "dataset.json"), "dataset.json"),
    "fewer wanted": (lambda root: edit(root / "dataset.json", counts={"train": 2, "validation": 1}), "says 2"),
    "split not wanted": (lambda root: edit(root / "dataset.json", counts={"train": 3}), "split"),
    "other size": (lambda root: edit(root / "dataset.json", sensor_shape=[24, 35]), r"measurement is \(24, 36\)"),
    "other truth": (lambda root: edit(root / "dataset.json", scene_shape=[10, 11]), r"ground truth is \(10, 12\)"),
    "other channels": (lambda root: edit(root / "dataset.json", channels=["G"]), "channels"),
    "damaged PSF": (lambda root: flip(root / "psf/depth_0000.exr"), "depth_0000.exr"),
    "no PSF": (lambda root: shutil.rmtree(root / "psf"), "psf"),
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
    if fault == "flipped bit":
        assert report.counts == {"train": 2, "validation": 1, "test": 0}
        assert all("s00000000" in line for line in report.problems)
        assert "train: 2 of 3 intact" in str(report)


def tripled_depths(root: Path) -> None:
    depths_m = json.loads((root / "psf/psf.json").read_text())["depths_m"]
    edit(root / "psf/psf.json", depths_m=[3 * depth for depth in depths_m])


EDITS: dict[str, Callable[[Path], object]] = {
    "psf/psf.json depths_m": tripled_depths,
    **{
        f"psf/psf.json {key}": lambda root, key=key, value=value: edit(root / "psf/psf.json", **{key: value})
        for key, value in {"pixel_pitch_m": 3e-5, "frame": "physical", "provenance": {"sampling": "0"}}.items()
    },
    **{
        f"dataset.json {key}": lambda root, key=key, value=value: edit(root / "dataset.json", **{key: value})
        for key, value in {
            "scene_to_camera": {"matrix": [[1, 0, 0], [0, 1, 0], [0, 0, 2]]},
            "exposure": {"full_scale": 0.5, "from": "illuminance", "illuminance_lux": 10},
            "versions": {"numpy": "2.1"},
            "name": "large",
        }.items()
    },
}


@pytest.mark.parametrize("change", EDITS)
def test_descriptions_are_as_they_were_sealed(dataset: Path, change: str) -> None:
    EDITS[change](dataset)
    assert verify(dataset).problems[0].startswith(f"{dataset / change.split()[0]}: ")


def test_what_is_gone_is_told_once(dataset: Path) -> None:
    (dataset / "contact_sheet.png").write_bytes(b"drawn")
    write_seal(dataset)
    (dataset / "contact_sheet.png").unlink()
    shutil.rmtree(dataset / "psf")
    assert [line.partition(": ")[0] for line in verify(dataset).problems] == [
        str(dataset / "contact_sheet.png"),
        str(dataset / "psf"),
    ]


STRAYS = [
    *("notes.txt", ".DS_Store", "old/", ".git/", "psf/extra.exr", "psf/depth_0009.exr", "psf/.old/", "psf_captured/"),
    *(
        "skipped.jsonl",
        "contact_sheet.png",
        "train/notes.txt",
        "train/.hidden/",
        "train/0000/.s00000000",
        "train/0000/x/",
    ),
    *("train/00001/", "train/0000/s00000000/.notes", "train/0000/s00000000/more/"),
]


@pytest.mark.parametrize("stray", STRAYS)
def test_what_lies_there_and_should_not(dataset: Path, stray: str) -> None:
    """Of a folder one line tells, whatever is in it."""
    if stray.endswith("/"):
        (dataset / stray).mkdir()
        (dataset / stray / "more").touch()
    else:
        (dataset / stray).touch()
    (problem,) = verify(dataset).problems
    name = stray.rstrip("/")
    inside = f"train/s00000000: unexpected file {name.rpartition('/')[2]}"
    assert problem == inside if "/s00000000/" in name else problem.startswith(f"{name}: ")


@pytest.mark.parametrize("place", ["dataset.json", "psf", "train", "train/0000/s00000000/measurement.exr", "more"])
def test_nothing_is_read_through_a_link(dataset: Path, tmp_path: Path, place: str) -> None:
    """Not even where it leads to the same file as before."""
    path, outside = dataset / place, tmp_path / "outside"
    if path.exists():
        path.rename(outside)
    path.symlink_to(outside)
    (problem,) = verify(dataset).problems
    assert problem.startswith(f"{place}: a link; ")


def test_an_id_beyond_ten_million_is_no_stray(samples: ModuleType, tmp_path: Path) -> None:
    root = samples.make_dataset(tmp_path / "set", counts={"train": 4, "validation": 1, "test": 0})
    with ManifestWriter(root) as manifest:
        manifest.append(write_sample(root, "train", 12_345_678, samples.make_sample(12_345_678)), seconds=0.1)
    write_seal(root)
    assert (root / "train/12345/s12345678").is_dir()
    assert verify(root).problems == ()


def test_documents_beside_the_data_are_noted(dataset: Path) -> None:
    for name in ("README.md", "LICENSE"):
        (dataset / name).write_text("by the user")
    report = verify(dataset)
    assert report.ok
    assert [line.split(":")[0] for line in report.notes] == ["LICENSE", "README.md"]
    assert "note: README.md: " in str(report)


def test_lines_that_repeat_are_counted(dataset: Path) -> None:
    manifest = dataset / "manifest.jsonl"
    manifest.write_bytes(manifest.read_bytes() * 500)
    changed, repeated = verify(dataset).problems
    assert changed.startswith(f"{manifest}: ")
    assert repeated.startswith("manifest.jsonl: 1996 lines ")


def test_a_data_set_without_its_seal_is_whole_only_when_asked_to_seal_it(dataset: Path) -> None:
    (dataset / CHECKSUMS).unlink()
    (problem,) = verify(dataset).problems
    assert problem.startswith(f"{CHECKSUMS}: missing")
    assert "generate" in problem
    flip(dataset / FIRST / "measurement.exr")
    assert problem in verify(dataset, seal=True).problems  # never over a fault
    assert not (dataset / CHECKSUMS).exists()
    flip(dataset / FIRST / "measurement.exr")
    assert verify(dataset, seal=True).ok
    assert verify(dataset).ok


@pytest.mark.parametrize(
    "content", [b"", b"{}", b"[1]", b'{"files": {}}', b"[" * 100_000, b"\xff", b"{" + b" " * (17 << 20)]
)
def test_a_seal_that_is_none(dataset: Path, content: bytes) -> None:
    (dataset / CHECKSUMS).write_bytes(content)
    (problem,) = verify(dataset).problems
    assert problem.startswith(f"{dataset / CHECKSUMS}: ")


def test_a_seal_speaks_of_its_data_set_only(dataset: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("simulator.dataset.checksums.files_to_seal", lambda root: ["../set/dataset.json", "/dev/null"])
    write_seal(dataset)
    (problem,) = verify(dataset).problems
    assert problem.startswith(f"{dataset / CHECKSUMS}: ")


def exchange(one: Path, other: Path) -> None:
    first, second = one.read_bytes(), other.read_bytes()
    one.write_bytes(second)
    other.write_bytes(first)


CLIP_FAULTS: dict[str, tuple[Callable[[Path], object], str]] = {
    "flipped bit": (lambda root: flip(root / FRAMES / "global.0002.exr"), r"frames/global\.0002\.exr"),
    "exchanged": (
        lambda root: exchange(root / FRAMES / "ground_truth.0001.exr", root / FRAMES / "ground_truth.0002.exr"),
        r"ground_truth\.0001\.exr: .*frame 2 .*frame 1",
    ),
    "one more": (
        lambda root: shutil.copy(root / FRAMES / "global.0002.exr", root / FRAMES / "global.0003.exr"),
        r"frames/global\.0003\.exr",
    ),
    "other folder": (lambda root: shutil.copytree(root / FRAMES, root / FRAMES / "old"), r"frames/old$"),
    "a still's truth": (lambda root: (root / FIRST / "ground_truth.exr").touch(), r"ground_truth\.exr"),
}


@pytest.mark.parametrize("fault", CLIP_FAULTS)
def test_every_fault_of_a_clip_is_named(clips: Path, fault: str) -> None:
    assert verify(clips).ok
    spoil, words = CLIP_FAULTS[fault]
    spoil(clips)
    problems = verify(clips).problems
    assert all("train/s00000000: " in line for line in problems)
    assert any(re.search(words, line) for line in problems), problems


ROLLING = {"type": "rolling", "exposure_s": 2e-3, "line_time_s": 25e-6, "direction": "down", "binning": 1}
DUAL = {"type": "dual_rolling", "exposure_s": 2e-3, "line_time_s": 25e-6, "order": "centre_out", "binning": 1}
WINDOWS = {"type": "windows", "table_s": [[0.0, 2e-3]] * 24, "binning": 1}
STILL = {"type": "global", "exposure_s": 2e-3, "binning": 1}
OTHER_RECORDS = [
    *((one, other, f"type: {one['type']} -> {other['type']}") for one, other in ((STILL, WINDOWS), (WINDOWS, STILL))),
    (ROLLING, DUAL, "type: rolling -> dual_rolling"),
    (STILL, {"exposure_s": 5e-4}, "exposure_s: 0.002 -> 0.0005"),
    (STILL, {"binning": 2}, "binning: 1 -> 2"),
    (ROLLING, {"line_time_s": 1e-6}, "line_time_s: 2.5e-05 -> 1e-06"),
    (ROLLING, {"direction": "up"}, "direction: down -> up"),
    (DUAL, {"order": "outside_in"}, "order: centre_out -> outside_in"),
    (WINDOWS, {"table_s": [[0.0, 2e-3]] * 48, "binning": 2}, "binning: 1 -> 2"),
    (WINDOWS, {"table_s": [[0.0, 2e-3]] * 23}, "23 rows"),
    (STILL, {"binning": 10**12}, "24000000000000"),
]


@pytest.mark.parametrize(("record", "changes", "words"), OTHER_RECORDS)
def test_a_recorded_shutter_agrees_with_the_configuration(
    samples: ModuleType, tmp_path: Path, record: dict, changes: dict, words: str
) -> None:
    root = samples.make_dataset(tmp_path / "set", samples.make_clip_sample, time={"shutter": record})
    assert verify(root).problems == ()
    edit_sealed(root / "dataset.json", time={"shutter": changes if "type" in changes else record | changes})
    (problem,) = verify(root).problems
    assert problem.startswith("dataset.json: time.shutter")
    assert words in problem


def test_frames_cover_the_shutter(samples: ModuleType, tmp_path: Path) -> None:
    """The samples last 10 ms; the last of 24 rows closes after 2 ms + 23 x 0.5 ms."""
    late = ROLLING | {"line_time_s": 0.5e-3}
    root = samples.make_dataset(tmp_path / "set", samples.make_clip_sample, time={"shutter": late})
    problems = verify(root).problems
    words = "its frames do not cover the shutter: the clip lasts from 0 to 0.01 s, but the shutter is open from 0 to 0.0135 s"
    names = ("train/s00000000", "train/s00000001", "train/s00000002", "validation/s00000000")
    assert sorted(problems) == [f"{name}: {words}" for name in names]
    short = ROLLING | {"line_time_s": 0.3e-3}  # 2 ms + 23 x 0.3 ms: seen as a whole
    assert verify(samples.make_dataset(tmp_path / "short", samples.make_clip_sample, time={"shutter": short})).ok


def test_what_was_hashed_belongs_to_the_fingerprint_and_to_the_configuration(dataset: Path) -> None:
    before = json.loads((dataset / "dataset.json").read_text())
    config, parts = before["config"], before["fingerprint_parts"]
    edit_sealed(dataset / "dataset.json", config=config | {"name": "x"})
    assert verify(dataset).ok
    older = parts | {"config": parts["config"] | {"dataset": {"share_videos": False}}}  # once hashed, now free
    newer = config | {"dataset": {"share_videos": True}}
    edit_sealed(dataset / "dataset.json", config=newer, fingerprint=hash_parts(older), fingerprint_parts=older)
    assert verify(dataset).ok, str(verify(dataset))
    edit_sealed(dataset / "dataset.json", **before)
    edit_sealed(dataset / "dataset.json", config=config | {"seed": 8})
    assert verify(dataset).problems == (
        "dataset.json: config is not what fingerprint_parts holds: seed: 7 -> 8; restore it from a copy",
    )
    edit_sealed(dataset / "dataset.json", config=config, fingerprint_parts=parts | {"backend": "other"})
    (problem,) = verify(dataset).problems
    assert problem.startswith(f"dataset.json: fingerprint is {before['fingerprint'][:12]}, but its parts make ")
    edit_sealed(dataset / "dataset.json", fingerprint="0" * 64, fingerprint_parts=parts)
    (problem,) = verify(dataset).problems
    assert "fingerprint is 000000000000, but its parts make " + before["fingerprint"][:12] in problem


def test_skipped_samples_are_counted_and_no_fault(dataset: Path) -> None:
    edit_sealed(dataset / "dataset.json", counts={"train": 5, "validation": 1, "test": 0})
    with SkippedWriter(dataset) as skipped:
        skipped.append("train", 4, "clip.webm is truncated")
        skipped.append("train", 0, "left out once, and made since")
    write_seal(dataset)
    report = verify(dataset)
    assert report.problems == ("train: 3 of 5 samples are finished and 1 skipped; run generate again to resume",)
    with SkippedWriter(dataset) as skipped:
        skipped.append("train", 3, "clip.webm is truncated")
    write_seal(dataset)
    report = verify(dataset)
    assert report.ok, report.problems
    assert (report.counts["train"], report.skipped, report.wanted["train"]) == (3, {"train": 2}, 5)
    assert str(report).startswith("train: 3 of 5 intact, 2 skipped (skipped.jsonl), validation: 1 of 1 intact, ")
    (dataset / "skipped.jsonl").write_text("{}\n")
    assert any("skipped.jsonl:1: " in line for line in verify(dataset).problems)
