"""What lies in the folders of a data set, by name; and messages about many files in few lines.

The numbers in pictures' names: their order, and whether the count is complete.

Clips out of numbered frames: as many frames as a clip takes whose numbers follow one another, never across a gap.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
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


def natural(name: str) -> list[tuple[int, str]]:
    """Key that sorts ``frame2`` before ``frame10``.

    Example:
        >>> sorted(["frame10.png", "frame2.png"], key=natural)
        ['frame2.png', 'frame10.png']
    """
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"([0-9]+)", name)]


def counting_fault(names: Sequence[str]) -> str | None:
    """Say where the numbers of pictures leave their count, such as 3, 4, 7: between two of them is more time than elsewhere.

    Names count where one of their numbers differs and most of its steps are the same; times and other numbers do not.

    Args:
        names: of the pictures of one video, in order.

    Returns:
        What is wrong and what to do, or None.

    Example:
        >>> counting_fault(["a1.png", "a2.png", "a3.png", "a7.png"])
        'its pictures leave their count of 1 after a3.png (the next is a7.png): fetch what is missing, or split it there'
    """
    keys = [tuple(natural(name)) for name in names]
    if len(keys) < 3 or len({len(key) for key in keys}) > 1:
        return None
    differing = [place for place, parts in enumerate(zip(*keys, strict=True)) if len(set(parts)) > 1]
    if len(differing) != 1 or keys[0][differing[0]][0] < 0:
        return None
    numbers = [key[differing[0]][0] for key in keys]
    steps = [after - before for before, after in pairwise(numbers)]
    (usual, count), *_ = Counter(steps).most_common()
    if count == len(steps) or 2 * count <= len(steps):
        return None
    places = [index for index, step in enumerate(steps) if step != usual]
    more = f", and {len(places) - 1} times more" if len(places) > 1 else ""
    return (
        f"its pictures leave their count of {usual} after {names[places[0]]} (the next is {names[places[0] + 1]}{more}): "
        "fetch what is missing, or split it there"
    )


@dataclass(frozen=True)
class Runs:
    """Where the clips of a list of frames begin.

    Attributes:
        starts: index of each clip's first frame.
        groups: number of the sequence that each clip comes from; never falls.
        problems: lines about sequences that are too short for a clip, one for all with the same number of frames.
    """

    starts: tuple[int, ...]
    groups: tuple[int, ...]
    problems: tuple[str, ...]


def find_runs(sequences: Sequence[str], numbers: Sequence[int], length: int) -> Runs:
    """Cut sequences into clips that lie one after the other and share no frame.

    Args:
        sequences: the name of each frame's sequence; the frames of one sequence stand together.
        numbers: each frame's number in its sequence, in rising order.
        length: frames of a clip.

    Returns:
        The clips; what is left over at the end of a run of consecutive numbers is not used.

    Raises:
        InputError: when no sequence is long enough.

    Example:
        >>> find_runs(["a"] * 5 + ["b"] * 2, [6, 7, 8, 10, 11, 1, 2], 2)
        Runs(starts=(0, 3, 5), groups=(0, 0, 1), problems=())
    """
    starts: list[int] = []
    groups: list[int] = []
    faults: list[Fault] = []
    longest: tuple[int, str] = (0, "")
    for group, (first, end) in enumerate(_stretches(sequences)):
        before = len(starts)
        breaks = [k for k in range(first + 1, end) if numbers[k] != numbers[k - 1] + 1]
        runs = list(pairwise([first, *breaks, end]))
        for start, stop in runs:
            starts += range(start, stop - length + 1, length)
        groups += [group] * (len(starts) - before)
        most = max(stop - start for start, stop in runs)
        longest = max(longest, (most, sequences[first]))
        if most < length:
            reason = f"has {most} consecutive frames, but a clip takes {length}: ask for fewer frames"
            faults.append((sequences[first], reason))
    if not starts:
        msg = (
            f"frames is {length}, but no sequence has so many with consecutive numbers: the longest, {longest[1]!r}, "
            f"has {longest[0]}; ask for fewer"
        )
        raise InputError(msg)
    return Runs(tuple(starts), tuple(groups), grouped(faults))


def run_lengths(sequences: Sequence[str], numbers: Sequence[int]) -> list[int]:
    """Return the lengths of all runs of consecutive numbers, in order."""
    count = len(numbers)
    breaks = [k for k in range(1, count) if sequences[k] != sequences[k - 1] or numbers[k] != numbers[k - 1] + 1]
    return [stop - start for start, stop in pairwise([0, *breaks, count])]


def fault_of(error: InputError, *files: Path) -> Fault:
    """Return the file and the reason: the file is the one whose name the message begins with, else the first of them."""
    text = str(error)
    named = next((file for file in files if text.startswith(f"{file} ")), files[0])
    return str(named), text.removeprefix(f"{named} ")


def check_rate(frames: int, frames_per_second: float | None) -> None:
    """Refuse a clip without a frame rate, and a still with one.

    Raises:
        InputError: for either.
    """
    if frames > 1 and frames_per_second is None:
        msg = f"frames_per_second is missing: a clip of {frames} frames needs the rate at which they were taken"
        raise InputError(msg)
    if frames == 1 and frames_per_second is not None:
        msg = (
            f"frames_per_second is {frames_per_second:g}, but frames: 1 gives stills, which stand still for as long as the "
            "shutter is open: leave it out or ask for more frames"
        )
        raise InputError(msg)


def _stretches(names: Sequence[str]) -> list[tuple[int, int]]:
    """First index and end of each stretch of equal names."""
    breaks = [k for k in range(1, len(names)) if names[k] != names[k - 1]]
    return list(pairwise([0, *breaks, len(names)]))
