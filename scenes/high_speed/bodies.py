"""Bodies: coarse closed meshes and sheets, and how soft ones change their form, smoothly in time.

A body is tens of pixels wide and is placed anew in every frame, so a few hundred faces do. The shapes are fixed (they are
part of what a seed means); a clip picks, stretches, turns and bends them.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from scenes.meshes import (
    Radius,
    UnitMesh,
    closed_surface,
    grid_faces,
    lumps,
    mesh_library,
    rounded,
    smooth_normals,
    superellipsoid,
    unit,
    welded,
)
from simulator.render import Material, TriangleMesh

Array = NDArray[np.float64]
_SEED = 20260401
_MOST_FACES = 700
_COLUMNS, _ROWS = 22, 14

# Profiles turned about the y axis, (radius, height) from the top to the foot.
_PIN = ((0, 1), (0.16, 0.95), (0.19, 0.8), (0.12, 0.55), (0.16, 0.3), (0.34, -0.2), (0.33, -0.6), (0.2, -0.97), (0, -1))
_DUMBBELL = ((0, 1), (0.3, 0.95), (0.42, 0.75), (0.3, 0.52), (0.12, 0.4), (0.12, -0.4), (0.3, -0.52), (0.42, -0.75))
_DUMBBELL += ((0.3, -0.95), (0, -1))
_BOTTLE = ((0, 1), (0.14, 1), (0.14, 0.55), (0.36, 0.25), (0.38, 0), (0.38, -0.8), (0.34, -0.95), (0, -0.97))
_TOP = ((0, 0.8), (0.1, 0.78), (0.1, 0.35), (0.75, 0.15), (0.8, 0), (0.5, -0.35), (0.08, -0.75), (0, -0.8))


@functools.cache
def round_bodies() -> tuple[UnitMesh, ...]:
    """Return balls of which every vertex is within 10 % of the unit sphere: they touch where a ball would."""
    rng = np.random.default_rng(_SEED)
    return (
        _ball(lambda direction: np.ones(direction.shape[:-1])),
        *(_ball(lumps(rng, 4, 2.2, 0.045)) for _ in range(2)),
        _ball(_ribs(8, 0.05)),
    )


@functools.cache
def body_library() -> tuple[UnitMesh, ...]:
    """Return all bodies, the round ones first; at most 700 faces each."""
    rng = np.random.default_rng(_SEED + 1)
    return (
        *round_bodies(),
        *(superellipsoid(*exponents, 24, _ROWS) for exponents in ((0.3, 0.3), (0.25, 1.0), (1.0, 0.3), (1.9, 1.0))),
        *(_ball(lumps(rng, 4, 2.2, 0.35)) for _ in range(2)),
        *(_turned(profile) for profile in (_PIN, _DUMBBELL, _BOTTLE, _TOP)),
        *(_tube(_circle(28), tube) for tube in (0.25, 0.45)),
        _tube(_trefoil(48), 0.24),
        *(mesh for mesh in mesh_library() if len(mesh.faces) <= _MOST_FACES),
    )


def _ribs(count: int, depth: float) -> Radius:
    def radius(direction: Array) -> Array:
        return 1 - depth * (1 + np.cos(count * np.arctan2(direction[..., 2], direction[..., 0]))) * (
            1 - direction[..., 1] ** 2
        )

    return radius


def _ball(radius: Radius) -> UnitMesh:
    up, around = np.meshgrid(
        np.linspace(-np.pi / 2, np.pi / 2, _ROWS + 1), np.linspace(0, 2 * np.pi, _COLUMNS + 1), indexing="ij"
    )
    direction = np.stack([np.cos(up) * np.cos(around), np.sin(up), np.cos(up) * np.sin(around)], axis=-1)
    return closed_surface(direction * radius(direction)[..., np.newaxis])


def _turned(profile: tuple[tuple[float, float], ...]) -> UnitMesh:
    """Turn a profile about the y axis."""
    points = rounded(profile, 1)
    around = np.linspace(0, 2 * np.pi, 17)
    radius, height = points[:, :1], -points[:, 1:]
    return closed_surface(
        np.stack(np.broadcast_arrays(radius * np.cos(around), height, radius * np.sin(around)), axis=-1)
    )


def _circle(count: int) -> Array:
    turn = np.linspace(0, 2 * np.pi, count + 1)
    return np.stack([np.cos(turn), np.zeros_like(turn), np.sin(turn)], axis=1)


def _trefoil(count: int) -> Array:
    turn = np.linspace(0, 2 * np.pi, count + 1)
    radius = 1 + 0.45 * np.cos(3 * turn)
    return np.stack([radius * np.cos(2 * turn), 0.45 * np.sin(3 * turn), radius * np.sin(2 * turn)], axis=1)


def _tube(line: Array, radius: float) -> UnitMesh:
    """Put a round tube around a closed line ``(n + 1, 3)`` whose last point is its first."""
    step = np.roll(line[:-1], -1, axis=0) - np.roll(line[:-1], 1, axis=0)
    along = unit(step)
    across = unit(np.cross(along, (0.0, 1, 0)))
    frame = np.stack([across, np.cross(across, along)], axis=1)
    around = np.linspace(0, 2 * np.pi, 8 if len(line) > 40 else 11)
    circle = radius * np.stack([np.cos(around), np.sin(around)], axis=1)
    ring = line[:-1, np.newaxis] + np.einsum("kc,ncx->nkx", circle, frame)
    return closed_surface(np.concatenate([ring, ring[:1]]))


Bend = Callable[[Array, float], Array]
"""Points ``(V, 3)`` of a unit body and a phase in radians, to where they are."""


def squash(points: Array, stretch: float) -> Array:
    """Stretch points along y by a factor, and across by its root's inverse, so that volumes stay.

    Example:
        >>> squash(np.array([[1.0, 1.0, 0.0]]), 4.0).tolist()
        [[0.5, 4.0, 0.0]]
    """
    return points * np.array([stretch**-0.5, stretch, stretch**-0.5])


def pulsing(strength: float) -> Bend:
    """Return a body that is stretched and flattened in turn, volume kept; ``strength`` is the logarithm of the stretch."""
    return lambda points, phase: squash(points, math.exp(strength * math.sin(phase)))


def jelly(directions: Array, strength: float) -> Bend:
    """Return a body through which waves run: a shear and a bulge, as of jelly that was knocked.

    ``directions`` are two unit vectors at right angles, ``(2, 3)``: along which the waves run, and in which they push; points
    move by ``strength`` radii.
    """
    along, push = directions

    def bend(points: Array, phase: float) -> Array:
        depth = points @ along
        swing = strength * np.sin(phase - 1.6 * depth)
        bulge = 1 + 0.45 * strength * np.sin(2 * phase - 2.4 * depth)
        middle = np.outer(depth, along)
        return middle + (points - middle) * bulge[:, np.newaxis] + np.outer(swing, push)

    return bend


def twisting(strength: float) -> Bend:
    """Return a body that is wrung about its y axis, back and forth; ``strength`` in radians at the ends."""

    def bend(points: Array, phase: float) -> Array:
        angle = strength * math.sin(phase) * points[:, 1]
        cos, sin = np.cos(angle), np.sin(angle)
        x, y, z = points.T
        return np.stack([cos * x + sin * z, y, cos * z - sin * x], axis=1)

    return bend


def bowing(strength: float) -> Bend:
    """Return a body whose y axis bends into an arc of ``strength`` radians, to one side and the other."""

    def bend(points: Array, phase: float) -> Array:
        curve = strength * math.sin(phase) / 2
        x, y, z = points.T
        angle = curve * y
        # sin(a) / a and (1 - cos(a)) / a have no trouble at a = 0 in this form.
        length = y * np.sinc(angle / np.pi)
        sag = y * np.sin(angle / 2) * np.sinc(angle / 2 / np.pi)
        return np.stack([x * np.cos(angle) + sag, length - x * np.sin(angle), z], axis=1)

    return bend


def flapping(strength: float, waves: float, slope: float) -> Bend:
    """Return a flag on a pole along its edge x = -1: waves run to the free edge and grow on their way.

    ``strength`` is the amplitude at the free edge in half widths, ``waves`` how many wavelengths fit on the flag,
    ``slope`` how far the crests lean, in radians of phase per unit of height.
    """

    def bend(points: Array, phase: float) -> Array:
        share = (points[:, 0] + 1) / 2
        lag = phase - 2 * np.pi * waves * share - slope * points[:, 1]
        push = strength * share**0.8 * np.sin(lag)
        # What goes sideways is missing ahead: the cloth does not stretch much.
        shortened = points[:, 0] - 0.35 * strength**2 * waves * share * np.ones_like(push)
        return np.stack([shortened, points[:, 1], points[:, 2] + push], axis=1)

    return bend


def rippling(strength: float, waves: float, slope: float) -> Bend:
    """Return a free sheet, a falling paper or a ray: waves run along it and both its ends swing; see `flapping`."""

    def bend(points: Array, phase: float) -> Array:
        lag = phase - np.pi * waves * points[:, 0] - slope * points[:, 1]
        return points + np.outer(strength * np.sin(lag) * (0.4 + 0.6 * points[:, 0] ** 2), (0.0, 0, 1))

    return bend


def sheet(rows: int, columns: int, aspect: float) -> UnitMesh:
    """Return an open rectangle in the x-y plane, x from -1 to 1 and y from -aspect to aspect, facing -z."""
    y, x = np.meshgrid(np.linspace(-aspect, aspect, rows), np.linspace(-1, 1, columns), indexing="ij")
    vertices = np.stack([x, y, np.zeros_like(x)], axis=-1).reshape(-1, 3)
    uv = np.stack([(x + 1) / 2, (y + aspect) / 2], axis=-1).reshape(-1, 2)
    faces = grid_faces(rows, columns)[:, ::-1]
    return UnitMesh(vertices, smooth_normals(vertices, faces), uv, faces)


class Soft:
    """A mesh that is bent anew in each frame, with the normals that belong to its form."""

    def __init__(self, mesh: UnitMesh, bend: Bend) -> None:
        self._mesh, self._bend = mesh, bend
        self._weld = welded(mesh.vertices)
        if len(mesh.vertices) == 3 * len(mesh.faces):  # a faceted body: its edges stay sharp
            self._weld = np.arange(len(mesh.vertices))

    def reach(self) -> float:
        """Return the farthest that a vertex gets from the origin, over all phases, with 2 % to spare."""
        phases = np.linspace(0, 2 * np.pi, 24, endpoint=False)
        bent = (self._bend(self._mesh.vertices, float(phase)) for phase in phases)
        return 1.02 * max(float(np.linalg.norm(points, axis=1).max()) for points in bent)

    def placed(self, phase: float, material: Material, centre_m: Array, size_m: float, turn: Array) -> TriangleMesh:
        """Return the body at a phase as a thing of a scene; the other arguments are those of `scenes.meshes.placed`."""
        vertices = self._bend(self._mesh.vertices, phase)
        normals = smooth_normals(vertices, self._mesh.faces, self._weld)
        return TriangleMesh(
            vertices_m=np.asarray(centre_m) + size_m * vertices @ turn.T,
            normals=normals @ turn.T,
            uv=self._mesh.uv,
            faces=self._mesh.faces,
            material=material,
        )
