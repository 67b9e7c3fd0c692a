"""Data sets in an object store: the bytes of a folder, whoever made them and in however many pieces."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest

from simulator.dataset import generate, open_dataset, verify
from simulator.dataset.manifest import WRITERS, ManifestWriter, load_manifest
from simulator.dataset.merging import merge
from simulator.dataset.recipe import SampleMaker
from simulator.dataset.shards import Shard
from simulator.dataset.status import status
from simulator.errors import InputError
from simulator.io import store
from simulator.io.files import StorageError
from simulator.io.store import StorePath, place
from simulator.plots.contact_sheet import contact_sheet

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

DATASET = {"train": 6, "validation": 2, "test": 2}
NUMBERS = count()


@pytest.fixture
def root(bucket: str) -> Iterator[StorePath]:
    """A place that is empty yet."""
    store._client.cache_clear()  # a client keeps the environment of its making
    yield StorePath(f"{bucket}/sets/{next(NUMBERS)}")
    store._client.cache_clear()


@pytest.fixture(scope="module")
def local(tmp_path_factory: pytest.TempPathFactory, make_trial: Callable) -> Path:
    """The same data set in a folder."""
    return make_trial(tmp_path_factory.mktemp("local")).generate(dataset=DATASET)


def written(trial, root: StorePath, **changes: object) -> Path:
    path = trial.write(dataset=DATASET | changes)
    path.write_text(path.read_text().replace(str(trial.folder / "out"), str(root)))
    return path


@pytest.mark.slow
def test_a_data_set_in_a_store(trial, root: StorePath, local: Path, decided) -> None:
    path = written(trial, root)
    result = generate(path)
    assert (result.path, result.made, result.failed, result.missing) == (root, 10, (), 0)
    assert decided(root) == decided(local)
    assert not (root / WRITERS).exists()
    assert verify(root).ok
    assert status(root).sealed
    assert generate(path).kept == 10
    (there, here) = (open_dataset(place_, "train")[3] for place_ in (str(root), local))
    np.testing.assert_array_equal(there.measurement, here.measurement)
    assert not (trial.folder / "out").exists()
    assert not Path("s3:").exists()


@pytest.mark.slow
def test_shards_and_what_a_dying_one_leaves(trial, root: StorePath, local: Path, decided, monkeypatch) -> None:
    path = written(trial, root)
    append, left = ManifestWriter.append, iter(range(1))

    def dying(self, *arguments) -> None:
        if next(left, None) is None:
            raise KeyboardInterrupt  # the sample is in the store, but nobody was told
        append(self, *arguments)

    with monkeypatch.context() as patch:
        patch.setattr(ManifestWriter, "append", dying)
        with pytest.raises(KeyboardInterrupt):
            generate(path, shard=Shard(0, 2))
    assert len(load_manifest(root).entries) == 1
    assert status(root).writers == 1
    assert not verify(root).ok
    results = [generate(path, shard=Shard(index, 3)) for index in range(3)]
    assert (results[-1].missing, results[-1].sealed) == (0, False)  # nothing tells a shard that it is the last
    end = generate(path)
    assert (end.made, end.kept, end.sealed) == (0, 10, True)
    assert decided(root) == decided(local)
    assert not (root / WRITERS).exists()
    assert verify(root).ok


@pytest.mark.slow
def test_every_failed_and_skipped_sample_is_listed(trial, root: StorePath) -> None:
    scene = {"family": "./bad.py:bad", "size": [16, 20]}
    (trial.folder / "bad.py").write_text(
        f"{trial.plugins.read_text()}\nfrom simulator.errors import InputError\n\nclass Bad(Boxes):\n"
        "    def clip(self, index, rng):\n"
        "        if index % 2:\n"
        "            raise InputError('film', f'{index} is torn')\n"
        "        return super().clip(index, rng)\n\n"
        "def bad(view):\n    return Bad(view, 4, None, None, None, None, 0.0)\n"
    )
    path = trial.write(dataset=DATASET, scene=scene)
    path.write_text(path.read_text().replace(str(trial.folder / "out"), str(root)))
    result = generate(path)
    assert len(result.failed) == 5
    assert len(status(root).failed) == 5
    assert result.sealed
    skipping = generate(path, skip_bad=True)
    assert (len(skipping.skipped), skipping.failed) == (5, ())
    found = status(root)
    assert (sum(found.skipped.values()), found.failed, found.left) == (5, {}, 0)
    assert verify(root).ok


@pytest.mark.slow
def test_a_finished_sample_stays_whoever_comes_after(trial, root: StorePath, monkeypatch) -> None:
    """Another kind of processor makes other bytes; what a writer finished before it died is taken as it is."""
    path = written(trial, root)
    generate(path)
    folder = root / "train/0000/s00000002"
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    text = (root / "manifest.jsonl").read_bytes().splitlines(keepends=True)
    (root / "manifest.jsonl").write_bytes(b"".join(line for line in text if b'"id":"s00000002"' not in line))
    (root / "checksums.json").unlink()
    draw = SampleMaker.sample

    def otherwise(self: SampleMaker, split: str, index: int):
        made = draw(self, split, index)
        return replace(made, noiseless=np.nextafter(made.noiseless, np.float32(1)))

    monkeypatch.setattr(SampleMaker, "sample", otherwise)
    assert generate(path).made == 1
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before
    assert verify(root).ok
    monkeypatch.setattr(SampleMaker, "stored", lambda *_: None)  # two at the same time: neither sees the other's
    (root / "manifest.jsonl").write_bytes(b"".join(line for line in text if b'"id":"s00000002"' not in line))
    (root / "checksums.json").unlink()
    with pytest.raises(StorageError, match="another writer"):
        generate(path, skip_bad=True)
    assert {file.name: file.read_bytes() for file in folder.iterdir()} == before


def test_a_store_that_cannot_be_asked_is_one_line(root: StorePath, monkeypatch, flatlight) -> None:
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    monkeypatch.delenv("AWS_ALLOW_HTTP")
    store._client.cache_clear()
    code, _, err = flatlight("status", root)
    assert code == 2
    assert "cannot be asked" in err
    assert len(err.splitlines()) == 1


def test_a_changed_configuration_is_refused_with_a_diff(trial, root: StorePath) -> None:
    path = written(trial, root)
    generate(path)
    with pytest.raises(InputError, match=r"(?s)^dataset\.output: .*psnr_db"):
        generate(path, ["camera.noise.psnr_db=30"])
    with pytest.raises(InputError, match=r"^dataset\.train: got 2"):
        generate(path, ["dataset.train=2"])
    assert verify(root).ok


@pytest.mark.slow
def test_faults_are_found_there(trial, root: StorePath) -> None:
    generate(written(trial, root))
    file = root / "train/0000/s00000002/measurement.exr"
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 1
    file.write_bytes(bytes(data))
    (root / "test/0000/s00000000/sample.json").unlink()
    (root / "train/0000/notes.txt").write_bytes(b"mine")
    (root / "psf/depth_0001.exr").write_bytes(b"")
    problems = "\n".join(verify(root).problems)
    for word in ("train/s00000002: measurement.exr", "test/s00000000", "notes.txt: a stray file", "psf/depth_0001.exr"):
        assert word in problems


@pytest.mark.slow
def test_from_a_store_to_a_folder_and_drawn_there(trial, root: StorePath, local: Path, decided, tmp_path: Path) -> None:
    generate(written(trial, root), finish=lambda path: contact_sheet(path, path / "contact_sheet.png"))
    assert (root / "contact_sheet.png").read_bytes().startswith(b"\x89PNG")
    assert verify(root).ok
    copy = tmp_path / "copy"
    assert merge(copy, [root]).taken == 10
    assert decided(copy) == decided(local)
    assert verify(copy).ok


@pytest.mark.slow
def test_a_store_without_conditional_writes_makes_no_data_set(trial, root: StorePath, monkeypatch) -> None:
    monkeypatch.setattr(StorePath, "create", lambda self, data: self.write_bytes(data) is None)
    with pytest.raises(InputError, match="If-None-Match"):
        generate(written(trial, root))
    assert not root.exists()


@pytest.mark.parametrize("text", ["s3://bucket", "s3://bucket/a/../../b", "ftp://host/a"])
def test_an_output_that_is_no_address(trial, text: str) -> None:
    path = trial.write()
    with pytest.raises(InputError, match=r"output"):
        generate(path, [f"dataset.output={text}"])
    assert isinstance(place("s3://bucket/a"), StorePath)
