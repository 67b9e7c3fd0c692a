"""What an importer found in a folder: counts, facts and problems, for people to read before they rely on it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

Progress = Callable[[int, int], None]  # (done, total)

LISTED = 20
"""Problems that are shown one by one."""


def first_lines(lines: Sequence[str], most: int = LISTED) -> list[str]:
    """Return the first lines, and how many more there are.

    Example:
        >>> first_lines(["a", "b", "c"], 2)
        ['a', 'b', 'and 1 more']
    """
    more = len(lines) - most
    return [*lines[:most], *([f"and {more} more"] if more > 0 else [])]


@dataclass(frozen=True)
class Survey:
    """The result of reading everything in a data set's folder once.

    Attributes:
        importer: the importer's name, as ``scene.source`` takes it.
        path: the folder or file.
        usable: how many videos (or pictures) can be used.
        facts: what was found, by name, in the order to be shown: ``{"videos": "2", "frames": "20 (16 to 4)", ...}``.
        problems: lines ``"file: what is wrong and what to do"``, for everything that cannot be used.
        notes: lines about what was used all the same but should be known (a mask resized by a pixel, frames skipped).
        needed: parameters that the source demands for what was found, though they have a default: a frame rate for pictures.
    """

    importer: str
    path: Path
    usable: int
    facts: dict[str, str]
    problems: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    needed: tuple[str, ...] = ()

    def __str__(self) -> str:
        width = max((len(name) for name in self.facts), default=0)
        lines = [f"{self.path}: {self.importer}, {self.usable} usable"]
        lines += [f"  {name:<{width}}  {value}" for name, value in self.facts.items()]
        lines += [f"  note: {line}" for line in self.notes]
        lines += [f"  problem: {line}" for line in first_lines(self.problems)]
        return "\n".join(lines)
