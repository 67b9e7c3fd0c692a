"""A training's folder: what lies in it, and whether it may be gone on with."""

from __future__ import annotations

import fcntl
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from simulator.dataset.fingerprint import difference
from simulator.errors import InputError
from simulator.io.files import TEMPORARY_PREFIX, remove_leftovers, storage_errors, write_atomic
from simulator.io.json import readable_json

DESCRIPTION = "training.json"
"""What is trained on what."""
STATE = "state.pt"
"""All that a training needs to go on."""
METRICS = "metrics.jsonl"
"""One line per log entry and per validation."""
BEST, LAST = "best.safetensors", "last.safetensors"
TENSORBOARD = "tensorboard"
PREVIEW = "validation.png"

# What does not decide a number that is learned, or is said otherwise: `start` by its content, `precision` as it was resolved.
_FREE = ("output", "steps", "device", "log_every", "checkpoint_every_s")
_RESOLVED = ("start", "precision")
_FREE_OF_DATA = ("cache", "workers")


def check_folder(folder: Path, parts: dict[str, Any]) -> None:
    """See that a folder is new, or holds the same training.

    Args:
        folder: the folder.
        parts: see `described`.

    Raises:
        InputError: the folder holds something else, or another training: what differs is listed.
    """
    if folder.exists() and not folder.is_dir():
        msg = f"output: {folder} is a file; choose another folder"
        raise InputError(msg)
    path = folder / DESCRIPTION
    if path.exists():
        lines = difference(_read(path), json.loads(readable_json(parts)))
        if lines and (folder / STATE).exists():
            msg = (
                f"output: {folder} holds a training of another configuration; choose another folder, or undo the change "
                f"(only {', '.join(_FREE[1:])}, data.cache and data.workers may change):\n{lines}"
            )
            raise InputError(msg)
        return
    foreign = [each.name for each in sorted(folder.iterdir())] if folder.exists() else []
    foreign = [name for name in foreign if not name.startswith(TEMPORARY_PREFIX)]
    if foreign:
        msg = f"output: {folder} is not empty and holds no training ({foreign[0]}, ...); choose another folder, or empty it"
        raise InputError(msg)


@contextmanager
def sole_use(folder: Path, parts: dict[str, Any]) -> Iterator[None]:
    """Make the folder of a training and keep other trainings out; the system forgets the lock when the process dies.

    What lies in the folder is looked at under the lock, so that no other training can change it in between. The description
    replaces that of a training that never came to save anything.

    Args:
        folder: the folder; see `check_folder`.
        parts: see `described`.

    Raises:
        InputError: another process trains there, or see `check_folder`.
        StorageError: the folder cannot be written to.
    """
    check_folder(folder, parts)  # a folder of somebody else's is not locked, nor cleared of leftovers
    with storage_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            msg = f"output: another process trains in {folder} now; wait for it, or choose another folder"
            raise InputError(msg) from error
        except OSError:
            pass  # a file system without locks
        check_folder(folder, parts)
        remove_leftovers(folder)
        if not (folder / STATE).exists():
            write_atomic(folder / DESCRIPTION, readable_json(parts))
        yield
    finally:
        os.close(descriptor)


def described(
    config: dict[str, Any], data: dict[str, Any], *, precision: str, start: dict[str, Any] | None
) -> dict[str, Any]:
    """Return what decides the numbers of a training.

    Args:
        config: its configuration, plain.
        data: what is known of the data sets and the camera; plain.
        precision: ``float32`` or ``bfloat16``; ``auto`` means one or the other on another device.
        start: what is known of the checkpoint that it begins with; plain.
    """
    kept = {key: value for key, value in config.items() if key not in (*_FREE, *_RESOLVED)}
    kept["data"] = {key: value for key, value in config["data"].items() if key not in _FREE_OF_DATA}
    return {"config": kept, "data sets": data, "precision": precision, "start": start}


def _read(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_bytes())
    except (OSError, ValueError) as error:
        msg = f"{path} cannot be read ({error}); restore it from a copy, or choose another output folder"
        raise InputError(msg) from error
    if not isinstance(content, dict):
        msg = f"{path} is no description of a training; restore it from a copy, or choose another output folder"
        raise InputError(msg)
    return content
