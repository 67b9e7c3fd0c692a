"""A training's folder: what lies in it, and whether it may be gone on with."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from simulator.dataset.fingerprint import difference
from simulator.dataset.plain import readable_json
from simulator.errors import InputError
from simulator.files import TEMPORARY_PREFIX, storage_errors, write_atomic

DESCRIPTION = "training.json"
"""What is trained on what."""
STATE = "state.pt"
"""All that a training needs to go on."""
METRICS = "metrics.jsonl"
"""One line per log entry and per validation."""
BEST, LAST = "best.safetensors", "last.safetensors"
TENSORBOARD = "tensorboard"
PREVIEW = "validation.png"

# What does not decide a number that is learned.
_FREE = ("output", "steps", "device", "log_every", "checkpoint_every_s")
_FREE_OF_DATA = ("cache", "workers")


def begin(folder: Path, config: dict[str, Any], data: dict[str, Any]) -> None:
    """Make the folder of a training, or see that it holds the same one.

    Args:
        folder: the folder.
        config: the training's configuration, plain.
        data: what is known of the data sets and the camera; plain.

    Raises:
        InputError: the folder holds something else, or another training: what differs is listed.
    """
    if folder.exists() and not folder.is_dir():
        msg = f"output: {folder} is a file; choose another folder"
        raise InputError(msg)
    path = folder / DESCRIPTION
    parts = {"config": _decisive(config), "data sets": data}
    if path.exists():
        lines = difference(_read(path), json.loads(readable_json(parts)))
        if lines:
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
    with storage_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
    write_atomic(path, readable_json(parts))


def _decisive(config: dict[str, Any]) -> dict[str, Any]:
    kept = {key: value for key, value in config.items() if key not in _FREE}
    kept["data"] = {key: value for key, value in config["data"].items() if key not in _FREE_OF_DATA}
    return kept


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
