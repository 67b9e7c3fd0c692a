"""Figures of rigid links on joints, each drawn as one mesh: a chain, scissors, a runner, a bird, a claw.

A figure is a function of a phase in radians; its links are affine images of one round bar, so they stay rigid whatever
the joints do.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.meshes import UnitMesh, closed_surface, unit
from simulator.render import Material, TriangleMesh

Array = NDArray[np.float64]
_HINGE = (0.0, 0, 1)


@dataclass(frozen=True)
class Links:
    """Bars at one moment, in the figure's own axes (x ahead, y down, z to the side).

    Attributes:
        ends: ``(L, 2, 3)``: the joints that each bar joins.
        half_widths: ``(L, 2)``: across the bar, along ``sides`` and at right angles to it.
        sides: ``(L, 3)``: directions that no bar is parallel to, along which the first half width goes.
    """

    ends: Array
    half_widths: Array
    sides: Array


Pose = Callable[[float], Links]
"""A phase in radians to the links at that moment."""


@functools.cache
def _bar() -> UnitMesh:
    """Return a rounded bar along y, from -1 to 1, of radius 1; 56 faces."""
    along = np.array([-1, -0.9, -0.45, 0.45, 0.9, 1])
    width = np.array([0, 0.72, 1, 1, 0.72, 0])[:, np.newaxis]
    around = np.linspace(0, 2 * np.pi, 8)
    grid = np.broadcast_arrays(width * np.cos(around), along[:, np.newaxis], width * np.sin(around))
    mesh = closed_surface(np.stack(grid, axis=-1))
    scale = 1 / mesh.vertices[:, 1].max()
    return UnitMesh(mesh.vertices * scale, mesh.normals, mesh.uv, mesh.faces)


class Figure:
    """Links that move, scaled into the unit ball whatever their phase."""

    def __init__(self, pose: Pose) -> None:
        self._pose, self._middle, self._scale = pose, np.zeros(3), 1.0
        phases = np.linspace(0, 2 * np.pi, 16, endpoint=False)
        points = np.concatenate([self._points(float(phase))[0] for phase in phases])
        self._middle = (points.min(axis=0) + points.max(axis=0)) / 2
        # Between two of the phases a joint may get a little farther.
        self._scale = 0.97 / float(np.linalg.norm(points - self._middle, axis=1).max())
        self.lowest = self._scale * float(points[:, 1].max() - self._middle[1])
        """How far below the figure's origin its lowest point gets, at size 1."""
        count, bar = len(pose(0.0).ends), _bar()
        self._faces = np.concatenate([bar.faces + len(bar.vertices) * link for link in range(count)])
        # Each link shows another part of the texture.
        self._uv = np.concatenate([bar.uv * (1, 0.5) + (0.37 * link, 0.23 * link) for link in range(count)])

    def joints(self, phase: float) -> Array:
        """Return the ends of the links ``(L, 2, 3)`` at a phase, at size 1."""
        return (self._pose(phase).ends - self._middle) * self._scale

    def placed(self, phase: float, material: Material, centre_m: ArrayLike, size_m: float, turn: Array) -> TriangleMesh:
        """Return the figure at a phase as a thing of a scene; the other arguments are those of `scenes.meshes.placed`."""
        points, normals = self._points(phase)
        return TriangleMesh(
            vertices_m=np.asarray(centre_m) + size_m * points @ turn.T,
            normals=normals @ turn.T,
            uv=self._uv,
            faces=self._faces,
            material=material,
        )

    def _points(self, phase: float) -> tuple[Array, Array]:
        """Return vertices and normals ``(V, 3)`` at size 1."""
        links, bar = self._pose(phase), _bar()
        ends = (links.ends - self._middle) * self._scale
        axis = unit(ends[:, 1] - ends[:, 0])
        side = unit(links.sides - np.sum(links.sides * axis, axis=1, keepdims=True) * axis)
        frame = np.stack([side, axis, np.cross(side, axis)], axis=1)
        widths = links.half_widths * self._scale
        # Bars overlap at their joints, so that no gap opens on the outside of a bend.
        length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / 2 + 0.5 * widths.min(axis=1)
        scale = np.stack([widths[:, 0], length, widths[:, 1]], axis=1)[:, np.newaxis]
        points = ends.mean(axis=1)[:, np.newaxis] + (bar.vertices * scale) @ frame
        return points.reshape(-1, 3), unit((bar.normals / scale) @ frame).reshape(-1, 3)


def draw_figure(kind: str, rng: np.random.Generator) -> Figure:
    """Draw a figure of a kind of `FIGURES`."""
    return Figure(_POSES[kind](rng))


def _swing(angle: ArrayLike) -> Array:
    """Return directions in the plane of x and y: 0 hangs down, positive angles lead ahead."""
    return np.stack([np.sin(angle), np.cos(angle), np.zeros_like(angle)], axis=-1)


def _path(start: ArrayLike, angles: Array, lengths: Array) -> Array:
    """Return the ends ``(n, 2, 3)`` of bars that hang on each other, from a point on, each at its angle."""
    steps = _swing(angles) * lengths[:, np.newaxis]
    joints = np.asarray(start, dtype=float) + np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
    return np.stack([joints[:-1], joints[1:]], axis=1)


def _chain(rng: np.random.Generator) -> Pose:
    """Return a whip of bars: a wave of bending runs down it and grows."""
    count = int(rng.integers(4, 9))
    place = np.arange(count) / (count - 1)
    lengths = np.full(count, 1.0)
    swing, lag = rng.uniform(0.5, 1.1), rng.uniform(0.8, 3.0)
    half_widths = np.tile(rng.uniform(0.25, 0.45) * np.array([1.0, rng.uniform(0.6, 1)]), (count, 1))
    half_widths *= np.linspace(1, rng.uniform(0.5, 1), count)[:, np.newaxis]
    sides = np.tile(_HINGE, (count, 1))

    def pose(phase: float) -> Links:
        angles = swing * (0.4 + 0.9 * place) * np.sin(phase - lag * place)
        return Links(_path((0, 0, 0), angles, lengths), half_widths, sides)

    return pose


def _scissors(rng: np.random.Generator) -> Pose:
    """Return two crossed blades with a loop for a finger each, that snip."""
    blade, shank, loop = 1.5, rng.uniform(0.4, 0.7), rng.uniform(0.28, 0.36)
    widest = rng.uniform(0.4, 0.65)
    around = np.linspace(0, 2 * np.pi, 6)
    ring = loop * np.stack([np.sin(around), 1 - np.cos(around), np.zeros(6)], axis=1)
    half = np.array([(0.07, 0.17), (0.07, 0.12)] + [(0.08, 0.1)] * 5)
    sides = np.tile(_HINGE, (14, 1))

    def one(opening: float, layer: float) -> Array:
        tip = -blade * _swing(np.array(opening))
        end = shank * _swing(np.array(opening))
        along, across = _swing(np.array(opening)), _swing(np.array(opening - np.pi / 2))
        handle = end + ring[:, 1:2] * along + (ring[:, :1] + np.sign(opening) * 0.5 * loop) * across
        bars = [(tip, np.zeros(3)), (np.zeros(3), end), *pairwise(handle)]
        return np.array(bars) + np.array((0, 0, layer))

    def pose(phase: float) -> Links:
        opening = 0.08 + widest * 0.5 * (1 + np.sin(phase))
        return Links(np.concatenate([one(opening, 0.07), one(-opening, -0.07)]), np.concatenate([half, half]), sides)

    return pose


def _runner(rng: np.random.Generator) -> Pose:
    """Return a figure that runs ahead, in the manner of a stick man with round limbs."""
    stride, knee, lean = rng.uniform(0.55, 0.85), rng.uniform(0.6, 1.1), rng.uniform(0.05, 0.3)
    stout = rng.uniform(1.1, 1.7)
    half = stout * np.array(
        [
            (0.2, 0.15),
            (0.17, 0.19),
            *[(0.1, 0.1), (0.075, 0.075), (0.06, 0.06)] * 2,
            *[(0.065, 0.065), (0.05, 0.05)] * 2,
        ]
    )
    sides = np.tile(_HINGE, (len(half), 1))

    def pose(phase: float) -> Links:
        hip = np.array([0, -0.03 * np.cos(2 * phase), 0])
        up = np.pi - lean  # the trunk points up and ahead
        neck = hip + 0.62 * _swing(np.array(up))
        crown = neck + 0.36 * _swing(np.array(up + 0.1))
        parts = [np.array([(hip, neck)]), np.array([(neck + 0.3 * (crown - neck), crown)])]
        for side, at in ((0.1, phase), (-0.1, phase + np.pi)):
            thigh = stride * np.sin(at) + 0.15
            shin = thigh - knee * (0.55 + 0.45 * np.cos(at))  # bent most while the leg comes ahead
            leg = np.array([thigh, shin, shin + 1.35])
            parts.append(_path(hip + np.array((0, 0, side)), leg, np.array([0.46, 0.46, 0.16])))
        for side, at in ((0.22, phase + np.pi), (-0.22, phase)):
            upper = 0.8 * stride * np.sin(at)
            parts.append(_path(neck + np.array((0, 0.06, side)), np.array([upper, upper + 1.2]), np.array([0.32, 0.3])))
        return Links(np.concatenate(parts), half, sides)

    return pose


def _bird(rng: np.random.Generator) -> Pose:
    """Return a body with a head, a tail and two wings of two parts each, which flap."""
    flap, fold = rng.uniform(0.5, 0.9), rng.uniform(0.4, 0.8)
    chord, span = rng.uniform(0.24, 0.34), rng.uniform(0.5, 0.7)
    half = np.array(
        [(0.17, 0.17), (0.12, 0.12), (0.15, 0.03), (0.03, 0.05), *[(chord, 0.045), (0.7 * chord, 0.035)] * 2]
    )
    sides = np.array([_HINGE] * 4 + [(1.0, 0, 0)] * 4)
    trunk = np.array(
        [
            [(-0.4, 0, 0), (0.4, 0, 0)],
            [(0.4, -0.1, 0), (0.55, -0.12, 0)],
            [(-0.75, 0, 0), (-0.35, 0, 0)],
            [(0.55, -0.12, 0), (0.72, -0.1, 0)],
        ]
    )

    def pose(phase: float) -> Links:
        inner = flap * np.sin(phase)
        outer = inner + fold * np.sin(phase - 1.1) - 0.1
        wings = []
        for side in (1.0, -1.0):
            root = np.array([0.05, -0.05, 0.1 * side])
            elbow = root + span * np.array([0.05, -np.sin(inner), side * np.cos(inner)])
            tip = elbow + span * np.array([-0.2, -np.sin(outer), side * np.cos(outer)])
            wings += [(root, elbow), (elbow, tip)]
        return Links(np.concatenate([trunk, np.array(wings)]), half, sides)

    return pose


def _claw(rng: np.random.Generator) -> Pose:
    """Return a palm with fingers of two parts around it, which close and open."""
    fingers = int(rng.integers(3, 6))
    around = 2 * np.pi * np.arange(fingers) / fingers
    out = np.stack([np.cos(around), np.zeros(fingers), np.sin(around)], axis=1)
    down = np.array([0.0, 1, 0])
    open_rad, grip = rng.uniform(0.9, 1.3), rng.uniform(0.5, 0.9)
    half = np.array([(0.34, 0.34)] + [(0.15, 0.13), (0.12, 0.1)] * fingers)
    sides = np.concatenate([[(1.0, 0, 0)], np.repeat(np.cross(out, down), 2, axis=0)])

    def pose(phase: float) -> Links:
        first = open_rad - grip * 0.5 * (1 + np.sin(phase))
        second = first - 0.5 - 0.6 * grip * (1 + np.sin(phase - 0.4))
        bars = [((0.0, -0.35, 0), (0.0, 0.1, 0))]
        for direction in out:
            root = 0.22 * direction
            knuckle = root + 0.6 * (np.sin(first) * direction + np.cos(first) * down)
            bars += [(root, knuckle), (knuckle, knuckle + 0.55 * (np.sin(second) * direction + np.cos(second) * down))]
        return Links(np.array(bars), half, sides)

    return pose


_POSES: dict[str, Callable[[np.random.Generator], Pose]] = {
    "chain": _chain,
    "scissors": _scissors,
    "runner": _runner,
    "bird": _bird,
    "claw": _claw,
}
FIGURES = tuple(_POSES)
