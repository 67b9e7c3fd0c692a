"""Parts of a data set that were made apart come together: every byte checked, nothing taken twice, the parts unchanged."""

import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from simulator.dataset import generate, verify
from simulator.dataset.fingerprint import cpu_level
from simulator.dataset.manifest import ManifestWriter, SkippedWriter, load_manifest, rewrite_manifest
from simulator.dataset.merging import merge
from simulator.dataset.sample import sample_index
from simulator.dataset.shards import Shard, sharing
from simulator.errors import InputError

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

DATASET = {"train": 6, "validation": 2, "test": 2}


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory, make_trial: Callable) -> list[Path]:
    """Two shards, each in a folder of its own, and both in one; not to be changed."""
    trial = make_trial(tmp_path_factory.mktemp("parts"))
    path = trial.write(dataset=DATASET)
    roots = [trial.folder / name for name in ("first", "second", "whole")]
    for index, root in enumerate(roots[:2]):
        generate(path, [f"dataset.output={root}"], shard=Shard(index, 2))
    generate(path, [f"dataset.output={roots[2]}"])
    return roots


def test_parts_make_the_data_set_that_one_run_makes(parts: list[Path], tmp_path: Path, decided) -> None:
    *apart, whole = parts
    before = [decided(root) for root in apart]
    seen: list[tuple[int, int]] = []
    result = merge(tmp_path / "new", apart, progress=lambda *update: seen.append(update))
    assert (result.taken, result.there, result.problems, result.missing) == (10, 0, (), 0)
    assert decided(tmp_path / "new") == decided(whole)
    assert verify(tmp_path / "new").ok
    assert [decided(root) for root in apart] == before
    assert seen[-1] == (10, 10)
    again = merge(tmp_path / "new", apart)
    assert (again.taken, again.there) == (0, 10)
    assert verify(tmp_path / "new").ok


def test_samples_of_a_part_from_another_processor_keep_its_name(parts: list[Path], tmp_path: Path) -> None:
    root = tmp_path / "elsewhere"
    shutil.copytree(parts[1], root)
    info = (root / "dataset.json").read_text()
    (root / "dataset.json").write_text(info.replace(f'"cpu": "{cpu_level()}"', '"cpu": "riscv64 V"'))
    merge(tmp_path / "new", [parts[0], root])
    made_on = {key: entry.cpu for key, entry in load_manifest(tmp_path / "new").entries.items()}
    own = load_manifest(parts[0]).entries
    assert made_on == {key: None if key in own else "riscv64 V" for key in made_on}
    assert len(made_on) == 10
    merge(tmp_path / "again", [root, tmp_path / "new"])
    made_on = {key: entry.cpu for key, entry in load_manifest(tmp_path / "again").entries.items()}
    assert made_on == {key: cpu_level() if key in own else None for key in made_on}


def test_into_one_of_the_parts_and_after_an_interruption(
    parts: list[Path], tmp_path: Path, decided, monkeypatch
) -> None:
    root = tmp_path / "first"
    shutil.copytree(parts[0], root)
    count = len(load_manifest(root).entries)
    with monkeypatch.context() as patch:
        patch.setattr("simulator.dataset.completion.merge_lists", lambda _: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            merge(root, [parts[1]])
    (root / "train/0000/.tmp-s00000003-12345678").mkdir()  # of a copy in the middle of which it was killed
    result = merge(root, [parts[1]])
    assert (result.taken, result.there, result.missing) == (0, 10, 0)
    assert count < 10
    assert decided(root) == decided(parts[2])
    assert verify(root).ok


def test_what_is_damaged_or_differs_is_named_and_not_taken(parts: list[Path], tmp_path: Path, flatlight) -> None:
    damaged = tmp_path / "damaged"
    shutil.copytree(parts[1], damaged)
    split, name = next(iter(load_manifest(damaged).entries))
    file = damaged / split / "0000" / name / "measurement.exr"
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(data)
    code, out, err = flatlight("merge", tmp_path / "new", parts[0], damaged)
    assert code == 1
    assert f"{split}/{name}" in err
    assert "9 samples taken" in out
    assert "1 missing" in out
    assert len(verify(tmp_path / "new").problems) == 1  # one sample short
    line = (parts[2] / "manifest.jsonl").read_text().splitlines()[0]
    other = tmp_path / "other"
    shutil.copytree(parts[2], other)
    text = (other / "manifest.jsonl").read_text()
    digest = line.partition('"digest":"')[2][:64]
    (other / "manifest.jsonl").write_text(text.replace(digest, "0" * 64))
    (problem,) = merge(tmp_path / "new", [parts[0], other]).problems
    assert "s0000000" in problem
    assert str(other) in problem


@pytest.mark.parametrize("own", ["report.html", "psf/calibration.tif", "croissant.json"])
def test_a_folder_of_something_else_stays_as_it_is(parts: list[Path], tmp_path: Path, tree, own: str) -> None:
    file = tmp_path / "mine" / own
    file.parent.mkdir(parents=True)
    file.write_text("years of work")
    before = tree(tmp_path)
    with pytest.raises(InputError, match=r"^output: .*holds other files"):
        merge(tmp_path / "mine", parts[:2])
    assert tree(tmp_path) == before


def test_what_cannot_come_together(parts: list[Path], tmp_path: Path, make_trial: Callable) -> None:
    trial = make_trial(tmp_path)
    stranger = trial.generate(dataset=DATASET, camera={"noise": {"type": "gaussian", "psnr_db": 30}})
    with pytest.raises(InputError, match=rf"(?s)^{stranger}: .*psnr_db: 40.0 -> 30.0"):
        merge(tmp_path / "new", [parts[0], stranger])
    assert not (tmp_path / "new").exists()
    with pytest.raises(InputError, match=r"^parts: "):
        merge(tmp_path / "new", [])
    with pytest.raises(InputError, match=str(tmp_path / "none")):
        merge(tmp_path / "new", [tmp_path / "none"])
    root = tmp_path / "first"
    shutil.copytree(parts[0], root)
    with sharing(root, None, print), pytest.raises(InputError, match="another process"):
        merge(root, [parts[1]])


def test_what_one_part_left_out_and_another_made_counts_once(parts: list[Path], tmp_path: Path) -> None:
    copies, entries = [tmp_path / name for name in ("a", "b")], list(load_manifest(parts[2]).entries)
    for copy, own in zip(copies, (entries[:5], entries[5:-1]), strict=True):  # the last one has nobody
        shutil.copytree(parts[2], copy)
        with ManifestWriter(copy) as manifest:
            rewrite_manifest(manifest, without=set(entries) - set(own))
    with SkippedWriter(copies[0]) as skipped:
        skipped.append(entries[5][0], sample_index(entries[5][1]), "torn")
    result = merge(tmp_path / "new", copies)
    assert (result.taken, result.missing) == (9, 1)
    assert not verify(tmp_path / "new").ok
