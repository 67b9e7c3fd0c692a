"""Films and numbered pictures as videos: what is held of them, and how their frames are read."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.importers.extra import MissingPackageError
from simulator.importers.films.av import index_film, read_film
from simulator.io.images import read_light

FILM_SUFFIXES = frozenset((".avi", ".m4v", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".ogv", ".ts", ".webm", ".wmv"))
"""Endings of films, by which they are found in folders; what a film really is, its contents say."""
PICTURE_SUFFIXES = frozenset((".bmp", ".exr", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp"))
"""Endings of pictures, by which they are found in folders."""


@dataclass(frozen=True)
class Film:
    """One film file as a video.

    Attributes:
        root: folder that ``name`` starts from.
        name: the file, relative to ``root``.
        frames: how many its packets promise.
        frames_per_second: of the film; the mean of a variable rate.
        matrix: see `simulator.importers.films.av.FilmIndex`.
        variable: its frames are not evenly spaced, but are taken as if they were.
        label: its class, or None.
    """

    root: Path
    name: str
    frames: int
    frames_per_second: float
    matrix: str
    variable: bool = False
    label: str | None = None
    packages: ClassVar[tuple[str, ...]] = ("av",)

    @property
    def files(self) -> tuple[Path, ...]:
        """The file."""
        return (self.root / self.name,)

    def __len__(self) -> int:
        """Return how many frames its packets promise."""
        return self.frames

    def read(self, start: int, stop: int) -> Iterator[NDArray[np.float32]]:
        """Give frames of linear light, see `simulator.importers.films.av.read_film`."""
        return read_film(self.root / self.name, start, stop)

    def record(self, start: int, stop: int) -> dict[str, Any]:
        """Return how its colours were read, and what is special; name and frames stand in the clip's record."""
        varies: dict[str, Any] = {"variable_frame_rate": True} if self.variable else {}
        return {"colour_matrix": self.matrix, **varies}


@dataclass(frozen=True)
class PictureSequence:
    """Pictures of one size, one per frame, as a video.

    Attributes:
        root: folder that ``name`` starts from.
        name: their folder, relative to ``root``.
        pictures: their file names, in the order of showing.
        label: their class, or None.
    """

    root: Path
    name: str
    pictures: tuple[str, ...]
    label: str | None = None
    packages: ClassVar[tuple[str, ...]] = ()

    @property
    def frames_per_second(self) -> None:
        """Pictures have no rate of their own."""

    @property
    def files(self) -> tuple[Path, ...]:
        """All pictures."""
        return tuple(self.root / self.name / picture for picture in self.pictures)

    def __len__(self) -> int:
        """Return how many pictures there are."""
        return len(self.pictures)

    def read(self, start: int, stop: int) -> Iterator[NDArray[np.float32]]:
        """Give pictures as linear light, see `simulator.io.images.read_light`."""
        return (read_light(path) for path in self.files[start:stop])

    def record(self, start: int, stop: int) -> dict[str, Any]:
        """Return the first and the last picture's names."""
        return {"pictures": [self.pictures[start], self.pictures[stop - 1]]}


def open_films(root: Path, films: Iterable[tuple[str, str | None]]) -> tuple[list[Film], list[str]]:
    """Read the packets of films, some at a time.

    Args:
        root: folder that the names start from.
        films: their names and labels.

    Returns:
        The films that can be read, in order; and problems, ``"file: reason"``, with the others.
    """

    def try_open(entry: tuple[str, str | None]) -> Film | str:
        name, label = entry
        try:
            index = index_film(root / name)
        except MissingPackageError:
            raise
        except InputError as error:
            return f"{name}: {str(error).removeprefix(str(root / name)).lstrip(': ')}"
        return Film(root, name, index.frames, index.frames_per_second, index.matrix, index.variable, label)

    opened: list[Film] = []
    problems: list[str] = []
    with ThreadPoolExecutor(min(8, os.cpu_count() or 1)) as pool:
        for film in pool.map(try_open, films):
            opened.append(film) if isinstance(film, Film) else problems.append(film)
    return opened, problems
