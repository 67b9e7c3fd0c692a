"""How much room a data set takes, from its first samples, and whether the disk has it: known before it is full."""

from __future__ import annotations

import shutil
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from simulator.errors import InputError
from simulator.io.store import Place, StorePath, size_of
from simulator.text import size

ENOUGH = 2
"""Samples that are measured before a forecast is trusted: neighbours hardly differ in size."""
_MOST = 32  # samples that are measured


@dataclass(frozen=True)
class Facts:
    """What a job knows of its samples beside their number.

    Attributes:
        failed: samples that could not be made.
        bytes_made: size of the samples that this run made; None where it is not known.
        bytes_expected: the same for all that it is to make.
    """

    failed: int = 0
    bytes_made: float | None = None
    bytes_expected: float | None = None


class Forecast:
    """The size of samples, measured on the first ones.

    Attributes:
        measured: how many samples were.
    """

    def __init__(self, root: Place, left: int) -> None:
        """Begin for a run that is to make so many samples."""
        self._root, self._left = root, left
        self._bytes = self.measured = 0

    @property
    def bytes_per_sample(self) -> float | None:
        """Mean size of a sample; None before enough are measured."""
        return self._bytes / self.measured if self.measured >= ENOUGH else None

    def measure(self, folder: Place) -> None:
        """Look at a finished sample; after the first few there is nothing more to learn."""
        if self.measured < _MOST and not isinstance(folder, StorePath):
            sizes: list[int] = []  # of a folder that is gone, or that another shard writes anew, nothing is learned
            with suppress(FileNotFoundError):
                sizes = [size_of(path) for path in folder.rglob("*") if path.is_file()]
            self._bytes += sum(sizes)
            self.measured += bool(sizes)

    def refuse_too_large(self) -> None:
        """Refuse to go on where what is left does not fit on the disk; stores have room.

        Raises:
            InputError: naming both sizes.
        """
        each = self.bytes_per_sample
        if each is None or not isinstance(self._root, Path):
            return
        needed, free = self._left * each, shutil.disk_usage(self._root).free
        if needed > free:
            raise InputError(
                "dataset.output",
                f"{self._left} samples of {size(each)} need {size(needed)}, but {self._root} has {size(free)} left; free "
                "space, make fewer, choose another disk, or begin all the same: --ignore-space. What is made is kept",
            )
