"""Films and folders of numbered images as videos: what is held of them, how frames are read, and all of them read once."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.importers.inspection import Survey, frames_hint, sizes_text
from simulator.importers.listing import counting_fault, fault_of
from simulator.importers.video_decoding import MissingPackageError, count_decodable, index_film, read_film
from simulator.importers.videos import ClipPlan
from simulator.io.images import read_light

FILM_SUFFIXES = frozenset((".avi", ".m4v", ".mkv", ".mov", ".mp4", ".mpeg", ".mpg", ".ogv", ".ts", ".webm", ".wmv"))
"""Endings of films, by which they are found in folders; what a film really is, its contents say."""
IMAGE_SUFFIXES = frozenset((".bmp", ".exr", ".jpeg", ".jpg", ".png", ".tif", ".tiff", ".webp"))
"""Endings of images, by which they are found in folders."""


@dataclass(frozen=True)
class Film:
    """One film file as a :class:`simulator.importers.videos.Video`.

    Attributes:
        root: folder that ``name`` starts from.
        name: the file, relative to ``root``.
        frames: how many its packets promise.
        frames_per_second: of the film; the mean of a variable rate.
        matrix: see `simulator.importers.video_decoding.FilmIndex`.
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
        """Give frames of linear light, see `simulator.importers.video_decoding.read_film`."""
        return read_film(self.root / self.name, start, stop)

    def record(self, start: int, stop: int) -> dict[str, Any]:
        """Return how its colours were read, and what is special; name and frames stand in the clip's record."""
        varies: dict[str, Any] = {"variable_frame_rate": True} if self.variable else {}
        return {"colour_matrix": self.matrix, **varies}


@dataclass(frozen=True)
class ImageSequence:
    """Images of one size, one per frame, as a :class:`simulator.importers.videos.Video`.

    Attributes:
        root: folder that ``name`` starts from.
        name: their folder, relative to ``root``.
        images: their file names, in the order of showing.
    """

    root: Path
    name: str
    images: tuple[str, ...]
    packages: ClassVar[tuple[str, ...]] = ()

    @property
    def frames_per_second(self) -> None:
        """Images have no frame rate."""

    @property
    def label(self) -> None:
        """Images have no class."""

    @property
    def files(self) -> tuple[Path, ...]:
        """All images."""
        return tuple(self.root / self.name / image for image in self.images)

    def __len__(self) -> int:
        """Return how many images there are."""
        return len(self.images)

    def read(self, start: int, stop: int) -> Iterator[NDArray[np.float32]]:
        """Give images as linear light, see `simulator.io.images.read_light`."""
        return (read_light(path) for path in self.files[start:stop])

    def record(self, start: int, stop: int) -> dict[str, Any]:
        """Return the first and the last image's names."""
        return {"pictures": [self.images[start], self.images[stop - 1]]}


def open_films(root: Path, films: Iterable[tuple[str, str | None]]) -> tuple[list[Film], list[str]]:
    """Read the packets of films, given by their names below a folder and their labels; some at a time.

    Returns:
        The films that can be read, in order; and problems, ``"file: reason"``, with the others.

    Raises:
        MissingPackageError: when PyAV is not installed.
    """

    def try_open(entry: tuple[str, str | None]) -> Film | str:
        name, label = entry
        try:
            index = index_film(root / name)
        except MissingPackageError:
            raise
        except InputError as error:
            return f"{name}: {fault_of(error, root / name)[1]}"
        return Film(root, name, index.frames, index.frames_per_second, index.matrix, index.variable, label)

    opened: list[Film] = []
    problems: list[str] = []
    with ThreadPoolExecutor(min(8, os.cpu_count() or 1)) as pool:
        for film in pool.map(try_open, films):
            opened.append(film) if isinstance(film, Film) else problems.append(film)
    return opened, problems


@dataclass
class VideoSurvey:
    """What reading films and folders of images once has shown so far.

    Attributes:
        plan: clips to be cut, by which videos may be too short; None asks for no length.
        lengths: frames of every video that can be used.
        rates: their frame rates.
        sizes: all images' rows and columns.
        problems: lines ``"file: what is wrong and what to do"``.
        notes: lines about what is used all the same.
    """

    plan: ClipPlan | None
    lengths: list[int] = field(default_factory=list)
    rates: set[str] = field(default_factory=set)
    sizes: set[tuple[int, int]] = field(default_factory=set)
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def add_film(self, root: Path, name: str) -> bool:
        """Decode a film; return whether it can be used."""
        path = root / name
        try:
            index = index_film(path)
            frames, sizes = count_decodable(path)
        except MissingPackageError:
            raise
        except InputError as error:
            return self._problem(name, fault_of(error, path)[1])
        if frames < index.frames:
            reason = f"gives only {frames} of its {index.frames} frames: it is damaged, fetch or convert it again"
            return self._problem(name, reason)
        rate = f"{index.frames_per_second:.4g}"
        if index.variable:
            self.notes.append(f"{name}: its frame rate varies; frames are taken as evenly spaced, {rate} per second")
        if not index.square_pixels:
            self.notes.append(f"{name}: its pixels are not square, but are taken as if they were")
        return self._video(name, index.frames, sizes, {rate})

    def add_images(self, root: Path, name: str, images: tuple[str, ...]) -> bool:
        """Read a folder of images; return whether it can be used."""
        if fault := counting_fault(images):
            return self._problem(name, fault)
        sizes: set[tuple[int, int]] = set()
        for image in images:
            path = root / name / image
            try:
                rows, columns, _ = read_light(path).shape
            except InputError as error:
                return self._problem(path.relative_to(root).as_posix(), fault_of(error, path)[1])
            sizes.add((rows, columns))
        return self._video(name, len(images), sizes, set())

    def result(self, importer: str, path: Path, facts: Mapping[str, str], needed: tuple[str, ...] = ()) -> Survey:
        """Return the survey, with facts of the importer's own first."""
        found = dict(facts)
        if self.lengths:
            found["frames"] = f"{sum(self.lengths)} ({min(self.lengths)} to {max(self.lengths)} per video)"
            found["sizes"] = sizes_text(self.sizes)
            if self.rates:
                found["frames per second"] = ", ".join(sorted(self.rates, key=float))
        return Survey(
            importer,
            path,
            len(self.lengths),
            found,
            tuple(self.problems),
            tuple(self.notes),
            needed,
            hints=frames_hint(self.lengths),
        )

    def _video(self, name: str, frames: int, sizes: set[tuple[int, int]], rates: set[str]) -> bool:
        if len(sizes) > 1:
            return self._problem(name, f"changes its size ({sizes_text(sizes)} pixels): split it where that happens")
        if self.plan is not None and (fault := self.plan.fault(frames)):
            return self._problem(name, fault)
        self.lengths.append(frames)
        self.sizes |= sizes
        self.rates |= rates
        return True

    def _problem(self, name: str, reason: str) -> bool:
        self.problems.append(f"{name}: {reason}")
        return False
