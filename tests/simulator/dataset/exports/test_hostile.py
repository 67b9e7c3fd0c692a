"""Data sets made to harm, whose hashes all agree: refused within 5 s, nothing outside read, run or written."""

import json
import os
import pickle
import struct
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from simulator.dataset.checksums import write_seal
from simulator.dataset.exports import FORMATS, export
from simulator.dataset.verification import verify
from simulator.errors import InputError
from simulator.io.files import sha256_file

LIMIT_S = 5
Forge = Callable[..., Path]


class Harm:
    """A pickle that leaves a file behind when it is loaded."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple:
        return (open, (str(self.marker), "w"))


def edit_manifest(root: Path, **changes: object) -> None:
    path = root / "manifest.jsonl"
    first, *lines = path.read_text().splitlines()
    path.write_text("\n".join([json.dumps(json.loads(first) | changes), *lines]) + "\n")
    write_seal(root)


def edit_files(root: Path, forge: Forge, name: str) -> None:
    path = root / "train/0000/s00000000/sample.json"
    files = json.loads(path.read_text())["files"]
    forge(root, files={name: sha256_file(root / "dataset.json"), "measurement.exr": files["measurement.exr"]})


def link(root: Path, place: str) -> None:
    path = root / place
    outside = root.parent / "outside"
    path.rename(outside)
    path.symlink_to(outside)


def fifo(root: Path, place: str) -> None:
    (root / place).unlink()
    os.mkfifo(root / place)


def large(root: Path, forge: Forge, place: str) -> None:
    """Claim a terabyte, in no space on the disk."""
    with (root / place).open("ab") as file:
        file.truncate(1 << 40)


def deep(root: Path, place: str) -> None:
    (root / place).write_text('{"a":' * 50_000 + "1" + "}" * 50_000)


def claim(root: Path, forge: Forge) -> None:
    """Let an image say that it has 2^60 pixels."""
    path = root / "train/0000/s00000000/measurement.exr"
    data = path.read_bytes()
    at = data.index(b"dataWindow\0box2i\0") + 21
    path.write_bytes(data[:at] + struct.pack("<4i", 0, 0, 2**30 - 1, 2**30 - 1) + data[at + 16 :])
    forge(root)


def pickled(root: Path, forge: Forge) -> None:
    path = root / "train/0000/s00000000/measurement.exr"
    path.write_bytes(pickle.dumps(Harm(root.parent / "harm")))
    forge(root)


FIRST = "train/0000/s00000000"
HOSTILE: dict[str, tuple[Callable[[Path, Forge], object], str]] = {
    "id that leads out": (lambda root, _: edit_manifest(root, id="../../../x"), r"manifest\.jsonl:1: "),
    "id with a new line": (lambda root, _: edit_manifest(root, id="s0000000\n"), r"manifest\.jsonl:1: "),
    "split that leads out": (lambda root, _: edit_manifest(root, split="../train"), r"manifest\.jsonl:1: "),
    "half a character": (lambda root, _: edit_manifest(root, label="\ud800"), r"manifest\.jsonl:1: "),
    "absolute file": (lambda root, forge: edit_files(root, forge, "/etc/passwd"), r"sample\.json: files"),
    "file that leads out": (lambda root, forge: edit_files(root, forge, "../../../x"), r"sample\.json: files"),
    "files as a list": (lambda root, forge: forge_list(root), r"sample\.json: files"),
    **{
        f"link: {place}": (lambda root, _, place=place: link(root, place), f": {place}: a link")
        for place in ("dataset.json", "psf", "psf/depth_0000.exr", "train", "train/0000", FIRST, f"{FIRST}/sample.json")
    },
    "link: measurement": (lambda root, _: link(root, f"{FIRST}/measurement.exr"), r"measurement\.exr: a link"),
    "pipe": (lambda root, _: fifo(root, f"{FIRST}/measurement.exr"), r"measurement\.exr: not a file"),
    "pipe as manifest": (lambda root, _: fifo(root, "manifest.jsonl"), r"manifest\.jsonl: not a file"),
    **{
        f"terabyte: {name}": (lambda root, forge, name=name: large(root, forge, name), name.rpartition("/")[2])
        for name in ("dataset.json", "manifest.jsonl", "psf/psf.json", f"{FIRST}/sample.json")
    },
    "deep description": (lambda root, _: deep(root, f"{FIRST}/sample.json"), r"sample\.json: .*100 levels"),
    "deep configuration": (lambda root, _: deep(root, "dataset.json"), r"dataset\.json: .*100 levels"),
    "gigantic image": (claim, r"measurement\.exr"),
    "pickle": (pickled, r"measurement\.exr: not an OpenEXR file"),
}


def forge_list(root: Path) -> None:
    path = root / FIRST / "sample.json"
    description = json.loads(path.read_text())
    path.write_text(json.dumps(description | {"files": list(description["files"])}))


@pytest.mark.parametrize("kind", HOSTILE)
def test_it_is_refused_in_time_and_nothing_comes_of_it(dataset: Path, tmp_path: Path, forge: Forge, kind: str) -> None:
    spoil, words = HOSTILE[kind]
    spoil(dataset, forge)
    before = {path.name for path in tmp_path.iterdir()}
    began = time.perf_counter()
    with pytest.raises(InputError, match=words):
        export(dataset, "webdataset", tmp_path / "out")
    assert time.perf_counter() - began < LIMIT_S
    assert {path.name for path in tmp_path.iterdir()} - before <= {"out"}
    assert list((tmp_path / "out").rglob("*.tar")) == []
    assert not verify(dataset).ok
    assert time.perf_counter() - began < 2 * LIMIT_S


def test_a_link_in_the_folder_to_write_to(dataset: Path, tmp_path: Path) -> None:
    export(dataset, "webdataset", tmp_path / "out")
    outside = tmp_path / "outside"
    (tmp_path / "out/psf").rename(outside)
    (tmp_path / "out/psf").symlink_to(outside)
    with pytest.raises(InputError, match=r"--output: .*psf is a link"):
        export(dataset, "webdataset", tmp_path / "out")


def test_an_extra_whose_name_leads_out(samples: ModuleType, tmp_path: Path) -> None:
    extras = {"../../x": np.zeros((1, *samples.SCENE), np.float32)}
    root = samples.make_dataset(tmp_path / "set", lambda index: samples.make_sample(index, extras=extras))
    for to in ("hdf5", "npz"):
        with pytest.raises(InputError, match=r"extras\['\.\./\.\./x'\]"):
            export(root, to, tmp_path / to)
    assert export(root, "webdataset", tmp_path / "webdataset").samples == 4


def test_names_and_labels_of_any_text(samples: ModuleType, tmp_path: Path) -> None:
    """They are content, never names of files."""
    text = "../../x\n\0</script>'; DROP TABLE"
    root = samples.make_dataset(tmp_path / "set", lambda index: samples.make_sample(index, label=text), name=text)
    for to in FORMATS:
        assert export(root, to, tmp_path / to).samples == 4
    assert {path.name for path in tmp_path.iterdir()} == {"set", *FORMATS}
