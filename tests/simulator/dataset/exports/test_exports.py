"""What holds for exports of every format: the same bytes always, nothing damaged or unfinished, nothing written twice."""

import json
import os
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from simulator.dataset import open_dataset
from simulator.dataset.checksums import CHECKSUMS, write_seal
from simulator.dataset.exports import FORMATS, export
from simulator.dataset.sample import write_sample
from simulator.errors import InputError
from simulator.io.files import StorageError, leftovers

SMALL = {to: {"shard_bytes": 70_000} if form.sharded else {} for to, form in FORMATS.items()}  # two stills
MANY = {"counts": {"train": 7, "validation": 1, "test": 0}}
Hashes = Callable[[Path], dict[str, str]]


@pytest.fixture
def seven(samples: ModuleType, tmp_path: Path) -> Path:
    """A data set of seven training samples and one for validation."""
    from simulator.dataset.manifest import ManifestWriter

    root = samples.make_dataset(tmp_path / "set", **MANY)
    with ManifestWriter(root) as manifest:
        for index in range(3, 7):
            manifest.append(write_sample(root, "train", index, samples.make_sample(index)), seconds=0.1)
    write_seal(root)
    return root


@pytest.mark.parametrize("to", FORMATS)
def test_the_same_bytes_whatever_clock_user_mask_place_and_order(
    seven: Path, tmp_path: Path, hashes: Hashes, monkeypatch: pytest.MonkeyPatch, to: str
) -> None:
    export(seven, to, tmp_path / "a", splits=["train", "validation"], **SMALL[to])
    began = int(time.time())
    while to == "hdf5" and int(time.time()) == began:  # HDF5 asks the system itself for the time, in seconds
        time.sleep(0.02)
    moved = shutil.copytree(seven, tmp_path / "elsewhere" / "copy")
    lines = (moved / "manifest.jsonl").read_text().splitlines()
    (moved / "manifest.jsonl").write_text("".join(f"{line}\n" for line in reversed(lines)))
    write_seal(moved)
    monkeypatch.setattr(time, "time", lambda: 4e9)
    monkeypatch.setattr(time, "localtime", lambda *_: time.gmtime(4e9))
    monkeypatch.setattr(os, "getuid", lambda: 4242)
    monkeypatch.setenv("TZ", "Asia/Kathmandu")
    mask = os.umask(0o077)
    try:
        export(moved, to, tmp_path / "b", splits=["validation", "train"], **SMALL[to])
    finally:
        os.umask(mask)
    first, second = hashes(tmp_path / "a"), hashes(tmp_path / "b")
    assert first == second
    assert {"export.json", "index.jsonl", "croissant.json"} < set(first)
    assert (to != "parquet-index") == ({"dataset.json", "psf/psf.json", "psf/depth_0001.exr"} < set(first))


@pytest.mark.parametrize("to", ["webdataset", "hdf5", "npz"])
def test_an_export_that_was_stopped_goes_on(seven: Path, tmp_path: Path, hashes: Hashes, to: str) -> None:
    whole = export(seven, to, tmp_path / "whole", **SMALL[to])
    out = tmp_path / "out"

    def stop(done: int, total: int) -> None:
        if done == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export(seven, to, out, **SMALL[to], progress=stop)
    written = {name: (out / name).stat() for name in hashes(out) if name.startswith("train")}
    assert len(written) >= 2
    assert written.keys() < hashes(tmp_path / "whole").keys()
    assert list(leftovers(out)) == []
    steps: list[tuple[int, int]] = []
    result = export(seven, to, out, **SMALL[to], progress=lambda done, total: steps.append((done, total)))
    assert hashes(out) == hashes(tmp_path / "whole")
    assert all((out / name).stat().st_ino == before.st_ino for name, before in written.items())
    assert (result.kept, result.shards, result.samples) == (len(written), whole.shards, 8)
    assert steps[-1] == (8, 8)
    first = next(iter(written))
    (out / first).write_bytes(b"no longer what it was")
    assert export(seven, to, out, **SMALL[to]).kept == sum(whole.shards.values()) - 1
    assert hashes(out) == hashes(tmp_path / "whole")


def test_a_run_that_died_leaves_nothing_in_the_way(dataset: Path, tmp_path: Path, hashes: Hashes) -> None:
    out = tmp_path / "out"
    export(dataset, "webdataset", out)
    expected = hashes(out)
    (out / ".tmp-train-000000.tar-ab").write_bytes(b"half")
    with (out / "index.jsonl").open("ab") as index:
        index.write(b'{"name":"train-0000')
    export(dataset, "webdataset", out)
    assert hashes(out) == expected
    shutil.rmtree(out)
    out.mkdir()
    (out / "index.jsonl").touch()
    export(dataset, "webdataset", out)
    assert hashes(out) == expected


@pytest.mark.parametrize("to", ["webdataset", "hdf5", "npz"])
def test_a_damaged_sample_ends_the_export_and_is_named(dataset: Path, tmp_path: Path, to: str) -> None:
    file = dataset / "train/0000/s00000001/measurement.exr"
    data = bytearray(file.read_bytes())
    data[-20] ^= 4
    file.write_bytes(data)
    with pytest.raises(InputError, match=r"train/s00000001: measurement\.exr .*copy.*verify"):
        export(dataset, to, tmp_path / "out", splits=["train"])
    assert not any(path.suffix in (".tar", ".h5") for path in (tmp_path / "out").rglob("*"))
    assert list(leftovers(tmp_path / "out")) == []


def unsealed(root: Path) -> None:
    (root / CHECKSUMS).unlink()


def short(root: Path) -> None:
    lines = (root / "manifest.jsonl").read_text().splitlines()
    (root / "manifest.jsonl").write_text("".join(f"{line}\n" for line in lines if '"validation"' not in line))
    shutil.rmtree(root / "validation")
    write_seal(root)


@pytest.mark.parametrize(("spoil", "found"), [(unsealed, 4), (short, 3)])
def test_an_unfinished_data_set_only_when_asked(
    dataset: Path, tmp_path: Path, spoil: Callable[[Path], None], found: int
) -> None:
    spoil(dataset)
    with pytest.raises(InputError, match="--partial"):
        export(dataset, "npz", tmp_path / "out")
    assert not (tmp_path / "out").exists()
    assert export(dataset, "npz", tmp_path / "out", partial=True).samples == found


def test_a_data_set_that_is_not_as_it_was_sealed(dataset: Path, tmp_path: Path) -> None:
    info = dataset / "dataset.json"
    info.write_text(json.dumps(json.loads(info.read_text()) | {"name": "other"}))
    with pytest.raises(InputError, match=r"dataset\.json: .*SHA-256"):
        export(dataset, "npz", tmp_path / "out", partial=True)


def test_a_stack_that_changes_meanwhile(dataset: Path, tmp_path: Path) -> None:
    def change(done: int, total: int) -> None:
        (dataset / "psf/depth_0001.exr").write_bytes(b"changed")

    with pytest.raises(InputError, match=r"psf/depth_0001\.exr: has changed"):
        export(dataset, "npz", tmp_path / "out", progress=change)
    assert not (tmp_path / "out/croissant.json").exists()


def test_a_folder_that_holds_something_else(dataset: Path, tmp_path: Path, samples: ModuleType) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "thesis.tex").touch()
    with pytest.raises(InputError, match=r"--output: .*thesis\.tex"):
        export(dataset, "webdataset", out)
    (out / "thesis.tex").unlink()
    export(dataset, "webdataset", out)
    with pytest.raises(InputError, match=f"^{out}: an export"):
        open_dataset(out)  # it has the description of the data set, but no samples
    other = samples.make_dataset(tmp_path / "other", lambda index: samples.make_sample(index + 1))
    for changes in ({"to": "npz"}, {"shard_bytes": 1000}, {"splits": ["train"]}, {"path": other}):
        with pytest.raises(InputError, match=r"--output: .*another export"):
            export(**{"path": dataset, "to": "webdataset", "output": out} | changes)
    for inside in (dataset, dataset / "train" / "tars"):
        with pytest.raises(InputError, match=r"--output: .*inside"):
            export(dataset, "webdataset", inside)
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"--output: .*file"):
        export(dataset, "webdataset", tmp_path / "file")


def test_two_exports_to_one_folder_at_once(dataset: Path, tmp_path: Path) -> None:
    def again(done: int, total: int) -> None:
        with pytest.raises(InputError, match="another process"):
            export(dataset, "npz", tmp_path / "out")

    export(dataset, "npz", tmp_path / "out", progress=again)


def test_what_is_asked_for_wrongly(dataset: Path, tmp_path: Path) -> None:
    for changes, words in (
        ({"to": "hdf"}, "--to: .*hdf5"),
        ({"splits": ["trian"]}, "--split: .*'trian'"),
        ({"splits": ["test"]}, "test"),
        ({"path": tmp_path / "nowhere"}, "nowhere: no such folder"),
        ({"shard_bytes": 0}, "--shard-mb"),
        ({"to": "npz", "shard_bytes": 1000}, "--shard-mb: .*npz"),
    ):
        with pytest.raises(InputError, match=words):
            export(**{"path": dataset, "to": "webdataset", "output": tmp_path / "out"} | changes)
        assert not (tmp_path / "out").exists()


def test_a_full_disk_keeps_what_is_finished(
    dataset: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hashes: Hashes
) -> None:
    real = os.replace

    def replace(source: str, target: str) -> None:
        if str(target).endswith("s00000001.npz"):
            raise OSError(28, "No space left on device")
        real(source, target)

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", replace)
        with pytest.raises(StorageError, match="full"):
            export(dataset, "npz", tmp_path / "out")
    assert [name for name in hashes(tmp_path / "out") if name.endswith(".npz")] == ["train/0000/s00000000.npz"]
    assert export(dataset, "npz", tmp_path / "out").kept == 1


@pytest.mark.parametrize("kilobytes", [2, 12, 60])
def test_hdf5_ends_well_on_a_disk_that_fills_up_anywhere(
    command: Callable[..., subprocess.CompletedProcess[str]], dataset: Path, tmp_path: Path, kilobytes: int
) -> None:
    """In a process of its own, since the library used to crash when it closes what it cannot write."""
    limit = (
        "import resource, sys\nsys.dont_write_bytecode = True  # or a compiled module would be cut short, and stay so\n"
    )
    limit += f"resource.setrlimit(resource.RLIMIT_FSIZE, ({kilobytes * 1000},) * 2)"
    done = command("export", dataset, "--to", "hdf5", "--output", tmp_path / "out", before=limit)
    assert done.returncode == 2, done.stderr
    assert "train-000000.h5: cannot be written: " in done.stderr
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["export.json", "index.jsonl"]


def test_code_that_a_data_set_names_never_runs(
    samples: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    named = {"mask": "./plugins.py:corners", "scene": "plugins:boxes"}
    config = {"seed": 7, "camera": {"mask": {"design": named["mask"]}}, "scene": {"family": named["scene"]}}
    root = samples.make_dataset(tmp_path / "set", config=config)
    (tmp_path / "plugins.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w')\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    for to in FORMATS:
        assert export(root, to, tmp_path / to).samples == 4
    assert not (tmp_path / "ran").exists()
