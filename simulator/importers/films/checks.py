"""Looking through films and picture folders once, for `survey`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from simulator.errors import InputError
from simulator.importers.extra import MissingPackageError
from simulator.importers.films.av import count_decodable, index_film
from simulator.importers.films.numbering import counting_fault
from simulator.importers.films.video import ClipPlan
from simulator.importers.survey import Survey
from simulator.io.images import read_light


@dataclass
class FilmCheck:
    """What was found so far.

    Attributes:
        plan: clips to be cut, by which videos may be too short; None asks for no length.
        lengths: frames of every video that can be used.
        rates: their frame rates.
        sizes: all pictures' rows and columns.
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
            return self._problem(name, str(error).removeprefix(str(path)).lstrip(": "))
        if frames < index.frames:
            return self._problem(
                name, f"gives only {frames} of its {index.frames} frames: it is damaged, fetch or convert it again"
            )
        if index.variable:
            self.notes.append(
                f"{name}: its frame rate varies; frames are taken as evenly spaced, {index.frames_per_second:.4g} per second"
            )
        if not index.square_pixels:
            self.notes.append(f"{name}: its pixels are not square, but are taken as if they were")
        return self._video(name, index.frames, sizes, f"{index.frames_per_second:.4g}")

    def add_pictures(self, root: Path, name: str, pictures: tuple[str, ...]) -> bool:
        """Read a folder of pictures; return whether it can be used."""
        if fault := counting_fault(pictures):
            return self._problem(name, fault)
        sizes: set[tuple[int, int]] = set()
        for picture in pictures:
            try:
                rows, columns, _ = read_light(root / name / picture).shape
            except InputError as error:
                place = (Path(name) / picture).as_posix()
                return self._problem(place, str(error).removeprefix(str(root / name / picture)).lstrip(": "))
            sizes.add((rows, columns))
        return self._video(name, len(pictures), sizes, None)

    def result(self, importer: str, path: Path, facts: Mapping[str, str]) -> Survey:
        """Return the survey, with facts of the importer's own first."""
        found = dict(facts)
        if self.lengths:
            found["frames"] = f"{sum(self.lengths)} ({min(self.lengths)} to {max(self.lengths)} per video)"
            found["sizes"] = ", ".join(f"{rows} x {columns}" for rows, columns in sorted(self.sizes))
            if self.rates:
                found["frames per second"] = ", ".join(sorted(self.rates, key=float))
        return Survey(importer, path, len(self.lengths), found, tuple(self.problems), tuple(self.notes))

    def _video(self, name: str, frames: int, sizes: set[tuple[int, int]], rate: str | None) -> bool:
        if len(sizes) > 1:
            found = ", ".join(f"{rows} x {columns}" for rows, columns in sorted(sizes))
            return self._problem(name, f"changes its size ({found} pixels): split it where that happens")
        if self.plan is not None and frames < self.plan.needed:
            return self._problem(name, self.plan.too_short(frames))
        self.lengths.append(frames)
        self.sizes |= sizes
        self.rates |= set() if rate is None else {rate}
        return True

    def _problem(self, name: str, reason: str) -> bool:
        self.problems.append(f"{name}: {reason}")
        return False
