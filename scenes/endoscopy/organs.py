"""Colon, small intestine and stomach: walls of anatomical size, swept along a winding centreline, with their own folds.

Lengths are metres. Arc length 0 is where the camera starts; the wall is open behind it and closes at its far end. Faces and
normals look inwards. Texture coordinates run once per ``tile_m`` along the wall, and whole numbers of times around it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from scenes.meshes import grid_faces, unit
from scenes.textures import clouds

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

    It runs from the arc length ``start_m``, not positive, to ``end_m``; its least radius of curvature ``tightest_m`` is
    above the organ's own radius, so that the wall never crosses itself. ``bend`` 0 is straight along z, 1 the liveliest.
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
    """Sweep a wall around a centreline, from the arc length and the distance of each of its points, both ``(R, C)``.

    Arc lengths increase from row to row; column c lies at the angle 2 pi c / C. One texture covers ``tile_m`` along the wall.
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
        grid_faces(rows, columns + 1)[:, ::-1],  # counter-clockwise seen from inside
    )


def closing(arc_m: Array, end_m: float, cap_m: float) -> Array:
    """Return the factor by which a wall that ends at ``end_m`` shrinks to nothing over ``cap_m``, as an ellipsoid does."""
    return np.sqrt(np.clip(1 - ((np.clip(arc_m, end_m - cap_m, end_m) - end_m + cap_m) / cap_m) ** 2, 0, 1))


def relief(arc_m: Array, period_m: float, rng: np.random.Generator, *, fine: bool = False) -> Array:
    """Return bumps in -0.5..0.5 for the points ``(R, C)`` of a wall: clouds that repeat after ``period_m`` and a turn.

    Fine ones are small and all alike, the others large with small ones on them.
    """
    rows = arc_m[:, 0] / period_m * _RELIEF_SIZE + rng.uniform(0, _RELIEF_SIZE)
    columns = np.arange(arc_m.shape[1]) / arc_m.shape[1] * _RELIEF_SIZE + rng.uniform(0, _RELIEF_SIZE)
    places = np.meshgrid(rows, columns, indexing="ij")
    return map_coordinates(_clouds(0.7 if fine else 1.6), places, order=1, mode="grid-wrap")


@functools.cache
def _clouds(slope: float) -> Array:
    return clouds(_RELIEF_SIZE, np.random.default_rng(_RELIEF_SEED), slope=slope) - 0.5


BEHIND_M = -2e-3
"""Where walls begin: the lamps of an endoscope shine forwards, so what lies behind its tip takes no part in the light."""


@dataclass(frozen=True)
class Organ:
    """A hollow organ.

    Attributes:
        draw: ``draw(reach_m, bend, rng)`` returns a wall whose lumen is ``reach_m`` long from arc length 0; ``bend`` is that
            of `scenes.endoscopy.organs.draw_course`. A straight one holds all its wall within ``reach_m``.
        narrowest_m: the wall of a straight one comes no nearer to the centreline, before its end closes.
        loose_m: how far from the centreline the camera may be.
        shortest_m: least length of lumen that shows what the organ is.
        longest_m: how far light and bends let one see.
    """

    draw: Callable[[float, float, np.random.Generator], Wall]
    narrowest_m: float
    loose_m: float
    shortest_m: float
    longest_m: float


def draw_colon(reach_m: float, bend: float, rng: np.random.Generator) -> Wall:
    """Draw a colon, 3.4 to 5.4 cm wide, with haustra.

    Its three taeniae hold the wall in; between them semilunar folds reach up to two fifths of the radius into the lumen,
    each third of a fold with a height and place of its own, so that the opening is a triangle with corners at the taeniae.
    """
    radius = rng.uniform(0.017, 0.027)
    course = draw_course(BEHIND_M, reach_m, 1.5 * radius, bend, rng)
    folds = _places(BEHIND_M, reach_m, radius * rng.uniform(0.6, 1.05), 0.2, rng)
    fold, arc, follows = fold_rows(folds, 12)
    columns = 72
    angle = 2 * math.pi * np.arange(columns) / columns
    taenia = rng.uniform(0, 2 * math.pi)
    third = ((angle - taenia) / (2 * math.pi / 3)).astype(int) % 3
    between = np.abs(np.sin(1.5 * (angle - taenia)))  # 0 at a taenia, 1 midway to the next
    deepest = radius * rng.uniform(0.25, 0.4)
    size = deepest * np.where(rng.random((len(folds), 3)) < 0.12, 0.2, rng.uniform(0.55, 1, (len(folds), 3)))
    height = size[:, third] * between**0.8
    shift = (np.gradient(folds)[:, np.newaxis] * rng.uniform(-0.22, 0.22, (len(folds), 3)))[:, third] * between**0.5
    ridge = _ridge(arc - folds[fold], rng.uniform(0.0025, 0.0038))
    inwards = height[fold] * ridge[:, np.newaxis]
    place = arc[:, np.newaxis] + shift[fold] * follows[:, np.newaxis] + rng.uniform(-0.4, 0.4) * inwards
    swell = 1 + 0.06 * np.sin(2 * math.pi * arc / rng.uniform(0.05, 0.12) + rng.uniform(0, 6))
    lobes = 1 - 0.05 * np.cos(3 * (angle - taenia))
    inwards = inwards + 0.0016 * relief(place, 0.11, rng) + _wet(place, 0.0005, rng) + _polyp(arc, angle, radius, rng)
    outline = radius * swell[:, np.newaxis] * lobes - inwards
    return _swept(course, place, outline, radius, tile_m=math.pi * radius, tiles_around=2)


def draw_small_intestine(reach_m: float, bend: float, rng: np.random.Generator) -> Wall:
    """Draw a stretched small intestine, 2.4 to 3 cm wide, with circular folds (plicae) every 5 to 8 mm."""
    radius = rng.uniform(0.012, 0.015)
    course = draw_course(BEHIND_M, reach_m, 1.6 * radius, bend, rng)
    folds = _places(BEHIND_M, reach_m, rng.uniform(0.005, 0.008), 0.15, rng)
    fold, arc, follows = fold_rows(folds, 7)
    columns = 52
    angle = 2 * math.pi * np.arange(columns) / columns
    count = (len(folds), 1)
    turns = [np.cos(waves * angle + rng.uniform(0, 2 * math.pi, count)) for waves in (1, 2, 3, 5)]
    # Few plicae go all the way around: each fades where it ends.
    height = rng.uniform(0.0024, 0.0038) * np.clip(0.75 + 0.45 * turns[0] + 0.3 * turns[1] + 0.2 * turns[3], 0.05, 1)
    shift = rng.uniform(0.08, 0.16) * np.gradient(folds)[:, np.newaxis] * (turns[1] + turns[2] + 0.5 * turns[3])
    ridge = _ridge(arc - folds[fold], rng.uniform(0.0009, 0.0013))
    inwards = height[fold] * ridge[:, np.newaxis]
    place = arc[:, np.newaxis] + shift[fold] * follows[:, np.newaxis] + rng.uniform(-0.5, 0.5) * inwards
    swell = 1 + 0.06 * np.sin(2 * math.pi * arc / rng.uniform(0.03, 0.08) + rng.uniform(0, 6))
    inwards = inwards + 0.0006 * relief(place, 0.05, rng) + _wet(place, 0.0003, rng)
    return _swept(
        course, place, radius * swell[:, np.newaxis] - inwards, radius, tile_m=2 * math.pi * radius, tiles_around=1
    )


def draw_stomach(reach_m: float, bend: float, rng: np.random.Generator) -> Wall:
    """Draw a stomach, 6 to 9 cm wide, with rugae: thick folds that wind along it, fork, and fade towards the antrum."""
    widest = min(rng.uniform(0.03, 0.045), 0.45 * reach_m)
    course = draw_course(BEHIND_M, reach_m, 1.35 * widest, bend, rng)
    columns = 132
    arc = np.linspace(BEHIND_M, reach_m, math.ceil((reach_m - BEHIND_M) / 0.0022))
    angle = 2 * math.pi * np.arange(columns) / columns
    place = np.repeat(arc[:, np.newaxis], columns, axis=1)
    along = (arc / reach_m)[:, np.newaxis]
    count = round(2 * math.pi * widest / rng.uniform(0.010, 0.014))
    bends = sum(
        rng.uniform(0.4, 1.0) * np.sin(2 * math.pi * place / rng.uniform(0.02, 0.06) + waves * angle + phase)
        for waves, phase in zip((1, 2, 3), rng.uniform(0, 2 * math.pi, 3), strict=True)
    )
    rugae = [
        np.abs(np.sin(0.5 * (number * angle + bends + phase))) ** 0.8
        for number, phase in ((count, 0.0), (count - 4, 2))
    ]
    chosen = np.clip(
        0.5 + 3 * relief(place, 0.1, rng), 0, 1
    )  # where the one pattern gives way to the other, rugae fork
    strength = np.clip(1.3 - np.clip(along, 0, 1), 0, 1) * (0.8 + 0.8 * relief(place, 0.16, rng))
    height = rng.uniform(0.005, 0.010) * strength * (chosen * rugae[0] + (1 - chosen) * rugae[1])
    flat = 1 + rng.uniform(0.03, 0.1) * np.cos(2 * angle + rng.uniform(0, 6))
    body = 1 - rng.uniform(0.25, 0.5) * np.clip(along, 0, 1)
    outline = widest * body * flat - height - 0.004 * relief(place, 0.2, rng) - _wet(place, 0.0010, rng)
    return _swept(course, place, outline, widest, tile_m=2 * math.pi / 3 * widest, tiles_around=3)


ORGANS = {
    "colon": Organ(draw_colon, 0.0085, 0.006, 0.05, 0.12),
    "small_intestine": Organ(draw_small_intestine, 0.0070, 0.004, 0.04, 0.10),
    "stomach": Organ(draw_stomach, 0.0110, 0.016, 0.07, 0.12),
}
"""The organs by the name that becomes a clip's label."""


def _swept(course: Course, place: Array, outline: Array, radius: float, *, tile_m: float, tiles_around: int) -> Wall:
    end = course.end_m
    place = np.clip(place, course.start_m, end)
    place[-1] = end
    outline = np.maximum(outline, 0) * closing(place, end, min(1.3 * radius, 0.45 * end))
    return sweep(course, place, outline, tile_m=tile_m, tiles_around=tiles_around)


def _places(start_m: float, end_m: float, gap_m: float, jitter: float, rng: np.random.Generator) -> Array:
    """Return arc lengths about ``gap_m`` apart, at least 2."""
    count = max(2, round((end_m - start_m) / gap_m))
    gap = (end_m - start_m) / count
    return start_m + gap * (np.arange(count) + 0.5 + rng.uniform(-jitter, jitter, count))


def _wet(place: Array, height_m: float, rng: np.random.Generator) -> Array:
    """Return the fine unevenness that breaks the highlights on a wet wall into glints."""
    return height_m * rng.uniform(0.5, 1.3) * relief(place, 0.03, rng, fine=True)


def _ridge(away_m: Array, half_width_m: float) -> Array:
    """Return the height of a fold beside its crest, 1 at the crest: steeper and blunter than a Gaussian."""
    return np.exp(-(np.abs(away_m / half_width_m) ** 2.5))


def _polyp(arc: Array, angle: Array, radius: float, rng: np.random.Generator) -> Array:
    """Return the height of a polyp on the wall, 6 to 12 mm wide, in one colon of three; else of none."""
    size, centre, side = rng.uniform(0.003, 0.006), rng.uniform(0.02, 0.06), rng.uniform(0, 2 * math.pi)
    present = rng.random() < 1 / 3
    around = radius * ((angle - side + math.pi) % (2 * math.pi) - math.pi)
    away = ((arc - centre)[:, np.newaxis] ** 2 + around**2) / size**2
    return 1.2 * size * present * np.exp(-(away**1.5))
