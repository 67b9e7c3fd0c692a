"""checksums.json, the seal of a data set: written last, it holds the hash of every file that no sample's digest covers.

What it lists covers the rest: ``manifest.jsonl`` holds each sample's digest, that of ``sample.json`` and of the files which
``sample.json`` lists. Its own bytes are those of its content and of a hash over it, so it covers itself. A run that changes
a data set takes the seal off first; one that comes to its end writes it. Readers do not need it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import PurePosixPath
from typing import Any

from simulator.dataset.dataset_info import FILE
from simulator.dataset.manifest import FAILED, MANIFEST, SKIPPED, ManifestWriter
from simulator.dataset.problems import PROBLEMS
from simulator.errors import InputError
from simulator.io.files import (
    read_errors,
    read_text,
    remove_file,
    sha256_bytes,
    sha256_file,
    write_atomic,
)
from simulator.io.json import canonical_json, readable_json
from simulator.io.store import Place, relative_name, size_of
from simulator.optics.stack_files import CAPTURED_FOLDER, PSF_FOLDER, is_stack_file

CHECKSUMS = "checksums.json"
CONTACT_SHEET = "contact_sheet.png"
REPORT = "report.html"
CROISSANT = "croissant.json"
CARD = "README.md"
OUR_CARD = "<!-- flatlight card: generate writes this file anew; without this line it is yours -->"
"""The last line of a card that Flatlight wrote."""
_CARDS_HEAD = b"---\npretty_name: "
_LISTS = (MANIFEST, SKIPPED, FAILED)  # which grow with the samples
_LARGEST = 4 << 30  # bytes of any other file: more is not hashed
_STACKS = (PSF_FOLDER, CAPTURED_FOLDER)


def files_to_seal(root: Place) -> list[str]:
    """Return the names, below ``root``, of the files there that no sample's digest covers, but the seal itself."""
    listed = (FILE, MANIFEST, SKIPPED, FAILED, PROBLEMS, CONTACT_SHEET, REPORT, CROISSANT)
    names = [name for name in listed if (root / name).exists()] + [CARD] * is_our_card(root / CARD)
    stacks = [path for folder in _STACKS for path in sorted((root / folder).glob("*")) if is_stack_file(path.name)]
    return names + [relative_name(path, root) for path in stacks]


def is_our_card(path: Place) -> bool:
    """Whether a file is a card that Flatlight wrote, and may write anew: one of the user's is neither sealed nor replaced.

    Raises:
        InputError: it cannot be read.
    """
    if not path.is_file():
        return False
    with read_errors(path), path.open("rb") as file:
        file.seek(max(0, size_of(path) - len(OUR_CARD) - 8))
        return file.read().rstrip().rpartition(b"\n")[2] == OUR_CARD.encode()


def is_replaced_card(path: Place) -> bool:
    """Whether a file is another than a card that Flatlight wrote: it neither begins like one, cut short or not, nor ends so.

    Raises:
        InputError: it cannot be read.
    """
    if not path.is_file() or is_our_card(path):
        return False
    with read_errors(path), path.open("rb") as file:
        return not _CARDS_HEAD.startswith(file.read(len(_CARDS_HEAD)))


def write_seal(root: Place) -> None:
    """Write ``checksums.json``; to be called last, by whoever holds the manifest's lock.

    Raises:
        InputError: a file cannot be read.
        StorageError: the folder is protected, or the disk is full.
    """
    hashes = {name: sha256_file(root / name) for name in files_to_seal(root)}
    write_atomic(root / CHECKSUMS, _content(hashes))


def write_beside(root: Place, name: str, data: bytes) -> None:
    """Write a file that is drawn from a data set into its folder; a seal that is there lists it from then on.

    All other hashes stay as they were sealed, so what has changed since is still found.

    Raises:
        InputError: a damaged seal, or a job is writing to a sealed data set; nothing is written.
        StorageError: the folder is protected, or the disk is full.
    """
    hashes = read_seal(root)
    if hashes is None:
        write_atomic(root / name, data)
        return
    with ManifestWriter(root):  # its lock: no job is writing
        write_atomic(root / name, data)
        write_atomic(root / CHECKSUMS, _content(hashes | {name: sha256_bytes(data)}))


def read_seal(root: Place) -> dict[str, str] | None:
    """Return the hashes by the file's name below ``root``; None where there is no seal.

    Raises:
        InputError: a damaged seal.
    """
    path = root / CHECKSUMS
    try:
        text = read_text(path, "the hashes of a data set's files")
    except InputError:
        if path.exists():
            raise
        return None  # also where a run takes the seal off meanwhile
    try:
        hashes = json.loads(text)["files"]
        whole = text.encode() == _content(hashes) and all(_lies_inside(name) for name in hashes)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        whole, hashes = False, {}
    if not whole:
        raise InputError(
            path,
            "damaged: its content does not have the hash that stands in it; restore it from a copy, or delete it and check "
            "that dataset.json and psf/ are as they were before `flatlight generate` writes another",
        )
    return hashes


def changed_files(root: Place, hashes: Mapping[str, str]) -> Iterator[InputError]:
    """Yield an error for every sealed file that is gone or has another content; of a folder that is gone only one."""
    gone = set()
    for name, expected in hashes.items():
        path = root / name
        try:
            with read_errors(path):
                missing = path if path.parent.exists() else path.parent
                if not missing.exists():
                    if missing not in gone:
                        gone.add(missing)
                        raise InputError(
                            missing, f"gone, but {CHECKSUMS} lists it; restore it from a copy, or run generate again"
                        )
                    continue
                large = size_of(path) > _LARGEST and name not in _LISTS
            changed = large or sha256_file(path) != expected
        except InputError as error:
            yield error
            continue
        if changed:
            cure = "restore it from a copy" + (", or keep it as yours: run generate again" if name == CARD else "")
            yield InputError(path, f"has other content than {CHECKSUMS} says (SHA-256 differs); {cure}")


def unseal(root: Place) -> None:
    """Remove the seal before a data set grows.

    Lines of the manifest and whole stacks may be gone, which the run makes again.

    Raises:
        InputError: a damaged seal, or what further samples are made with is not as it was sealed; nothing is removed.
        StorageError: the folder is protected.
    """
    hashes = read_seal(root)
    if hashes is None:
        return
    there = {FILE, *(f"{name}/" for name in _STACKS if (root / name).exists())}
    for error in changed_files(root, {name: digest for name, digest in hashes.items() if _top(name) in there}):
        raise error
    remove_file(root / CHECKSUMS)


def _content(hashes: Any) -> bytes:
    head = {"format": "flatlight-checksums", "format_version": 1}
    return readable_json(head | {"files": hashes, "sha256": sha256_bytes(canonical_json(hashes))})


def _lies_inside(name: str) -> bool:
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts


def _top(name: str) -> str:
    """Return the file's name, or its folder's with a slash."""
    first, slash, _ = name.partition("/")
    return first + slash
