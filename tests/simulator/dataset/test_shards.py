"""Shards: several processes make one data set in one folder, and whoever ends last seals it."""

import hashlib
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest

from simulator.dataset import beginning, generate, open_dataset, verify
from simulator.dataset.checksums import CHECKSUMS
from simulator.dataset.manifest import WRITERS, ManifestWriter, load_manifest
from simulator.dataset.sample import sample_id
from simulator.dataset.shards import Shard, alone, array_expression, shard_of, sharing
from simulator.dataset.status import status
from simulator.errors import InputError
from simulator.io import lines

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

DATASET = {"train": 12, "validation": 4, "test": 4}


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory, make_trial: Callable) -> Path:
    return make_trial(tmp_path_factory.mktemp("undisturbed")).generate(dataset=DATASET)


def test_every_sample_belongs_to_one_shard_and_shards_are_equal() -> None:
    names = [("train", sample_id(index)) for index in range(20_000)] + [("test", sample_id(3))]
    shards = [Shard(index, 7) for index in range(7)]
    assert {sum(shard.holds(*name) for shard in shards) for name in names} == {1}
    counts = Counter(shard_of(*name, 7) for name in names)
    expected = len(names) / 7
    assert max(abs(count - expected) for count in counts.values()) < 5 * np.sqrt(expected)  # as if drawn by lot
    # Neighbours do not go together: what a family takes in turn comes to every shard alike.
    assert Counter(shard_of("train", sample_id(10 * number), 10) for number in range(1000)).most_common(1)[0][1] < 150
    # Pinned: another hash would hand the samples of arrays that are under way to other tasks.
    assert [shard_of("train", sample_id(index), 10) for index in range(8)] == [
        int(hashlib.sha256(f"train/s{index:08d}".encode()).hexdigest()[:15], 16) % 10 for index in range(8)
    ]


@pytest.mark.parametrize("text", ["", "3", "3/3", "-1/4", "1/0", "a/b", "1/2/3", "1.0/2", "0/99999999999"])
def test_what_names_no_shard(text: str) -> None:
    with pytest.raises(InputError, match=r"^--shard: "):
        Shard.parsed(text)
    assert str(Shard.parsed("3/10")) == "3/10"


def test_numbers_as_slurm_takes_them() -> None:
    assert [array_expression(numbers) for numbers in ([], [4], [9, 3, 7, 8], [0, 1, 2])] == ["", "4", "3,7-9", "0-2"]


def test_the_last_shard_ends_the_data_set(trial) -> None:
    path, drawn = trial.write(dataset=DATASET), []
    results = [generate(path, shard=Shard(index, 5), finish=drawn.append) for index in range(5)]
    root = trial.folder / "out"
    assert sum(result.made for result in results) == 20
    assert [result.missing for result in results[:-1]] == sorted((r.missing for r in results[:-1]), reverse=True)
    assert results[-1].missing == 0
    assert drawn == [root]  # by the last
    assert not (root / WRITERS).exists()
    assert len((root / "manifest.jsonl").read_bytes().splitlines()) == 20
    again = [generate(path, shard=Shard(index, 3)) for index in range(3)]
    assert (sum(result.made for result in again), sum(result.kept for result in again)) == (0, 20)
    assert generate(path).kept == 20
    assert verify(root).ok


def test_the_number_of_shards_may_change_and_a_run_without_shards_finishes(trial, undisturbed: Path, decided) -> None:
    path = trial.write(dataset=DATASET)
    first = [generate(path, shard=Shard(index, 4)) for index in (1, 3)]
    root = trial.folder / "out"
    assert not (root / CHECKSUMS).exists()
    assert not verify(root).ok
    assert len(open_dataset(root)) == len(load_manifest(root).ids("train")) > 0  # readers see what is there
    second = generate(path, shard=Shard(0, 3))
    rest = generate(path)
    assert sum(result.made for result in [*first, second, rest]) == 20
    assert rest.made + rest.kept == 20
    assert decided(root) == decided(undisturbed)
    assert verify(root).ok


@pytest.mark.slow
@pytest.mark.parametrize("overlap", [False, True])
def test_shards_at_the_same_time(trial, undisturbed: Path, decided, overlap: bool) -> None:
    """In processes of their own, begun at once in an empty folder; with ``overlap`` the same shard three times."""
    path = trial.write(dataset=DATASET)
    shards = ["0/1"] * 3 if overlap else ["0/3", "1/3", "2/3"]
    command = [sys.executable, "-c", "from simulator.cli import main; main()", "generate", str(path), "--shard"]
    runs = [subprocess.Popen([*command, shard], stdout=subprocess.PIPE, stderr=subprocess.STDOUT) for shard in shards]
    output = [run.communicate(timeout=120)[0].decode() for run in runs]
    assert [run.returncode for run in runs] == [0, 0, 0], output
    root = trial.folder / "out"
    assert verify(root).ok
    (root / "contact_sheet.png").unlink()
    assert decided(root) == decided(undisturbed)
    assert not (root / WRITERS).exists()


def test_a_data_set_that_another_process_begins_meanwhile_is_no_foreign_folder(trial, monkeypatch) -> None:
    path, root, seen = trial.write(dataset=DATASET), trial.folder / "out", []

    def late(paths: Iterable[Path]) -> list[Path]:
        """List the folder only when another process has begun there."""
        if not seen:
            seen.append(root)
            generate(path, shard=Shard(0, 2))
            return sorted(root.iterdir())
        return sorted(paths)

    root.mkdir()
    monkeypatch.setattr(beginning, "sorted", late, raising=False)
    assert generate(path).kept > 0
    assert seen
    assert verify(root).ok


def test_a_shard_that_dies_leaves_what_it_finished_to_the_others(
    trial, undisturbed: Path, decided, monkeypatch
) -> None:
    path = trial.write(dataset=DATASET)
    append = ManifestWriter.append
    left = iter(range(3))

    def dying(self, *arguments) -> None:
        append(self, *arguments)
        if next(left, None) is None:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(ManifestWriter, "append", dying)
        with pytest.raises(KeyboardInterrupt):
            generate(path, shard=Shard(0, 2))
    root = trial.folder / "out"
    own = next((root / WRITERS).iterdir())
    with (own / "manifest.jsonl").open("ab") as file:
        file.write(b'{"id":"s0000')  # as a power cut leaves it
    assert status(root).finished["train"] == len(load_manifest(root).ids("train")) > 0
    results = [generate(path, shard=Shard(index, 2)) for index in (1, 0)]
    assert results[1].kept == 4
    assert decided(root) == decided(undisturbed)
    assert verify(root).ok


def test_who_is_alone_and_who_shares(tmp_path: Path) -> None:
    said: list[str] = []
    with sharing(tmp_path, None, said.append) as own:
        assert own is None  # there is no data set to be shared yet, and nothing is left that would speak of one
    assert [path.name for path in tmp_path.iterdir()] == ["manifest.jsonl"]
    (tmp_path / "dataset.json").touch()
    with alone(tmp_path) as writer:
        assert writer is not None
        assert writer.locked
        with alone(tmp_path) as other:
            assert other is None
        waiting = threading.Thread(target=lambda: sharing(tmp_path, None, said.append).__enter__(), daemon=True)
        waiting.start()
        waiting.join(0.3)
        assert waiting.is_alive()
        assert str(tmp_path) in said[0]
    waiting.join(10)
    assert not waiting.is_alive()
    with sharing(tmp_path, Shard(1, 2), said.append) as own, sharing(tmp_path, Shard(1, 2), said.append) as twin:
        assert own is not None
        assert twin is not None
        assert own.folder != twin.folder
        with alone(tmp_path) as writer:
            assert writer is None
        with pytest.raises(InputError, match="another process"):
            ManifestWriter(tmp_path)
    assert len(said) == 1


def test_nobody_writes_while_the_last_one_draws_and_seals(trial) -> None:
    path, tried = trial.write(dataset=DATASET), []

    def draw(root: Path) -> None:
        with pytest.raises(InputError, match="another process"):
            ManifestWriter(root)
        with alone(root) as other:
            tried.append(other)

    results = [generate(path, shard=Shard(index, 2), finish=draw) for index in range(2)]
    assert tried == [None]
    assert results[1].sealed


def test_a_shard_that_waits_prepares_where_the_one_before_was_stopped(trial, undisturbed: Path, decided) -> None:
    """That one takes away what it made, the folder, too, under the eyes of those that wait for its lock."""
    path, root = trial.write(dataset=DATASET), trial.folder / "out"
    said: list[str] = []
    root.mkdir()
    with ManifestWriter(root):
        waiting = threading.Thread(target=generate, args=(path,), kwargs={"shard": Shard(1, 2), "say": said.append})
        waiting.start()
        while not any("waiting" in line for line in said):
            waiting.join(0.05)
            assert waiting.is_alive()
        (root / "manifest.jsonl").unlink()
        root.rmdir()
    waiting.join(60)
    assert generate(path, shard=Shard(0, 2)).kept == 0
    assert decided(root) == decided(undisturbed)
    assert verify(root).ok


def test_a_lock_on_a_manifest_that_was_replaced_is_not_taken_for_one(tmp_path: Path, monkeypatch) -> None:
    path, take, taken = tmp_path / "manifest.jsonl", lines.take_lock, []

    def slow(descriptor: int, **options: bool) -> bool | None:
        if not taken:  # the one who held it replaces the file between our open and our lock
            (tmp_path / "new").touch()
            (tmp_path / "new").replace(path)
        taken.append(descriptor)
        return take(descriptor, **options)

    monkeypatch.setattr(lines, "take_lock", slow)
    with ManifestWriter(tmp_path):
        assert len(taken) == 2
        with pytest.raises(InputError, match="another process"):
            ManifestWriter(tmp_path)


@pytest.mark.parametrize("shards", [1, 3])
def test_a_file_system_without_locks(trial, undisturbed: Path, decided, monkeypatch, shards: int) -> None:
    monkeypatch.setattr(lines, "take_lock", lambda *_, **__: None)
    path = trial.write(dataset=DATASET)
    root = trial.folder / "out"
    for index in range(shards):
        result = generate(path, shard=Shard(index, shards))
        assert not result.sealed  # another shard may be at work: nothing is merged under its hands
        (root / "train/0000/.tmp-s00000099-12345678").mkdir(exist_ok=True)  # of such a one
    assert (result.missing, len(list((root / WRITERS).iterdir()))) == (0, shards)
    assert [str(file.relative_to(root)) for file in root.rglob(".tmp-*")] == ["train/0000/.tmp-s00000099-12345678"]
    (root / "train/0000/.tmp-s00000099-12345678").rmdir()
    assert generate(path).sealed
    assert decided(root) == decided(undisturbed)
    assert verify(root).ok


def test_a_sample_that_failed_and_was_left_out_since_counts_once(trial) -> None:
    """Or the data set would be sealed with as many samples missing."""
    code = trial.plugins.read_text().replace(
        'raise ZeroDivisionError(f"no clip {index} today")', 'raise InputError("film", "torn")'
    )
    (trial.folder / "torn.py").write_text(f"from simulator.errors import InputError\n{code}")
    scene = {"family": "./torn.py:boxes", "size": [16, 20], "fail_at": 1}
    path, root = trial.write(dataset=DATASET, scene=scene), trial.folder / "out"
    name = next(shard for shard in range(3) if any(Shard(shard, 3).holds(split, "s00000001") for split in DATASET))
    first = generate(path, shard=Shard(name, 3))
    again = generate(path, shard=Shard(name, 3), skip_bad=True)
    assert len(first.failed) == len(again.skipped) > 0
    there = len(load_manifest(root).entries) + len(again.skipped)
    assert again.missing == 20 - there
    assert not (root / CHECKSUMS).exists()
    rest = [generate(path, shard=Shard(index, 3), skip_bad=True) for index in range(3) if index != name]
    assert rest[-1].missing == 0
    assert not (root / "failed.jsonl").exists()
    assert verify(root).ok


def test_a_shard_of_other_counts_waits_for_the_end_of_the_rest(trial) -> None:
    path = trial.write(dataset=DATASET)
    generate(path, shard=Shard(0, 2))
    root = trial.folder / "out"
    with sharing(root, Shard(1, 2), print), pytest.raises(InputError, match=r"^dataset: "):
        generate(trial.write(dataset=DATASET | {"train": 13}), shard=Shard(0, 2))
    assert generate(path, shard=Shard(1, 2)).missing == 0
    assert verify(root).ok


def test_failed_samples_of_shards_are_told_together_and_tried_again(trial, tmp_path: Path) -> None:
    marker = tmp_path / "mended"
    scene = {"family": "./plugins.py:boxes", "size": [16, 20], "fail_at": 1, "marker": str(marker)}
    path = trial.write(dataset=DATASET, scene=scene)
    results = [generate(path, shard=Shard(index, 2)) for index in range(2)]
    root = trial.folder / "out"
    failed = sorted(line for result in results for line in result.failed)
    assert [line.partition(":")[0] for line in failed] == [
        f"{split}/s00000001" for split in ("test", "train", "validation")
    ]
    found = status(root, shards=2)
    assert sorted("/".join(key) for key in found.failed) == [line.partition(":")[0] for line in failed]
    assert found.left == 3
    assert found.sealed
    assert len(verify(root).problems) == 3  # a line per split: not all finished
    marker.touch()
    shard = int(found.shards.split(",")[0].split("-")[0])
    generate(path, shard=Shard(shard, 2))
    assert len(status(root).failed) < 3
    assert generate(path).failed == ()
    assert status(root).failed == {}
    assert verify(root).ok


def test_lists_that_are_merged_while_they_are_read_lose_nothing(trial, undisturbed: Path, decided, monkeypatch) -> None:
    path, read, merged = trial.write(dataset=DATASET), lines.read_lines, []
    generate(path, shard=Shard(0, 2))
    root = trial.folder / "out"

    def merging(file: Path):
        found = list(read(file))
        if file == root / "manifest.jsonl" and not merged:  # empty yet; by the next step the writers' lists are gone
            merged.append(True)
            merged[0] = generate(path, shard=Shard(1, 2)).missing
        yield from found

    monkeypatch.setattr("simulator.dataset.manifest.read_lines", merging)
    assert load_manifest(root).entries.keys() == load_manifest(undisturbed).entries.keys()
    assert merged == [0]
    assert not (root / WRITERS).exists()
