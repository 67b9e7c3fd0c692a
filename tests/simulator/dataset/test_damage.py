"""verify misses no damage of any file of a data set, and raises no alarm over a fresh one of any kind."""

import json
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from simulator.commands.datasets import _draw
from simulator.dataset import generate, verify
from simulator.dataset.card import write_card
from simulator.dataset.checksums import CARD, CHECKSUMS, OUR_CARD, write_seal
from simulator.dataset.croissant import write_croissant
from simulator.dataset.manifest import FailedWriter, SkippedWriter
from simulator.dataset.merging import merge
from simulator.dataset.shards import Shard
from simulator.dataset.verification import check_seal

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

KINDS = 18
"""Of files: three lists and the problems, dataset.json, the seal, card, croissant.json, report and contact sheet, psf.json
and planes of two stacks, sample.json, measurement, truth and global measurement."""


def write_whole(samples: ModuleType, root: Path) -> Path:
    """A data set with a file of every kind."""
    samples.make_dataset(root, lambda index: samples.make_clip_sample(index, frames=2))
    with SkippedWriter(root) as skipped, FailedWriter(root) as failed:
        skipped.append("train", 3, "clip.webm is truncated")
        failed.append("train", 4, "SystemExit: 0", 3, "Traceback")
    shutil.copytree(root / "psf", root / "psf_captured")
    (root / "source_problems.txt").write_text("3.webm: has no frames")
    info = json.loads((root / "dataset.json").read_text())
    (root / "dataset.json").write_text(json.dumps(info | {"counts": {"train": 4, "validation": 1}}))
    write_card(root)
    write_croissant(root)
    _draw(root)
    write_seal(root)
    return root


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A data set with a file of every kind; not to be changed."""
    from importlib.util import module_from_spec, spec_from_file_location

    spec = spec_from_file_location("samples", Path(__file__).parents[1] / "samples.py")
    assert spec is not None
    assert spec.loader is not None
    samples = module_from_spec(spec)
    spec.loader.exec_module(samples)
    return write_whole(samples, tmp_path_factory.mktemp("made") / "set")


@pytest.fixture
def whole(made: Path, tmp_path: Path) -> Path:
    return shutil.copytree(made, tmp_path / "set")


def kinds(root: Path) -> dict[str, Path]:
    """One file of each kind."""
    files = sorted(path for path in root.rglob("*") if path.is_file())
    found = {re.sub(r"\d+", "N", f"{path.parent.name}/{path.name}"): path for path in files}
    assert len(found) == KINDS
    return found


def passes(path: Path, data: bytes, root: Path) -> bool:
    """Whether a data set passes with another content of a file, which is put back."""
    before = path.read_bytes()
    assert data != before
    path.write_bytes(data)
    ok = verify(root).ok
    path.write_bytes(before)
    return ok


def with_flipped(data: bytes, bit: int) -> bytes:
    flipped = bytearray(data)
    flipped[bit // 8] ^= 1 << bit % 8
    return bytes(flipped)


@pytest.mark.slow
def test_no_flipped_bit_passes(whole: Path) -> None:
    """300 of them, one at a time, in every kind of file alike: the smallest files get as many as the largest."""
    assert verify(whole).ok, verify(whole)
    rng, files, missed = np.random.default_rng(5), list(kinds(whole).values()), []
    for number in range(300):
        path = files[number % KINDS]
        data = path.read_bytes()
        bit = int(rng.integers(8 * len(data)))
        if passes(path, with_flipped(data, bit), whole):
            missed.append((path, bit))
    assert missed == []
    assert verify(whole).ok


def test_no_flipped_bit_makes_our_card_another_s(whole: Path) -> None:
    """Every bit of its last line, by which it is known for ours, and of its first."""
    path = whole / CARD
    data = path.read_bytes()
    end = len(data) - len(OUR_CARD) - 2
    for bit in [*range(8 * end, 8 * len(data)), *range(8 * 20)]:
        path.write_bytes(with_flipped(data, bit))
        (fault,) = check_seal(whole)[1]
        assert fault.path == str(path)
    path.write_bytes(data)
    assert verify(whole).ok


def test_no_truncation_passes(whole: Path) -> None:
    """At 54 offsets: to nothing, by one byte, and anywhere between, of each kind of file."""
    rng, missed = np.random.default_rng(6), []
    for path in kinds(whole).values():
        data = path.read_bytes()
        missed += [
            (path, length)
            for length in (0, int(rng.integers(1, len(data) - 1)), len(data) - 1)
            if passes(path, data[:length], whole)
        ]
    assert missed == []


def exchanged(root: Path, one: str, other: str) -> None:
    (root / one).rename(root / "aside")
    (root / other).rename(root / one)
    (root / "aside").rename(root / other)


FIRST, SECOND = "train/0000/s00000000", "train/0000/s00000001"
PAIRS = [
    (FIRST, SECOND),
    (FIRST, "validation/0000/s00000000"),
    *((f"{FIRST}/{name}", f"{SECOND}/{name}") for name in ("sample.json", "measurement.exr", "frames")),
    *(
        (f"{FIRST}/frames/{name}.0000.exr", f"{folder}/frames/{name}.000{number}.exr")
        for name in ("ground_truth", "global")
        for folder, number in ((FIRST, 1), (SECOND, 0))
    ),
    (f"{FIRST}/measurement.exr", f"{FIRST}/frames/global.0000.exr"),
    ("psf/depth_0000.exr", "psf/depth_0001.exr"),
]


@pytest.mark.parametrize("sealed_anew", [False, True])
@pytest.mark.parametrize("pair", PAIRS, ids=" ".join)
def test_nothing_takes_another_s_place(whole: Path, pair: tuple[str, str], sealed_anew: bool) -> None:
    """Files and samples that are whole in themselves; nor does a seal over them hide it."""
    exchanged(whole, *pair)
    if sealed_anew:
        write_seal(whole)
    assert not verify(whole).ok


@pytest.mark.parametrize(("one", "other"), [("report.html", CARD), ("croissant.json", "dataset.json"), ("psf", FIRST)])
def test_files_of_other_kinds_change_places(whole: Path, one: str, other: str) -> None:
    exchanged(whole, one, other)
    assert not verify(whole).ok


def test_each_kind_of_file_is_missed(whole: Path) -> None:
    for path in kinds(whole).values():
        path.rename(whole.parent / "aside")
        assert not verify(whole).ok, path
        (whole.parent / "aside").rename(path)
    assert verify(whole).ok


EDITS: dict[str, Any] = {
    "id": "s00000007",
    "split": "test",
    "digest": "0" * 64,
    "seed": 8,
    "label": "class 7",
    "seconds": 0.2,
    "more": 1,
}


@pytest.mark.parametrize("sealed_anew", [False, True])
@pytest.mark.parametrize("field", EDITS)
def test_every_field_of_a_manifest_line_counts(whole: Path, field: str, sealed_anew: bool) -> None:
    """Seconds decide nothing, so only the seal can tell."""
    manifest = whole / "manifest.jsonl"
    first, *lines = manifest.read_text().splitlines()
    content = json.loads(first)
    assert (field in content) == (field != "more")
    manifest.write_text("\n".join([json.dumps(content | {field: EDITS[field]}), *lines]) + "\n")
    if sealed_anew:
        write_seal(whole)
    assert verify(whole).ok == (sealed_anew and field == "seconds")


LINES: dict[str, Callable[[list[str]], list[str]]] = {
    "exchanged ids": lambda lines: [
        line.replace("s00000000", "x").replace("s00000001", "s00000000").replace('"x"', '"s00000001"') for line in lines
    ],
    "an id that nobody has": lambda lines: [*lines, lines[0].replace('"s0000', '"s0001')],
    "a line twice": lambda lines: [*lines, lines[0]],
    "a line twice, other in one": lambda lines: [lines[0].replace('"seed":7', '"seed":8'), *lines],
    "a line less": lambda lines: lines[1:],
    "half a line": lambda lines: [*lines[1:], lines[0][:40]],
}


@pytest.mark.parametrize("edit", LINES)
def test_lines_of_the_manifest(whole: Path, edit: str) -> None:
    """Found also where the seal was made anew."""
    manifest = whole / "manifest.jsonl"
    before = manifest.read_text()
    manifest.write_text("\n".join(LINES[edit](before.splitlines())) + ("\n" if edit != "half a line" else ""))
    assert manifest.read_text() != before
    write_seal(whole)
    assert not verify(whole).ok


DATASET = {"train": 4, "validation": 1, "test": 1}


def stills(trial: Any) -> Path:
    return generate(trial.write(dataset=DATASET), finish=_draw).path


def clips(trial: Any) -> Path:
    shutil.copy(Path(__file__).with_name("clip_source.py"), trial.folder)
    scene = {"source": "./clip_source.py:squares", "size": [16, 20], "problems": ["a.webm: empty"], "bad": [1]}
    camera = {"shutter": {"type": "rolling", "exposure_ms": 2, "line_time_us": 25}}
    dataset = DATASET | {"slivers": 4, "global_measurements": True}
    result = generate(trial.write(camera=camera, scene=scene, dataset=dataset), skip_bad=True, finish=_draw)
    assert result.skipped
    return result.path


def captured(trial: Any) -> Path:
    psf = {"depths_cm": [3.6, 20], "wavelengths_per_channel": 1, "accept_error": 1, "as_captured": {}}
    return generate(trial.write(psf=psf, dataset=DATASET), finish=_draw).path


def killed_workers(trial: Any) -> Path:
    scene = {"family": "./plugins.py:boxes", "size": [16, 20], "kill_at": 1, "marker": str(trial.folder / "killed")}
    return generate(trial.write(scene=scene, dataset=DATASET | {"engine": "local", "workers": 2}), finish=_draw).path


def shards(trial: Any) -> Path:
    path = trial.write(dataset=DATASET)
    return [generate(path, shard=Shard(index, 3), finish=_draw) for index in range(3)][-1].path


def merged(trial: Any) -> Path:
    path = trial.write(dataset=DATASET)
    parts = [trial.folder / name for name in ("one", "other")]
    for index, part in enumerate(parts):
        generate(path, [f"dataset.output={part}"], shard=Shard(index, 2))
    return Path(merge(trial.folder / "merged", parts, finish=_draw).path)


def grown(trial: Any) -> Path:
    trial.generate()
    return stills(trial)


def repaired(trial: Any) -> Path:
    damaged = stills(trial) / FIRST / "measurement.exr"
    damaged.write_bytes(b"")
    return generate(trial.path, repair=True, finish=_draw).path


FRESH = (stills, clips, captured, killed_workers, shards, merged, grown, repaired)


@pytest.mark.slow
@pytest.mark.parametrize("make", FRESH)
def test_no_alarm_over_a_fresh_data_set(trial, flatlight: Callable, make: Callable[[Any], Path]) -> None:
    root = make(trial)
    report = verify(root)
    assert (report.problems, report.notes) == ((), ())
    assert report.ok
    assert (root / CHECKSUMS).exists()
    for command in (("report", root), ("status", root)):  # nor after what only looks at it
        assert flatlight(*command)[0] == 0
    assert verify(root).ok


@pytest.mark.slow
def test_of_failed_samples_only_that_they_are_missing_is_told(trial) -> None:
    scene = {"family": "./plugins.py:boxes", "size": [16, 20], "fail_at": 2, "marker": str(trial.folder / "mended")}
    result = generate(trial.write(scene=scene, dataset=DATASET), finish=_draw)
    assert len(result.failed) == 1
    (problem,) = verify(result.path).problems
    assert problem.startswith("train: 3 of 4 samples are finished; ")
