"""Shards of a data set, made by several processes in one folder: whose a sample is, and who may do what at which time.

A process that is alone prepares the data set or seals it; those that make samples share it, each with lists of its own. Where
the file system, or a store, knows no locks, nobody is known to be alone: preparing twice gives the same bytes twice, and
only what is complete is sealed.
"""

from __future__ import annotations

import os
import re
import secrets
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from simulator.dataset.dataset_info import FILE
from simulator.dataset.manifest import MANIFEST, WRITERS, ManifestWriter
from simulator.dataset.sample import sample_id
from simulator.errors import InputError
from simulator.io.files import make_folder, remove_leftovers, sha256_bytes, storage_errors
from simulator.io.lines import open_locked
from simulator.io.store import Place


@dataclass(frozen=True)
class Shard:
    """One of ``count`` equal parts of a data set, from 0.

    Which part a sample belongs to follows from its split and id alone, so the number of parts may change between runs.
    """

    index: int
    count: int

    @classmethod
    def parsed(cls, text: str) -> Shard:
        """Return the shard that a text names.

        Raises:
            InputError: it names none.

        Example:
            >>> Shard.parsed("3/10")
            Shard(index=3, count=10)
        """
        match = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text)
        if match is None or int(match[1]) >= int(match[2]):
            raise InputError("--shard", f"got {text!r}, expected I/N with I from 0 to N - 1, such as 3/10")
        return cls(int(match[1]), int(match[2]))

    def holds(self, split: str, identifier: str) -> bool:
        """Whether a sample belongs to this shard."""
        return shard_of(split, identifier, self.count) == self.index

    def part(self, split: str, count: int) -> list[int]:
        """Return the numbers of those of a split's ``count`` samples that belong to this shard."""
        return [index for index in range(count) if self.holds(split, sample_id(index))]

    def __str__(self) -> str:
        return f"{self.index}/{self.count}"


def shard_of(split: str, identifier: str, count: int) -> int:
    """Return which of so many shards a sample belongs to: by its hash, so that each gets as many of every kind."""
    return int(sha256_bytes(f"{split}/{identifier}".encode())[:15], 16) % count


def array_expression(indices: list[int]) -> str:
    """Return numbers as SLURM's ``--array`` takes them.

    Example:
        >>> array_expression([3, 7, 8, 9, 12])
        '3,7-9,12'
    """
    runs: list[tuple[int, int]] = []
    for index in sorted(indices):
        if runs and index == runs[-1][1] + 1:
            runs[-1] = runs[-1][0], index
        else:
            runs.append((index, index))
    return ",".join(str(first) if first == last else f"{first}-{last}" for first, last in runs)


_LEVELS = 3  # below a data set's folder at which a writer may leave unfinished work: SPLIT/0000/.tmp-s00000000


@contextmanager
def alone(root: Place) -> Iterator[ManifestWriter | None]:
    """Give the data set's manifest to a process that is alone there; None where another one works.

    Raises:
        StorageError: the folder cannot be written to.
    """
    try:
        writer = ManifestWriter(root)
    except InputError as error:
        if error.path != str(root):
            raise
        yield None
        return
    with writer:
        yield writer


def remove_unfinished(manifest: ManifestWriter) -> None:
    """Remove what died writers left unfinished, where it is certain that nobody else is at work; in a store nobody knows."""
    if manifest.locked and isinstance(manifest.folder, Path):
        remove_leftovers(manifest.folder, _LEVELS)


@contextmanager
def sharing(root: Place, shard: Shard | None, say: Callable[[str], None]) -> Iterator[ManifestWriter | None]:
    """Give a manifest of its own to a process that makes samples while others may do the same.

    It waits for a process that is alone there; None where that has died before the data set had its description.

    Raises:
        StorageError: the folder cannot be written to.
    """
    name = "-".join([*([] if shard is None else [str(shard.index), "of", str(shard.count)]), secrets.token_hex(4)])
    own = root / WRITERS / name
    with ExitStack() as stack:
        if isinstance(root, Path):
            stack.callback(os.close, _shared_lock(root / MANIFEST, say))
        if not (root / FILE).exists():
            yield None
            return
        if isinstance(own, Path):
            with storage_errors(own):
                make_folder(own)
        yield stack.enter_context(ManifestWriter(own))


def _shared_lock(path: Path, say: Callable[[str], None]) -> int:
    try:
        return open_locked(path, shared=True)[0]
    except InputError as error:
        if error.path != str(path.parent):
            raise
    say(f"waiting for the run that is alone in {path.parent}: it prepares the data set, or was started without --shard")
    return open_locked(path, shared=True, wait=True)[0]
