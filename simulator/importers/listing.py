"""What lies in the folders of a data set, by name; and messages about many files in few lines."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NoReturn, TypeAlias

from simulator.errors import InputError

Fault: TypeAlias = tuple[str, str]  # where, what and what to do

_JUNK = frozenset(("__macosx", "thumbs.db", "desktop.ini"))
_EXAMPLES = 3


def is_hidden(name: str) -> bool:
    """Return whether a file's or folder's name is one that systems and editors leave behind, never part of a data set.

    Example:
        >>> [is_hidden(name) for name in ("._00000.jpg", ".ipynb_checkpoints", "__MACOSX", "Thumbs.db", "00000.jpg")]
        [True, True, True, True, False]
    """
    return name.startswith(".") or name.lower() in _JUNK


def list_folder(path: Path) -> tuple[list[str], list[str]]:
    """Return the names of the folders and of the files in a folder, both sorted, without hidden ones.

    Links are followed. There is nothing in a folder that does not exist.

    Raises:
        InputError: naming the folder, when it cannot be read.
    """
    folders: list[str] = []
    files: list[str] = []
    try:
        with os.scandir(path) as entries:
            for entry in entries:
                if not is_hidden(entry.name):
                    (folders if entry.is_dir() else files).append(entry.name)
    except (FileNotFoundError, NotADirectoryError):
        return [], []
    except OSError as error:
        _refuse(Path(error.filename or path), error)
    return sorted(folders), sorted(files)


def walk(root: Path) -> Iterator[tuple[Path, list[str]]]:
    """Give each folder from a root downwards with the names of its files, sorted, without hidden ones.

    Links are followed, after the folders beside them. No folder is given twice, whatever leads to it: the same pictures
    under two names would be two sequences, which splits could share.

    Raises:
        InputError: naming the folder, when one cannot be read.
    """
    return _walk(Path(root), set())


def is_folder(path: Path) -> bool:
    """Return whether there is such a folder.

    Raises:
        InputError: naming it, when it lies where nothing can be read.
    """
    try:
        return path.is_dir()
    except OSError as error:
        _refuse(path, error)


def grouped(faults: Iterable[Fault]) -> tuple[str, ...]:
    """Return one line ``"where: reason"`` per reason; a reason that many share names a few and counts the others.

    Example:
        >>> grouped([("a", "too short"), ("b", "no mask"), ("c", "too short")])
        ('a, c: too short', 'b: no mask')
    """
    places: dict[str, list[str]] = {}
    for where, reason in faults:
        places.setdefault(reason, []).append(where)
    return tuple(f"{examples(where)}: {reason}" for reason, where in places.items())


def examples(names: list[str]) -> str:
    """Return a few names and how many more there are."""
    more = len(names) - _EXAMPLES
    return ", ".join(names) if more <= 0 else f"{', '.join(names[:_EXAMPLES])} and {more} more"


def _refuse(path: Path, error: OSError) -> NoReturn:
    msg = f"path: {path} cannot be read: {error.strerror or error}; check who may read it, or name a path without it"
    raise InputError(msg) from error


def _walk(folder: Path, visited: set[str]) -> Iterator[tuple[Path, list[str]]]:
    real = os.path.realpath(folder)
    if real in visited:
        return
    visited.add(real)
    folders, files = list_folder(folder)
    yield folder, files
    for name in sorted(folders, key=lambda name: (folder / name).is_symlink()):  # a folder's own name before a link's
        yield from _walk(folder / name, visited)
