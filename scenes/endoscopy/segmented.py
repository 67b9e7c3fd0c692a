"""A segmented organ as a wall to look into: its surface, and the line along its middle on which the camera goes."""

from __future__ import annotations

import functools
import json
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d
from scipy.spatial import KDTree

from scenes.endoscopy.endoscope import Pose, clears, draw_poses, first_hits
from scenes.endoscopy.organs import Course, Wall
from scenes.endoscopy.vtk_polydata import read_surface
from scenes.meshes import smooth_normals, unit
from simulator.errors import InputError
from simulator.types import View

Array = NDArray[np.float64]

_STEP_M = 1.5e-3
_SMOOTH_M = 5e-3  # paths step from voxel to voxel
_SHORTEST_M = 0.03
_WIDEST_M = 0.1
_TRIES = 60
_LOOSE_M = 4e-3
_TILT_RAD = math.radians(20)


@dataclass(frozen=True)
class Segment:
    """A surface around a path.

    Attributes:
        wall: the surface; faces and normals look towards the path, which is its course.
        back: the same course the other way.
        first_m: where along the course the surface begins.
        last_m: where it ends.
        file: where it came from, for messages.
    """

    wall: Wall
    back: Course
    first_m: float
    last_m: float
    file: Path


def read_segment(surface: Path, path: Path, voxel_size_mm: tuple[float, float, float]) -> Segment:
    """Return a surface (see `read_surface`) and the path along it, metres; read once per process unless a file changes.

    The path is JSON ``{"points": [[x, y, z], ...]}`` in the surface's units, of ``voxel_size_mm`` millimetres along x, y, z.

    Raises:
        InputError: when a file is missing or broken, or the path does not run along the surface.
    """
    for name, file in (("surface", surface), ("path", path)):
        if not file.is_file():
            raise InputError(name, f"there is no file {file}; a relative path starts at the YAML file's folder")
    states = tuple(file.stat().st_mtime_ns for file in (surface, path))
    return _read_version(surface, path, tuple(voxel_size_mm), states)


@functools.lru_cache(maxsize=4)
def _read_version(surface: Path, path: Path, voxel_size_mm: tuple[float, ...], _states: tuple[int, ...]) -> Segment:
    scale = 1e-3 * np.array(voxel_size_mm)
    points, faces = read_surface(surface)
    points = points * scale
    course = course_of(_read_path(path) * scale)
    away, node = KDTree(course.points_m).query(points)
    node = np.asarray(node, np.int64)
    first, last = (float(arc) for arc in np.percentile(course.start_m + course.step_m * node, (1, 99)))
    width = 2 * float(np.median(away))
    if not (width < _WIDEST_M and last - first > _SHORTEST_M):
        raise InputError(
            "path",
            f"{path} does not run along {surface}: {100 * (last - first):.3g} cm of it lie in a lumen "
            f"{100 * width:.3g} cm wide, expected over {100 * _SHORTEST_M:.3g} cm in one under {100 * _WIDEST_M:.3g} cm; "
            "check that both are in the same units, and voxel_size_mm",
        )
    faces = _inwards(points, faces, course.points_m[node])
    normals = smooth_normals(points, faces)
    uv = _unrolled(points, node, course, tile_m=0.5 * math.pi * width, tiles_around=2)
    wall = _cut_open(Wall(course, points, normals, uv, faces), tiles_around=2)
    return Segment(wall, _reversed(course), first, last, surface)


def find_shot(
    view: View, segment: Segment, travel_m: Array, seconds: Array, rng: np.random.Generator
) -> tuple[Wall, list[Pose]]:
    """Draw poses on the way through a segment at which the wall in view lies within near..far; return what is ahead of them.

    ``travel_m`` and ``seconds`` are those of `scenes.endoscopy.draw_shot`.

    Raises:
        InputError: when no pose is found.
    """
    wall = segment.wall
    for attempt in range(_TRIES):
        bend = max(0.0, 1 - attempt / (0.8 * _TRIES))
        start, backwards = rng.uniform(segment.first_m, segment.last_m), bool(rng.random() < 0.5)
        course = segment.back if backwards else wall.course
        arcs = (-start if backwards else start) + travel_m
        poses = draw_poses(course, arcs, seconds, _LOOSE_M, _TILT_RAD, bend, rng)
        if not all(_encloses(view, pose, wall) for pose in poses[:: max(1, len(poses) - 1)]):
            continue
        if all(clears(view, pose.seen(wall.vertices_m)) for pose in poses):
            return _ahead(view, wall, poses), poses
    raise InputError(
        "surface",
        f"in {segment.file} no place was found in {_TRIES} tries from which all the wall in view lies between near "
        f"{100 * view.near_m:.3g} cm and far {100 * view.far_m:.3g} cm; set scene.near_cm to 0.5 and scene.far_cm to 15, "
        "or use a wider or longer piece",
    )


def _encloses(view: View, pose: Pose, wall: Wall) -> bool:
    """Whether there is wall in every part of the image, nearer than far."""
    seen = first_hits(view, pose.seen(wall.vertices_m), wall.faces)
    return seen.missed == 0 and bool(seen.points_m[:, 2].max() < 0.9 * view.far_m)


def _ahead(view: View, wall: Wall, poses: list[Pose]) -> Wall:
    """Leave out the faces that are behind the camera or far beyond the view in all of the poses."""
    kept = np.zeros(len(wall.faces), bool)
    for pose in (poses[0], poses[len(poses) // 2], poses[-1]):
        points = pose.seen(wall.vertices_m)
        near = (points[:, 2] > 0) & (np.linalg.norm(points, axis=1) < 1.2 * view.far_m)
        kept |= near[wall.faces].any(axis=1)
    used, faces = np.unique(wall.faces[kept], return_inverse=True)
    return Wall(wall.course, wall.vertices_m[used], wall.normals[used], wall.uv[used], faces.reshape(-1, 3))


def course_of(points_m: Array) -> Course:
    """Return a line through points ``(n, 3)`` as a course: evenly stepped, smoothed over 5 mm, frames without twist."""
    steps = np.linalg.norm(np.diff(points_m, axis=0), axis=1)
    points_m = points_m[np.concatenate([[True], steps > 0])]
    arc = np.concatenate([[0.0], np.cumsum(steps[steps > 0])])
    nodes = np.linspace(0, arc[-1], max(2, math.ceil(arc[-1] / _STEP_M)))
    line = np.stack([np.interp(nodes, arc, points_m[:, axis]) for axis in range(3)], axis=1)
    line = gaussian_filter1d(line, _SMOOTH_M / _STEP_M, axis=0, mode="nearest")
    tangents = unit(np.gradient(line, axis=0))
    frames = np.empty((len(line), 3, 3))
    across = np.eye(3)[np.argmin(np.abs(tangents[0]))]
    for number, tangent in enumerate(tangents):
        across = across - (across @ tangent) * tangent
        across = across / math.sqrt(across @ across)
        frames[number] = across, np.cross(tangent, across), tangent
    return Course(0.0, float(nodes[1] - nodes[0]), line, frames)


def _reversed(course: Course) -> Course:
    turned = course.frames[::-1] * np.array([1.0, -1.0, -1.0])[:, np.newaxis]
    return Course(-course.end_m, course.step_m, course.points_m[::-1], turned)


def _read_path(path: Path) -> Array:
    try:
        points = np.asarray(json.loads(path.read_text(encoding="utf-8"))["points"], dtype=float)
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        expected = '{"points": [[x, y, z], ...]} in JSON'
        raise InputError("path", f"{path}: expected {expected}, got {type(error).__name__}: {error}") from error
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 2 or not np.isfinite(points).all():
        raise InputError("path", f"{path}: got points {points.shape}, expected at least two of three finite numbers")
    return points


def _inwards(points: Array, faces: NDArray[np.int64], middle: Array) -> NDArray[np.int64]:
    """Turn the faces towards the middle: neighbours alike where they are not, then all of them together."""
    import trimesh

    mesh = trimesh.Trimesh(points, faces, process=False)
    if not mesh.is_winding_consistent:
        trimesh.repair.fix_winding(mesh)
        faces = np.asarray(mesh.faces, np.int64)
    corners = points[faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    towards = (middle[faces] - corners).mean(axis=1)
    return faces if np.einsum("ij,ij->", cross, unit(towards)) > 0 else faces[:, ::-1]


def _unrolled(points: Array, node: NDArray[np.int64], course: Course, *, tile_m: float, tiles_around: int) -> Array:
    """Return texture coordinates around and along the course."""
    local = np.einsum("nij,nj->ni", course.frames[node], points - course.points_m[node])
    around = np.arctan2(local[:, 1], local[:, 0]) / (2 * math.pi) * tiles_around
    along = (course.step_m * node + local[:, 2]) / tile_m
    return np.stack([around, along], axis=1)


def _cut_open(wall: Wall, tiles_around: int) -> Wall:
    """Give faces across the seam, where the coordinate around jumps by a whole turn, vertices of their own beyond it."""
    around = wall.uv[wall.faces, 0]
    across = np.ptp(around, axis=1) > 0.5 * tiles_around
    low = across[:, np.newaxis] & (around < 0)
    doubled, again = np.unique(wall.faces[low], return_inverse=True)
    faces = wall.faces.copy()
    faces[low] = len(wall.vertices_m) + again.ravel()
    return Wall(
        wall.course,
        np.concatenate([wall.vertices_m, wall.vertices_m[doubled]]),
        np.concatenate([wall.normals, wall.normals[doubled]]),
        np.concatenate([wall.uv, wall.uv[doubled] + (tiles_around, 0)]),
        faces,
    )
