"""Reads surfaces: legacy VTK polydata, ASCII or binary, and through trimesh whatever that reads.

Format: "VTK File Formats", The VTK User's Guide; cell arrays as of version 1 to 4 (a count before each polygon) and as of
version 5.1 (offsets and connectivity).
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError

Surface = tuple[NDArray[np.float64], NDArray[np.int64]]

# Binary files are big-endian.
_TYPES = {
    "float": ">f4",
    "double": ">f8",
    "char": ">i1",
    "unsigned_char": ">u1",
    "short": ">i2",
    "unsigned_short": ">u2",
    "int": ">i4",
    "unsigned_int": ">u4",
    "long": ">i8",
    "unsigned_long": ">u8",
    "vtkidtype": ">i8",
    "vtktypeint32": ">i4",
    "vtktypeint64": ">i8",
}
_CELLS = ("VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS")
_KEYWORD = re.compile(rb"\n(?=[A-Z]{4})")


def read_surface(path: Path) -> Surface:
    """Return the points ``(V, 3)``, in the file's units, and triangles ``(F, 3)`` of a surface.

    Args:
        path: ``.vtk`` (legacy polydata) or any mesh that trimesh reads, such as ``.ply``, ``.stl``, ``.obj``.

    Raises:
        InputError: when the file is missing, broken, of another kind, or holds no usable faces.
    """
    if not path.is_file():
        raise InputError("surface", f"there is no file {path}; expected a legacy .vtk or a mesh that trimesh reads")
    points, faces = read_vtk_polydata(path) if path.suffix.lower() == ".vtk" else _through_trimesh(path)
    if len(faces) == 0:
        raise InputError("surface", f"{path} has no faces; export it as a mesh of polygons, not as points or lines")
    if not np.isfinite(points).all():
        number = int(np.flatnonzero(~np.isfinite(points).all(axis=1))[0])
        found = f"point {number} is {points[number].tolist()}"
        raise InputError("surface", f"{path}: {found}, expected finite numbers; repair the mesh")
    return points, faces


def read_vtk_polydata(path: Path) -> Surface:
    """Return the points and the triangulated polygons of a legacy VTK file; its lines, vertices and data are left out.

    Raises:
        InputError: when it is not polydata, truncated, or refers to points that it does not hold.
    """
    return _Reader(path, path.read_bytes()).surface()


def _through_trimesh(path: Path) -> Surface:
    import trimesh

    try:
        mesh: Any = trimesh.load(path, force="mesh", process=False)
        points, faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64)
    except Exception as error:  # its loaders raise anything
        raise InputError(
            "surface",
            f"{path} cannot be read as a mesh ({error}); expected .vtk, .ply, .stl, .obj or another of trimesh's",
        ) from error
    return points.reshape(-1, 3), faces.reshape(-1, 3)


class _Reader:
    """A cursor in the bytes of a file."""

    def __init__(self, path: Path, data: bytes) -> None:
        self.path, self.data, self.place, self.binary = path, data, 0, False

    def surface(self) -> Surface:
        if not self._line().startswith("# vtk DataFile"):
            self._refuse("does not begin with '# vtk DataFile' as legacy VTK does; save it as legacy .vtk or .ply")
        self._line()  # a title
        kind, dataset = self._line().strip().upper(), self._words()
        if kind not in ("ASCII", "BINARY"):
            self._refuse(f"has {kind!r} in its third line, expected ASCII or BINARY")
        self.binary = kind == "BINARY"
        if [word.upper() for word in dataset] != ["DATASET", "POLYDATA"]:
            self._refuse(f"holds {' '.join(dataset)!r}, expected DATASET POLYDATA; extract its surface first")
        points, faces = np.empty((0, 3)), np.empty((0, 3), np.int64)
        while words := self._words():
            section = words[0].upper()
            if section == "POINTS":
                points = self._numbers(3 * self._count(words, 1), self._type(words, 2)).reshape(-1, 3).astype(float)
            elif section in _CELLS:
                polygons = self._cells(self._count(words, 1), self._count(words, 2))
                if section == "TRIANGLE_STRIPS":
                    self._refuse("holds TRIANGLE_STRIPS; turn them into triangles (vtkTriangleFilter) first")
                if section == "POLYGONS":
                    faces = _fans(*polygons)
            elif section == "METADATA":
                while self._line().strip():
                    pass
            else:  # attributes of points or cells: nothing of the shape follows
                break
        if len(faces) and not 0 <= faces.min() <= faces.max() < len(points):
            wrong = int(faces.max() if faces.max() >= len(points) else faces.min())
            self._refuse(f"has a polygon with point {wrong}, but only {len(points)} points; it is damaged")
        return points, faces

    def _cells(self, first: int, second: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return the offsets ``(n + 1,)`` of the cells and their points one after the other."""
        before = self.place
        words = self._words()
        if words and words[0].upper() == "OFFSETS":
            offsets = self._numbers(first, self._type(words, 1)).astype(np.int64)
            words = self._words()
            if not words or words[0].upper() != "CONNECTIVITY":
                self._refuse("has OFFSETS without CONNECTIVITY; it is truncated")
            return offsets, self._numbers(second, self._type(words, 1)).astype(np.int64)
        self.place = before
        numbers = self._numbers(second, ">i4").astype(np.int64)
        if first and len(numbers) == 4 * first and np.all(numbers[::4] == 3):
            return 3 * np.arange(first + 1), numbers.reshape(-1, 4)[:, 1:].ravel()
        starts, at = [], 0
        for _ in range(first):
            starts.append(at)
            at += 1 + int(numbers[at]) if at < len(numbers) and numbers[at] >= 0 else len(numbers) + 1
        if at != len(numbers):
            self._refuse(f"announces {first} cells in {second} numbers, which do not add up; it is damaged")
        starts = np.array([*starts, at])
        return starts - np.arange(first + 1), np.delete(numbers, starts[:-1])

    def _numbers(self, count: int, code: str) -> NDArray[np.generic]:
        if self.binary:
            size = count * np.dtype(code).itemsize
            block = self.data[self.place : self.place + size]
            if len(block) < size:
                self._refuse(f"ends after {len(block)} of {size} bytes of numbers; it is truncated")
            self.place += size
            return np.frombuffer(block, code)
        end = _KEYWORD.search(self.data, max(self.place - 1, 0))
        stop = end.start() if end else len(self.data)
        words = self.data[self.place : stop].split()
        self.place = stop
        if len(words) != count:
            ending = "it is truncated" if len(words) < count else "it is damaged"
            self._refuse(f"holds {len(words)} numbers where {count} are announced; {ending}")
        try:
            return np.array(words, dtype=np.bytes_).astype(np.float64 if "f" in code else np.int64)
        except ValueError as error:
            self._refuse(f"has text among its numbers ({error})", error)

    def _line(self) -> str:
        stop = self.data.find(b"\n", self.place)
        stop = len(self.data) if stop < 0 else stop
        line = self.data[self.place : stop]
        self.place = min(stop + 1, len(self.data))
        return line.decode("latin-1").rstrip("\r")

    def _words(self) -> list[str]:
        """Return the words of the next line that is not empty; none at the end."""
        while self.place < len(self.data):
            if words := self._line().split():
                return words
        return []

    def _count(self, words: list[str], place: int) -> int:
        if len(words) <= place or not words[place].isdigit():
            self._refuse(f"has the line {' '.join(words)[:60]!r}, expected {words[0]} and a number of items")
        return int(words[place])

    def _type(self, words: list[str], place: int) -> str:
        name = words[place].lower() if len(words) > place else ""
        if name not in _TYPES:
            self._refuse(f"has numbers of type {name!r}, expected one of {', '.join(_TYPES)}")
        return _TYPES[name]

    def _refuse(self, reason: str, cause: Exception | None = None) -> NoReturn:
        raise InputError("surface", f"{self.path} {reason}") from cause


def _fans(offsets: NDArray[np.int64], corners: NDArray[np.int64]) -> NDArray[np.int64]:
    """Cut polygons into triangles around their first corners."""
    sizes = np.diff(offsets)
    parts = [np.empty((0, 3), np.int64)]
    for size in np.unique(sizes[sizes >= 3]):
        polygons = corners[offsets[:-1][sizes == size][:, np.newaxis] + np.arange(size)]
        parts += [polygons[:, [0, side, side + 1]] for side in range(1, size - 1)]
    return np.concatenate(parts)
