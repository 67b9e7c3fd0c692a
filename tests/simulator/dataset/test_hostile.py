"""Data sets made to harm, whose hashes all agree: refused within 5 s, nothing outside read, run or written, by any door."""

import json
import os
import pickle
import re
import shutil
import signal
import struct
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from simulator.dataset import generate, open_dataset, verify
from simulator.dataset.checksums import write_seal
from simulator.dataset.exports import export
from simulator.dataset.merging import merge
from simulator.dataset.regeneration import regenerate
from simulator.dataset.status import status
from simulator.errors import InputError
from simulator.io import store
from simulator.io.files import sha256_file
from simulator.io.store import StorePath
from simulator.plots.report.page import report_html, write_report

pytestmark = pytest.mark.filterwarnings("ignore:the PSF's sampling error")

LIMIT_S = 5
FIRST = "train/0000/s00000000"
Forge = Callable[..., Path]


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory, make_trial: Callable) -> Any:
    """A trial with its data set; not to be changed."""
    trial = make_trial(tmp_path_factory.mktemp("made"))
    trial.root = trial.generate()
    return trial


@pytest.fixture
def hostile(made: Any, tmp_path: Path) -> Path:
    """A copy that may be changed, in a folder where it is alone."""
    return shutil.copytree(made.root, tmp_path / "here/set")


# ---- what happens outside: every file and folder that Python opens, lists or changes

WATCHED: list[list[str]] = []


def _watch(event: str, arguments: tuple[Any, ...]) -> None:
    if WATCHED and event in ("open", "os.listdir", "os.scandir", "os.remove", "os.rename", "os.mkdir"):
        for argument in arguments[:2]:
            if isinstance(argument, str | bytes | os.PathLike):
                WATCHED[-1].append(os.path.realpath(os.fsdecode(argument)))


sys.addaudithook(_watch)


class TooLateError(BaseException):
    """A harm was not refused in time; nothing takes it for a refusal."""


def _too_late(*_: object) -> None:
    raise TooLateError


@contextmanager
def untouched(outside: Path) -> Iterator[None]:
    """Fail where something outside is opened, listed or changed, or where it takes too long."""
    outside.mkdir(exist_ok=True)
    before = {path: path.stat().st_mtime_ns for path in outside.rglob("*")}
    WATCHED.append([])
    usual = signal.signal(signal.SIGALRM, _too_late)
    signal.alarm(LIMIT_S)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, usual)
        touched = WATCHED.pop()
    assert [path for path in touched if path.startswith(str(outside))] == []
    assert {path: path.stat().st_mtime_ns for path in outside.rglob("*")} == before


# ---- doors: each gives what it found wrong


def through_verify(root: Any, made: Any, to: Path) -> object:
    return verify(root).problems


def through_export(root: Any, made: Any, to: Path) -> object:
    export(root, "webdataset", to)


def through_merge(root: Any, made: Any, to: Path) -> object:
    return merge(to, [root]).problems


def through_open(root: Any, made: Any, to: Path) -> object:
    list(open_dataset(root))


def through_regenerate(root: Any, made: Any, to: Path) -> object:
    return regenerate(root, [("train", "s00000000")], config=made.path).faults


def through_report(root: Any, made: Any, to: Path) -> object:
    page = report_html(root)
    if isinstance(root, Path):
        write_report(root)
    return "Damaged, and left out" in page


def through_status(root: Any, made: Any, to: Path) -> object:
    status(root, shards=3)


# What each reads, and so has to refuse.
DOORS: dict[str, tuple[Callable[[Any, Any, Path], object], str]] = {
    "verify": (through_verify, "info lists skipped sample psf"),
    "export": (through_export, "info lists sample psf"),
    "merge": (through_merge, "info lists sample psf"),
    "open": (through_open, "info lists sample"),
    "regenerate": (through_regenerate, "info lists sample psf"),
    "report": (through_report, "info lists sample psf"),
    "status": (through_status, "info lists"),
}


# ---- harms


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
    outside = root.parent / "outside" / path.name
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


def forge_list(root: Path) -> None:
    path = root / FIRST / "sample.json"
    description = json.loads(path.read_text())
    path.write_text(json.dumps(description | {"files": list(description["files"])}))


def edit_info(root: Path, **changes: object) -> None:
    path = root / "dataset.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))
    write_seal(root)


def writer(root: Path, name: str) -> Path:
    (root / "writers" / name).mkdir(parents=True)
    return root / "writers" / name


def foreign_writer(root: Path) -> None:
    """A writer's folder that is a link to one outside, whose list names a sample more."""
    outside = root.parent / "outside"
    line = json.loads((root / "manifest.jsonl").read_text().splitlines()[0])
    (outside / "manifest.jsonl").write_text(json.dumps(line | {"id": "s00000002"}) + "\n")
    (root / "writers").mkdir()
    (root / "writers/a").symlink_to(outside)


def lists_line(root: Path, name: str, **content: object) -> None:
    (root / name).write_text(json.dumps(content) + "\n")
    write_seal(root)


LINKS = {
    "dataset.json": "info",
    "manifest.jsonl": "lists",
    "psf": "psf",
    "psf/depth_0000.exr": "psf",
    "psf/psf.json": "psf",
    "train": "sample",
    "train/0000": "sample",
    FIRST: "sample",
    f"{FIRST}/sample.json": "sample",
    f"{FIRST}/measurement.exr": "sample",
}
SIZES = {
    "dataset.json": "info",
    "manifest.jsonl": "lists",
    "skipped.jsonl": "skipped",
    "failed.jsonl": "failed",
    "psf/psf.json": "psf",
    "psf/depth_0001.exr": "psf",
    f"{FIRST}/sample.json": "sample",
    f"{FIRST}/measurement.exr": "sample",
}
OUT = {"id": "../../../../outside/x", "split": "train"}
HOSTILE: dict[str, tuple[Callable[[Path, Forge], object], str, str]] = {
    "id that leads out": (lambda root, _: edit_manifest(root, id=OUT["id"]), "lists", r"manifest\.jsonl:1: "),
    "absolute id": (lambda root, _: edit_manifest(root, id="/etc/passwd"), "lists", r"manifest\.jsonl:1: "),
    "id with a new line": (lambda root, _: edit_manifest(root, id="s0000000\n"), "lists", r"manifest\.jsonl:1: "),
    "split that leads out": (lambda root, _: edit_manifest(root, split="../train"), "lists", r"manifest\.jsonl:1: "),
    "half a character": (lambda root, _: edit_manifest(root, label="\ud800"), "lists", r"manifest\.jsonl:1: "),
    "skipped id that leads out": (
        lambda root, _: lists_line(root, "skipped.jsonl", **OUT, reason="x"),
        "skipped",
        r"skipped\.jsonl:1: ",
    ),
    "failed id that leads out": (
        lambda root, _: lists_line(root, "failed.jsonl", **OUT, reason="x", attempts=3, traceback=""),
        "failed",
        r"failed\.jsonl:1: ",
    ),
    "writer's id that leads out": (
        lambda root, _: (writer(root, "a") / "manifest.jsonl").write_text(json.dumps(OUT) + "\n"),
        "lists",
        r"manifest\.jsonl:1: ",
    ),
    "writer that is a link": (lambda root, _: foreign_writer(root), "lists", r"writers/a: a link"),
    "writer's list that is a pipe": (
        lambda root, _: os.mkfifo(writer(root, "a") / "manifest.jsonl"),
        "lists",
        r"manifest\.jsonl: not a file",
    ),
    "absolute file": (lambda root, forge: edit_files(root, forge, "/etc/passwd"), "sample", r"sample\.json: files"),
    "file that leads out": (
        lambda root, forge: edit_files(root, forge, "../../../x"),
        "sample",
        r"sample\.json: files",
    ),
    "files as a list": (lambda root, _: forge_list(root), "sample", r"sample\.json: files"),
    **{
        f"link: {place}": (lambda root, _, place=place: link(root, place), kind, f"{place}: (a link|not a file)")
        for place, kind in LINKS.items()
    },
    **{
        f"pipe: {place}": (
            lambda root, _, place=place: fifo(root, place),
            kind,
            f"{place}(: not a file|; give|: cannot be written)",
        )
        for place, kind in LINKS.items()
        if "." in place
    },
    **{
        f"terabyte: {place}": (
            lambda root, forge, place=place: large(root, forge, place),
            kind,
            place.rpartition("/")[2],
        )
        for place, kind in SIZES.items()
    },
    "deep description": (lambda root, _: deep(root, f"{FIRST}/sample.json"), "sample", r"sample\.json: .*100 levels"),
    "deep configuration": (lambda root, _: deep(root, "dataset.json"), "info", r"dataset\.json: .*100 levels"),
    "more samples than ids": (lambda root, _: edit_info(root, counts={"train": 10**15}), "info", "counts"),
    "gigantic image": (claim, "sample", r"measurement\.exr"),
    "pickle": (pickled, "sample", r"measurement\.exr: not an OpenEXR file"),
}


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("kind", HOSTILE)
@pytest.mark.slow
def test_it_is_refused_in_time_and_nothing_comes_of_it(
    hostile: Path, made: Any, forge: Forge, kind: str, door: str
) -> None:
    spoil, what, words = HOSTILE[kind]
    outside = hostile.parent / "outside"
    outside.mkdir()
    spoil(hostile, forge)
    enter, reads = DOORS[door]
    found: object = None
    with untouched(outside):
        try:
            found = enter(hostile, made, hostile.parent / "to")
        except InputError as error:
            found = str(error)
            if door != "regenerate":  # it looks at what it needs in another order
                assert re.search(words, found)
    if what in reads.split():
        assert found
        assert not (hostile.parent / "to" / FIRST).exists()
        assert list(hostile.parent.rglob("*.tar")) == []
    assert {path.name for path in hostile.parent.iterdir()} <= {"set", "to", "outside"}


# ---- code that a data set names

EVIL = "from pathlib import Path\nPath(__file__).with_name('run').touch()\ndef f(*_, **__): pass\ncorners = boxes = f\n"


@pytest.mark.parametrize("name", ["./evil.py:f", "evil:f", "./set/evil.py:f"])
@pytest.mark.parametrize("door", DOORS)
def test_no_code_that_it_names_is_imported(hostile: Path, made: Any, monkeypatch, door: str, name: str) -> None:
    """Neither its mask, its scenes nor its shutter, found in the current folder, on the path or in the data set itself."""
    folder = hostile.parent
    for place in (folder, hostile):
        for file in ("evil.py", "plugins.py"):
            (place / file).write_text(EVIL)
    monkeypatch.chdir(folder)
    monkeypatch.syspath_prepend(str(folder))
    config = json.loads((hostile / "dataset.json").read_text())["config"]
    config["camera"]["mask"]["design"] = config["scene"]["family"] = name
    config["camera"]["shutter"] = {"type": "windows", "function": name}
    edit_info(hostile, config=config)
    outside = folder / "outside"
    with untouched(outside):
        try:
            if door == "regenerate":
                with pytest.raises(InputError, match=r"dataset\.json: .*--trust-code"):
                    regenerate(hostile, [("train", "s00000000")])
            else:
                DOORS[door][0](hostile, made, folder / "to")
        except InputError:
            assert door in ("export", "merge")  # the shutter is not the recorded one
    assert list(folder.rglob("run")) == []


def test_a_configuration_that_grows_when_it_is_read(hostile: Path, made: Any) -> None:
    """Nine levels of nine aliases each: a billion values."""
    bomb = hostile.parent / "bomb.yaml"
    levels = [f"l{n}: &l{n} [{', '.join([f'*l{n - 1}'] * 9)}]" for n in range(1, 10)]
    bomb.write_text("\n".join(["l0: &l0 [x]", *levels]) + "\n")
    for enter in (lambda: regenerate(hostile, [("train", "s00000000")], config=bomb), lambda: generate(bomb)):
        with untouched(hostile.parent / "outside"), pytest.raises(InputError):
            enter()


# ---- in an object store


NUMBERS = count()


@pytest.fixture
def stored(bucket: str, made: Any) -> Iterator[StorePath]:
    """The data set in the bucket, to be spoilt."""
    store._client.cache_clear()
    root = StorePath(f"{bucket}/sets/{next(NUMBERS)}")
    for path in made.root.rglob("*"):
        if path.is_file():
            (root / path.relative_to(made.root).as_posix()).write_bytes(path.read_bytes())
    yield root
    store._client.cache_clear()


def put_key(root: StorePath, name: str, data: bytes) -> None:
    """Store an object under a name that our own paths refuse."""
    import boto3

    client = boto3.client("s3", endpoint_url=os.environ["AWS_ENDPOINT_URL"])
    bucket, _, folder = str(root).removeprefix("s3://").partition("/")
    client.put_object(Bucket=bucket, Key=f"{folder}/{name}", Body=data)


def stored_line(root: StorePath, name: str, **changes: object) -> None:
    first = json.loads((root / "manifest.jsonl").read_bytes().splitlines()[0])
    (root / name).write_bytes(json.dumps(first | changes).encode() + b"\n")


def claimed(root: StorePath, place: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the store say that an object has a gigabyte; whoever reads it has failed."""
    size, read = StorePath.size, StorePath.read_bytes

    def read_other(self: StorePath) -> bytes:
        assert self != root / place
        return read(self)

    monkeypatch.setattr(StorePath, "size", lambda self: 1 << 30 if self == root / place else size(self))
    monkeypatch.setattr(StorePath, "read_bytes", read_other)


STORED: dict[str, tuple[Callable[[StorePath, pytest.MonkeyPatch], object], str]] = {
    "id that leads out": (lambda root, _: stored_line(root, "manifest.jsonl", **OUT), "lists"),
    "writer's id that leads out": (lambda root, _: stored_line(root, "writers/a/manifest.0000.jsonl", **OUT), "lists"),
    "writer's name that leads out": (
        lambda root, _: put_key(root, "writers/../../outside/manifest.jsonl", b"{}\n"),
        "lists",
    ),
    "name that leads out": (lambda root, _: put_key(root, "train/../../outside/x", b"x"), "names"),
    "absolute name": (lambda root, _: put_key(root, "/etc/passwd", b"x"), "names"),
    "name in a sample that leads out": (lambda root, _: put_key(root, f"{FIRST}/../../../../x", b"x"), "names"),
    "gigabyte of a description": (lambda root, patch: claimed(root, f"{FIRST}/sample.json", patch), "sample"),
    "gigabyte of dataset.json": (lambda root, patch: claimed(root, "dataset.json", patch), "info"),
    "long description": (
        lambda root, _: (root / FIRST / "sample.json").write_bytes(b'{"id":"' + b"x" * (17 << 20)),
        "sample",
    ),
    "pickle": (
        lambda root, _: (root / FIRST / "measurement.exr").write_bytes(pickle.dumps(Harm(Path("harm")))),
        "sample",
    ),
}


@pytest.mark.parametrize("door", DOORS)
@pytest.mark.parametrize("kind", STORED)
@pytest.mark.slow
def test_a_store_is_trusted_no_more(stored: StorePath, made: Any, tmp_path: Path, monkeypatch, kind, door) -> None:
    spoil, what = STORED[kind]
    monkeypatch.chdir(tmp_path)
    spoil(stored, monkeypatch)
    enter, reads = DOORS[door]
    found: object = None
    with untouched(tmp_path / "outside"):
        try:
            found = enter(stored, made, tmp_path / "to")
        except InputError as error:
            found = str(error)
    if what in reads.split() or (what == "names" and door == "verify"):
        assert found
        assert not (tmp_path / "to" / FIRST).exists()
    assert {path.name for path in tmp_path.iterdir()} <= {"to", "outside"}
