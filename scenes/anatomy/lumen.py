"""Hollow organs as swept surfaces: a winding centreline, and a wall around it with folds across or along it.

Lengths are metres. Arc length 0 is where the camera starts; the wall is open behind it and closes at its far end. Faces and
normals look inwards. Texture coordinates run once per ``tile_m`` along the wall, and whole numbers of times around it.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from scenes.patterns import clouds
from scenes.surfaces import grid_faces, unit

Array = NDArray[np.float64]

_NODE_M = 1.5e-3
_RELIEF_SEED = 20260103
_RELIEF_SIZE = 128


@dataclass(frozen=True)
class Course:
    """A centreline with a frame that does not twist about it (parallel transport).

    Attributes:
        start_m: arc length of the first node.
        points_m: ``(n, 3)`` nodes, evenly spaced by ``step_m``.
        frames: ``(n, 3, 3)`` rows: two unit vectors across, then the tangent; right-handed.
    """

    start_m: float
    step_m: float
    points_m: Array
    frames: Array

    @property
    def end_m(self) -> float:
        """Arc length of the last node."""
        return self.start_m + self.step_m * (len(self.points_m) - 1)

    def at(self, arc_m: Array) -> tuple[Array, Array]:
        """Return points ``(..., 3)`` and frames ``(..., 3, 3)`` at arc lengths; beyond the ends, those of the ends."""
        place = np.clip((np.asarray(arc_m) - self.start_m) / self.step_m, 0, len(self.points_m) - 1)
        below = np.minimum(place.astype(np.int64), len(self.points_m) - 2)
        share = (place - below)[..., np.newaxis]
        points = self.points_m[below] * (1 - share) + self.points_m[below + 1] * share
        tangent = unit(self.frames[below, 2] * (1 - share) + self.frames[below + 1, 2] * share)
        across = self.frames[below, 0] * (1 - share) + self.frames[below + 1, 0] * share
        across = unit(across - (across * tangent).sum(axis=-1, keepdims=True) * tangent)
        return points, np.stack([across, np.cross(tangent, across), tangent], axis=-2)


@dataclass(frozen=True)
class Wall:
    """The inner surface of an organ around its course, like a `simulator.render.TriangleMesh` without a material."""

    course: Course
    vertices_m: Array
    normals: Array
    uv: Array
    faces: NDArray[np.int64]


def draw_course(start_m: float, end_m: float, tightest_m: float, bend: float, rng: np.random.Generator) -> Course:
    """Draw a centreline from gentle random bends and one sharper turn (a flexure) in its farther half.

    Args:
        start_m: arc length of its beginning, not positive.
        end_m: arc length of its end.
        tightest_m: least radius of curvature; above the organ's own radius, so that the wall never crosses itself.
        bend: 0 is straight along z, 1 the liveliest.
        rng: decides everything.
    """
    nodes = math.ceil((end_m - start_m) / _NODE_M) + 1
    step = (end_m - start_m) / (nodes - 1)
    arc = start_m + step * np.arange(nodes)
    waves = 2 * math.pi * arc / rng.uniform(0.08, 0.25, (2, 1)) + rng.uniform(0, 2 * math.pi, (2, 1))
    curvature = rng.uniform(0.1, 0.5, (2, 1)) * np.sin(waves)
    turn, towards = rng.uniform(0.3, 1.7), rng.uniform(0, 2 * math.pi)
    width = turn * tightest_m / math.sqrt(math.pi)  # a Gaussian of peak 1 / tightest_m and this width turns by `turn`
    bump = np.exp(-(((arc - rng.uniform(0.5, 0.95) * end_m) / width) ** 2))
    curvature = curvature + bump * np.array([[math.cos(towards)], [math.sin(towards)]])
    size = np.hypot(*curvature)
    curvature = curvature * (bend / tightest_m / np.maximum(size, 1))
    return _integrated(start_m, step, curvature.T)


def _integrated(start_m: float, step_m: float, curvature: Array) -> Course:
    """Follow a curvature ``(n, 2)`` along the two vectors across, from the frame of the axes at arc length 0."""
    frames = np.empty((len(curvature), 3, 3))
    frame = np.eye(3)
    for node, (first, second) in enumerate(0.5 * step_m * (curvature + np.roll(curvature, 1, axis=0))):
        if node > 0:
            across, sideways, tangent = frame
            tangent = tangent + first * across + second * sideways
            tangent = tangent / math.sqrt(tangent @ tangent)
            across = across - (across @ tangent) * tangent
            across = across / math.sqrt(across @ across)
            frame = np.array([across, np.cross(tangent, across), tangent])
        frames[node] = frame
    middles = 0.5 * (frames[1:, 2] + frames[:-1, 2])
    points = np.concatenate([np.zeros((1, 3)), np.cumsum(step_m * unit(middles), axis=0)])
    course = Course(start_m, step_m, points, frames)
    origin, home = course.at(np.zeros(()))
    return Course(start_m, step_m, (points - origin) @ home.T, frames @ home.T)


def fold_rows(folds_m: Array, rows: int) -> tuple[NDArray[np.int64], Array, Array]:
    """Return rows of a wall that crowd around its folds, ``rows`` from the middle before a fold to the middle after it.

    Args:
        folds_m: ``(K,)`` increasing arc lengths of the folds' crests, K >= 2.
        rows: for each fold, at least 2.

    Returns:
        The fold that each row belongs to, its arc length, and how far it follows a shift of its crest: 1 at the crest, 0
        in the middle between folds; each ``(K rows,)``.
    """
    gaps = np.diff(folds_m)
    before, after = np.concatenate([gaps[:1], gaps]) / 2, np.concatenate([gaps, gaps[-1:]]) / 2
    side = np.linspace(-1, 1, rows, endpoint=False) + 1 / rows
    reach = np.abs(side) ** 1.7
    half = np.where(side < 0, -before[:, np.newaxis], after[:, np.newaxis])
    arc = folds_m[:, np.newaxis] + half * reach
    return np.repeat(np.arange(len(folds_m)), rows), arc.ravel(), np.tile(1 - reach, len(folds_m))


def sweep(course: Course, arc_m: Array, radius_m: Array, *, tile_m: float, tiles_around: int) -> Wall:
    """Sweep a wall around a course.

    Args:
        course: the centreline.
        arc_m: ``(R, C)`` arc length of each point of the wall, increasing from row to row.
        radius_m: ``(R, C)`` its distance from the centreline; column c lies at the angle 2 pi c / C.
        tile_m: length of wall that one texture covers.
        tiles_around: how many textures fit around.
    """
    rows, columns = arc_m.shape
    angle = 2 * math.pi * np.arange(columns) / columns
    middle, frame = course.at(arc_m)
    across = np.cos(angle)[:, np.newaxis] * frame[..., 0, :] + np.sin(angle)[:, np.newaxis] * frame[..., 1, :]
    points = middle + radius_m[..., np.newaxis] * across
    along = np.empty_like(points)
    along[1:-1] = points[2:] - points[:-2]
    along[0], along[-1] = points[1] - points[0], points[-1] - points[-2]
    around = np.roll(points, -1, axis=1) - np.roll(points, 1, axis=1)
    normals = unit(np.cross(along, around))
    closed = np.linalg.norm(around, axis=-1) < 1e-9  # the tip, where all columns meet
    normals[closed] = -frame[closed][:, 2]
    steps = np.linalg.norm(np.diff(points, axis=0), axis=-1).mean(axis=1)
    down = np.concatenate([[0.0], np.cumsum(steps)]) / tile_m
    turns = np.arange(columns + 1) / columns * tiles_around
    uv = np.stack(np.broadcast_arrays(turns, down[:, np.newaxis]), axis=-1)
    again = [*range(columns), 0]  # the last column is the first one with other texture coordinates
    return Wall(
        course,
        points[:, again].reshape(-1, 3),
        normals[:, again].reshape(-1, 3),
        uv.reshape(-1, 2),
        _wall_faces(rows, columns + 1),
    )


def closing(arc_m: Array, end_m: float, cap_m: float) -> Array:
    """Return the factor by which a wall's radius shrinks to nothing at its end, as an ellipsoid's does.

    Args:
        arc_m: arc lengths.
        end_m: where it is closed.
        cap_m: length over which it closes.
    """
    return np.sqrt(np.clip(1 - ((np.clip(arc_m, end_m - cap_m, end_m) - end_m + cap_m) / cap_m) ** 2, 0, 1))


def relief(arc_m: Array, period_m: float, rng: np.random.Generator, *, fine: bool = False) -> Array:
    """Return bumps in -0.5..0.5 for the points ``(R, C)`` of a wall: clouds that repeat after ``period_m`` and a turn.

    Args:
        arc_m: arc length of each point.
        period_m: length of wall after which they repeat.
        rng: decides where the clouds begin.
        fine: small bumps all alike, instead of large ones with small ones on them.
    """
    rows = arc_m[:, 0] / period_m * _RELIEF_SIZE + rng.uniform(0, _RELIEF_SIZE)
    columns = np.arange(arc_m.shape[1]) / arc_m.shape[1] * _RELIEF_SIZE + rng.uniform(0, _RELIEF_SIZE)
    places = np.meshgrid(rows, columns, indexing="ij")
    return map_coordinates(_clouds(0.7 if fine else 1.6), places, order=1, mode="grid-wrap")


@functools.cache
def _clouds(slope: float) -> Array:
    return clouds(_RELIEF_SIZE, np.random.default_rng(_RELIEF_SEED), slope=slope) - 0.5


def _wall_faces(rows: int, columns: int) -> NDArray[np.int64]:
    """Triangles that run counter-clockwise seen from inside."""
    return grid_faces(rows, columns)[:, ::-1]
