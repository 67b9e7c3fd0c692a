"""The folder of an evaluation: whose it is, and what of an earlier run is left in it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from learning.provenance import read_description
from simulator.errors import InputError
from simulator.io.files import is_own_folder, storage_errors, write_atomic
from simulator.io.json import readable_json

DESCRIPTION = "evaluation.json"
"""Says that the folder is an evaluation's, and its name; written first."""
_FORMAT = "flatlight evaluation"


def is_claimed(folder: Path, name: str) -> bool:
    """Return whether a folder is of the evaluation of this name; an InputError refuses what is of another, or not empty."""
    path = folder / DESCRIPTION
    if is_own_folder(folder, DESCRIPTION, "evaluation"):
        content = read_description(path, "evaluation")
        known = content.get("name")
        if content.get("format") != _FORMAT or not isinstance(known, str):
            raise InputError(path, "not a description of an evaluation; choose another output folder")
        if known != name:
            found = f"{folder} holds the evaluation {known!r}, not {name!r}"
            raise InputError("output", f"{found}; choose another folder, or keep its name")
        return True
    return False


def claim_folder(folder: Path, name: str) -> None:
    """See that a folder is new, empty, or of the evaluation of this name; make it and say whose it is."""
    if not is_claimed(folder, name):
        with storage_errors(folder):
            folder.mkdir(parents=True, exist_ok=True)
        write_atomic(folder / DESCRIPTION, readable_json({"format": _FORMAT, "name": name}))


def remove_stale(folder: Path, written: Iterable[str], own: Sequence[str]) -> None:
    """Delete the files of an earlier run that this one did not write: they show other scenes or settings.

    ``own`` are the names that such files have, here or one folder below.
    """
    path = folder / DESCRIPTION
    description = read_description(path, "evaluation")
    for name in {*own, *description.get("files", ())} - set(written):
        *inside, last = str(name).split("/")
        if last in own and len(inside) <= 1 and all(part[:1] not in ("", ".") for part in inside):
            with storage_errors(folder / name):
                (folder / name).unlink(missing_ok=True)
                if inside and not any((folder / name).parent.iterdir()):
                    (folder / name).parent.rmdir()
    write_atomic(path, readable_json(description | {"files": sorted(written)}))
