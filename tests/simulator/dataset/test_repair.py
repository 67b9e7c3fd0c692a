"""``generate --repair`` makes exactly what is damaged anew, and the bytes are those that were there."""

import errno
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from simulator.dataset import generate, verify
from simulator.dataset.manifest import ManifestWriter, load_manifest
from simulator.dataset.repair import take_out_bad
from simulator.dataset.shards import Shard
from simulator.errors import InputError
from simulator.io import files

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

DATASET = {"train": 5, "validation": 2, "test": 2}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, make_trial: Callable):
    """A trial and its data set; not to be changed."""
    trial = make_trial(tmp_path_factory.mktemp("made"))
    return trial, trial.generate(dataset=DATASET)


@pytest.fixture
def copy(made, tmp_path: Path) -> Path:
    shutil.copytree(made[1], tmp_path / "copy")
    return tmp_path / "copy"


def repaired(trial, root: Path) -> tuple[int, list[str]]:
    said: list[str] = []
    result = generate(trial.path, [f"dataset.output={root}"], repair=True, say=said.append)
    return result.made, [line for line in said if line.startswith("repair: ")]


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 4
    path.write_bytes(data)


def swap(first: Path, second: Path) -> None:
    one, two = first.read_bytes(), second.read_bytes()
    first.write_bytes(two)
    second.write_bytes(one)


def test_damage_that_a_run_without_it_meets_is_told_with_this_cure(made, copy: Path) -> None:
    trial, _ = made
    (copy / SAMPLE.format(0) / "sample.json").write_text("{")
    (copy / "checksums.json").unlink()  # as of a run that did not come to its end
    with pytest.raises(InputError, match=r"sample\.json.*flatlight generate --repair makes what is damaged anew$"):
        generate(trial.path, [f"dataset.output={copy}"])
    assert not (copy / "checksums.json").exists()
    assert repaired(trial, copy) == (1, ["repair: train/s00000000 is damaged and is made anew"])
    assert verify(copy).ok


SAMPLE = "train/0000/s0000000{}"
DAMAGES: dict[str, tuple[Callable[[Path], object], int]] = {  # and how many samples it costs
    "a flipped bit": (lambda root: flip(root / SAMPLE.format(1) / "measurement.exr"), 1),
    "a flipped bit in the description": (lambda root: flip(root / SAMPLE.format(1) / "sample.json"), 1),
    "a truncated file": (lambda root: (root / SAMPLE.format(2) / "ground_truth.exr").write_bytes(b""), 1),
    "swapped files": (lambda root: swap(*(root / SAMPLE.format(n) / "measurement.exr" for n in (0, 3))), 2),
    "swapped samples": (lambda root: _swap_folders(root / SAMPLE.format(0), root / SAMPLE.format(1)), 2),
    "a missing file": (lambda root: (root / SAMPLE.format(4) / "measurement.exr").unlink(), 1),
    "a missing folder": (lambda root: shutil.rmtree(root / SAMPLE.format(4)), 1),
    "an edited line": (lambda root: _edit(root, '"seed":11', '"seed":12'), 1),
    "a line of nonsense": (lambda root: _edit(root, '"id"', '"number"'), 1),
    "a damaged stack": (lambda root: flip(root / "psf/depth_0001.exr"), 0),
    "a stack that is gone": (lambda root: shutil.rmtree(root / "psf"), 0),
    "a damaged stack without a seal": (
        lambda root: (flip(root / "psf/depth_0001.exr"), (root / "checksums.json").unlink()),
        0,
    ),
}


def _swap_folders(first: Path, second: Path) -> None:
    first.rename(first.with_name("x"))
    second.rename(first)
    first.with_name("x").rename(second)


def _edit(root: Path, old: str, new: str) -> None:
    manifest = root / "manifest.jsonl"
    manifest.write_text(manifest.read_text().replace(old, new, 1))


@pytest.mark.parametrize("damage", DAMAGES)
def test_exactly_what_is_damaged_is_made_anew(made, copy: Path, decided, damage: str) -> None:
    harm, count = DAMAGES[damage]
    stamps = {path: path.stat().st_mtime_ns for path in copy.rglob("*.exr")}
    harm(copy)
    assert not verify(copy).ok
    again, said = repaired(made[0], copy)
    assert again == count
    assert len(said) == (count or 1)
    assert verify(copy).ok
    assert decided(copy) == decided(made[1])
    kept = sum(path.stat().st_mtime_ns == stamp for path, stamp in stamps.items() if "psf" not in path.parts)
    assert kept >= 2 * (9 - count)  # not even written again
    assert load_manifest(copy).entries.keys() == load_manifest(made[1]).entries.keys()


def test_nobody_writes_while_it_is_checked(made, copy: Path) -> None:
    """Not even after the lists were put in order: whoever wrote then would lose it."""
    (copy / "manifest.jsonl").write_bytes((copy / "manifest.jsonl").read_bytes() * 2)
    refused = []

    def other(done: int, total: int) -> None:
        with pytest.raises(InputError, match="another process"):
            ManifestWriter(copy)
        refused.append(done)

    take_out_bad(copy, progress=other)
    assert refused
    ManifestWriter(copy).close()
    assert len(load_manifest(copy).entries) == 9


def test_nothing_is_removed_where_the_disk_or_the_network_fails(made, copy: Path, decided, monkeypatch) -> None:
    """A stale file handle says nothing of a sample; a million of them would be made anew."""
    before, read = decided(copy), files.size_of

    def failing(path: Path) -> int:
        if path.name == "measurement.exr" and path.parent.name in ("s00000001", "s00000003"):
            raise OSError(errno.ESTALE, os.strerror(errno.ESTALE))
        return read(path)

    with monkeypatch.context() as patch:
        patch.setattr(files, "size_of", failing)
        assert not verify(copy).ok
        with pytest.raises(InputError, match=r"4 samples cannot be read, first .*s00000001"):
            repaired(made[0], copy)
    assert decided(copy) == before
    assert verify(copy).ok


def test_what_a_user_laid_beside_a_sample_stays(made, copy: Path) -> None:
    note = copy / SAMPLE.format(3) / "notes.txt"
    note.write_text("mine")
    assert repaired(made[0], copy) == (0, ["repair: no sample and no stack is damaged"])
    assert note.read_text() == "mine"
    flip(copy / SAMPLE.format(3) / "measurement.exr")
    with pytest.raises(InputError, match=r"train/s00000003 is damaged.*other files"):
        repaired(made[0], copy)
    assert note.read_text() == "mine"
    note.unlink()
    assert repaired(made[0], copy)[0] == 1
    assert verify(copy).ok


def test_links_are_named(made, copy: Path, tmp_path: Path) -> None:
    file = copy / SAMPLE.format(1) / "measurement.exr"
    file.rename(tmp_path / "elsewhere.exr")
    file.symlink_to(tmp_path / "elsewhere.exr")
    with pytest.raises(InputError, match="a link"):
        repaired(made[0], copy)
    assert file.is_symlink()


def test_nothing_is_done_where_nothing_is_damaged(made, copy: Path, flatlight) -> None:
    assert repaired(made[0], copy) == (0, ["repair: no sample and no stack is damaged"])
    assert verify(copy).ok
    flip(copy / SAMPLE.format(1) / "measurement.exr")
    code, out, err = flatlight("generate", made[0].path, "--set", f"dataset.output={copy}", "--repair")
    assert code == 0
    assert "train/s00000001 is damaged and is made anew" in err
    assert "1 samples made" in out


def test_what_repair_cannot_help(made, copy: Path, tmp_path: Path, decided) -> None:
    trial = made[0]
    with pytest.raises(InputError, match=r"^--repair: "):
        generate(trial.path, [f"dataset.output={tmp_path / 'new'}"], repair=True)
    with pytest.raises(InputError, match=r"^--repair: "):
        generate(trial.path, [f"dataset.output={copy}"], repair=True, shard=Shard(0, 2))
    before = decided(copy)
    text = (copy / "dataset.json").read_text()
    (copy / "dataset.json").write_text(text.replace('"name": "trial"', '"name": "trail"'))
    with pytest.raises(InputError, match=r"dataset\.json: "):
        generate(trial.path, [f"dataset.output={copy}"], repair=True)
    assert decided(copy) == before
