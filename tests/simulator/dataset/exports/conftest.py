"""What the tests of exports share: every byte of a folder, and data sets forged so that their hashes agree."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from simulator.dataset.checksums import write_seal
from simulator.dataset.sample import digest_of
from simulator.io.files import sha256_bytes, sha256_file


def _hashes(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): sha256_file(path) for path in sorted(folder.rglob("*")) if path.is_file()
    }


@pytest.fixture(scope="session")
def hashes() -> Callable[[Path], dict[str, str]]:
    """Return the function from a folder to the SHA-256 of every file in it."""
    return _hashes


def _forge(root: Path, **changes: object) -> Path:
    """Make all hashes agree with the files of the first training sample, after changes to its ``sample.json``."""
    folder = root / "train/0000/s00000000"
    path = folder / "sample.json"
    description = json.loads(path.read_text()) | changes
    if "files" not in changes:
        description["files"] = {name: sha256_bytes((folder / name).read_bytes()) for name in description["files"]}
    path.write_text(json.dumps(description))
    digest = digest_of(description["files"] | {"sample.json": sha256_file(path)})
    lines = [json.loads(line) for line in (root / "manifest.jsonl").read_text().splitlines()]
    for line in lines:
        if (line["split"], line["id"]) == ("train", "s00000000"):
            line |= {"digest": digest, "label": description["label"]}
    (root / "manifest.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    write_seal(root)
    return folder


@pytest.fixture(scope="session")
def forge() -> Callable[..., Path]:
    """Return ``(root, **changes of sample.json) ->`` the first sample's folder, with whose files all hashes agree."""
    return _forge
