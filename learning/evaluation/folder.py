"""An evaluation's folder: whether it may be written to, and which files in it are the evaluation's own."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

from simulator.errors import InputError
from simulator.io.files import TEMPORARY_PREFIX, storage_errors, write_atomic
from simulator.io.json import readable_json

DESCRIPTION = "evaluation.json"
"""Says that the folder is an evaluation's, and its name; written first."""
RESULTS, TABLE, REPORT = "results.json", "table.csv", "report.md"
MONTAGE, NOISE, DEPTH, STACKS, TIMES = "montage.png", "noise.png", "depth.png", "stacks.png", "times.png"
_OWN = (REPORT, TABLE, RESULTS, MONTAGE, NOISE, DEPTH, STACKS, TIMES)
_FORMAT = "flatlight evaluation"


def claim_folder(folder: Path, name: str) -> None:
    """See that a folder is new, empty, or of the same evaluation; make it and say whose it is.

    Args:
        folder: the folder.
        name: of the evaluation.

    Raises:
        InputError: a file, a data set, a training, anything else, or an evaluation of another name.
        StorageError: the folder cannot be written to.
    """
    if folder.exists() and not folder.is_dir():
        msg = f"output: {folder} is a file; choose another folder"
        raise InputError(msg)
    description = folder / DESCRIPTION
    if description.exists():
        known = _name(description)
        if known != name:
            msg = (
                f"output: {folder} holds the evaluation {known!r}, this one is {name!r}; choose another folder, or keep its "
                "name"
            )
            raise InputError(msg)
        return
    foreign = [each.name for each in sorted(folder.iterdir())] if folder.exists() else []
    foreign = [each for each in foreign if not each.startswith(TEMPORARY_PREFIX)]
    if foreign:
        msg = f"output: {folder} is not empty and holds no evaluation ({foreign[0]}, ...); choose another folder, or empty it"
        raise InputError(msg)
    with storage_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    write_atomic(description, readable_json({"format": _FORMAT, "name": name}))


def remove_stale(folder: Path, written: Iterable[str]) -> None:
    """Delete the files of an earlier run that this one did not write: they show other scenes or settings.

    Raises:
        StorageError: one cannot be deleted.
    """
    for name in set(_OWN) - set(written):
        with storage_errors(folder / name):
            (folder / name).unlink(missing_ok=True)


def _name(description: Path) -> str:
    try:
        content = json.loads(description.read_bytes())
    except (OSError, ValueError) as error:
        msg = f"{description} cannot be read ({error}); restore it from a copy, or choose another output folder"
        raise InputError(msg) from error
    if not isinstance(content, dict) or content.get("format") != _FORMAT or not isinstance(content.get("name"), str):
        msg = f"{description} is no description of an evaluation; choose another output folder"
        raise InputError(msg)
    return content["name"]
