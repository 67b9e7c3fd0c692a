"""Whose a folder is, and what made a result."""

from __future__ import annotations

import json
import platform
from importlib import metadata
from pathlib import Path
from typing import Any

from simulator import __version__
from simulator.dataset.manifest import load_manifest
from simulator.dataset.reader import Dataset
from simulator.errors import InputError
from simulator.io.files import TEMPORARY_PREFIX
from simulator.validation import renamed


def is_own_folder(folder: Path, description: str, kind: str, option: str = "output") -> bool:
    """Return whether a folder holds a job's description; a new or empty one does not.

    ``description`` names the file that says whose the folder is; ``kind`` ("training") and ``option`` are for messages.

    Raises:
        InputError: a file, or a folder of other things.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(option, f"{folder} is a file; choose another folder")
    if (folder / description).exists():
        return True
    names = [each.name for each in sorted(folder.iterdir())] if folder.exists() else []
    foreign = [name for name in names if not name.startswith(TEMPORARY_PREFIX)]
    if foreign:
        there = f"{folder} is not empty and holds no {kind} ({foreign[0]}, ...)"
        raise InputError(option, f"{there}; choose another folder, or empty it")
    return False


def read_description(path: Path, kind: str) -> dict[str, Any]:
    """Return what a job wrote about its folder, with today's keys."""
    cure = "restore it from a copy, or choose another output folder"
    try:
        content = json.loads(path.read_bytes())
    except (OSError, ValueError) as error:
        raise InputError(path, f"cannot be read ({error}); {cure}") from error
    if not isinstance(content, dict):
        raise InputError(path, f"not a description of a {kind}; {cure}")
    return renamed(content)


def sample_digests(dataset: Dataset) -> list[str]:
    """Return the digest of each sample of a split, by which samples that were made again are told apart."""
    entries = load_manifest(dataset.root).entries
    return [entries[dataset.split, sample].digest for sample in dataset.ids]


def versions(*packages: str) -> dict[str, str]:
    """Return the versions of Flatlight, Python and packages; "absent" for those that are not installed."""
    found = {"flatlight": __version__, "python": platform.python_version()}
    for name in packages:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            found[name] = "absent"
    return found
