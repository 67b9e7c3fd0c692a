"""What lies in the folders of a data set, by name and by number; and messages about many files in few lines."""

from __future__ import annotations

import json
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, NoReturn, TypeAlias

from simulator.errors import InputError

Fault: TypeAlias = tuple[str, str]  # where, what and what to do

_JUNK = frozenset(("__macosx", "thumbs.db", "desktop.ini"))
_EXAMPLES = 3
_LISTED = 20


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
        refuse_unreadable(Path(error.filename or path), error)
    return sorted(folders), sorted(files)


def walk(root: Path) -> Iterator[tuple[Path, list[str]]]:
    """Give each folder from a root downwards with the names of its files, sorted, without hidden ones.

    Links are followed, after the folders beside them. No folder is given twice, whatever leads to it: the same images
    under two names would be two sequences, which splits could share.

    Raises:
        InputError: naming the folder, when one cannot be read.
    """
    visited: set[str] = set()

    def visit(folder: Path) -> Iterator[tuple[Path, list[str]]]:
        real = os.path.realpath(folder)
        if real in visited:
            return
        visited.add(real)
        folders, files = list_folder(folder)
        yield folder, files
        for name in sorted(folders, key=lambda name: (folder / name).is_symlink()):  # its own name before a link's
            yield from visit(folder / name)

    return visit(Path(root))


def is_folder(path: Path) -> bool:
    """Return whether there is such a folder.

    Raises:
        InputError: naming it, when it lies where nothing can be read.
    """
    try:
        return path.is_dir()
    except OSError as error:
        refuse_unreadable(path, error)


def refuse_unreadable(path: Path, error: OSError) -> NoReturn:
    """Refuse a place that the system does not let us read."""
    raise InputError("path", f"{path} cannot be read: {error.strerror or error}; name a path without it") from error


def read_json(path: Path) -> Any:
    """Return the content of a data set's JSON file.

    Raises:
        InputError: naming the file.
    """
    try:
        return json.loads(path.read_bytes())
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(path, f"cannot be read as JSON ({error}): fetch it again") from error


def natural(name: str) -> list[tuple[int, str]]:
    """Key that sorts ``frame2`` before ``frame10``.

    Example:
        >>> sorted(["frame10.png", "frame2.png"], key=natural)
        ['frame2.png', 'frame10.png']
    """
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"([0-9]+)", name)]


def counting_fault(names: Sequence[str]) -> str | None:
    """Say where the numbers of images leave their count, such as 3, 4, 7: between two of them is more time than elsewhere.

    Names count where one of their numbers differs and most of its steps are the same; times and other numbers do not.

    Args:
        names: of the images of one video, in order.

    Returns:
        What is wrong and what to do, or None.

    Example:
        >>> counting_fault(["a1.png", "a2.png", "a3.png", "a7.png"])
        'its images leave their count of 1 after a3.png (the next is a7.png): fetch what is missing, or split it there'
    """
    steps = _steps(names)
    usual = count_of(names)
    if usual is None or steps.count(usual) == len(steps):
        return None
    places = [index for index, step in enumerate(steps) if step != usual]
    more = f", and {len(places) - 1} times more" if len(places) > 1 else ""
    return (
        f"its images leave their count of {usual} after {names[places[0]]} (the next is {names[places[0] + 1]}{more}): "
        "fetch what is missing, or split it there"
    )


def count_of(names: Sequence[str]) -> int | None:
    """Return the step that most of the numbers in names take, None where they do not count, see :func:`counting_fault`.

    Example:
        >>> count_of(["a1.png", "a2.png", "a3.png", "a7.png"]), count_of(["beach.jpg", "food.jpg", "home.jpg"])
        (1, None)
    """
    steps = _steps(names)
    if len(steps) < 2:
        return None
    (usual, count), *_ = Counter(steps).most_common()
    return usual if 2 * count > len(steps) else None


def _steps(names: Sequence[str]) -> list[int]:
    """By how much the one number that differs between names rises from each to the next; none where not one differs."""
    keys = [tuple(natural(name)) for name in names]
    if len({len(key) for key in keys}) > 1:
        return []
    differing = [place for place, parts in enumerate(zip(*keys, strict=True)) if len(set(parts)) > 1]
    if len(differing) != 1 or keys[0][differing[0]][0] < 0:
        return []
    return [after[differing[0]][0] - before[differing[0]][0] for before, after in pairwise(keys)]


def fault_of(error: InputError, *files: Path, root: Path | None = None) -> Fault:
    """Return where a fault is and why, so that the same fault of many files makes one line.

    Args:
        error: what a reader raised.
        *files: those that were read; a message that names none of them is about the first.
        root: a folder by which names, in the reason too, are shortened.
    """
    named = next((file for file in files if error.path == str(file)), None)
    where = named or files[0]
    reason = str(error) if named is None else error.reason
    if root is None:
        return where.as_posix(), reason
    return where.relative_to(root).as_posix(), reason.replace(f"{root}/", "")


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


def first_lines(lines: Sequence[str], most: int = _LISTED) -> list[str]:
    """Return the first lines, and how many more there are.

    Example:
        >>> first_lines(["a", "b", "c"], 2)
        ['a', 'b', 'and 1 more']
    """
    more = len(lines) - most
    return [*lines[:most], *([f"and {more} more"] if more > 0 else [])]
