"""How far a data set is, told from its files while it is being made."""

import re
from pathlib import Path

import pytest

from simulator.dataset import generate
from simulator.dataset.manifest import load_manifest
from simulator.dataset.shards import Shard
from simulator.dataset.status import status
from simulator.errors import InputError

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

DATASET = {"train": 12, "validation": 4, "test": 4}


def test_what_is_missing_is_named_as_an_array(trial, flatlight) -> None:
    path, root = trial.write(dataset=DATASET), trial.folder / "out"
    for index in (0, 2, 3, 5, 9):
        generate(path, shard=Shard(index, 10))
    found = status(root, 10)
    manifest = load_manifest(root)
    assert found.finished == {split: len(manifest.ids(split)) for split in ("train", "validation", "test")}
    assert found.left == 20 - len(manifest.entries) == sum(found.missing)
    left = [index for index, count in enumerate(found.missing) if count]
    assert set(left) <= {1, 4, 6, 7, 8}
    assert not found.sealed
    assert found.writers == 5
    assert found.seconds == pytest.approx(sum(e.seconds for e in manifest.entries.values()) / len(manifest.entries))
    code, out, _ = flatlight("status", root, "--shards", 10)
    assert code == 0
    assert f"--array={found.shards}" in out
    assert f"train: {found.finished['train']} of 12 finished" in out
    for index in left:
        generate(path, shard=Shard(index, 10))
    done = status(root, 10)
    assert (done.left, done.writers, done.sealed, done.shards) == (0, 0, True, "")
    assert "complete and sealed" in flatlight("status", root)[1]


def test_failures_are_shown_with_their_cause(trial, flatlight) -> None:
    scene = {"family": "./plugins.py:boxes", "size": [16, 20], "fail_at": 1}
    assert generate(trial.write(scene=scene)).failed != ()
    code, out, _ = flatlight("status", trial.folder / "out")
    assert code == 0
    assert re.search(r"train/s00000001: .*ZeroDivisionError: no clip 1 today", out)
    assert "\nleft: 1, about " in out


def test_what_is_no_data_set(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=str(tmp_path)):
        status(tmp_path)


def test_no_shards(dataset: Path) -> None:
    with pytest.raises(InputError, match=r"^--shards: "):
        status(dataset, 0)
