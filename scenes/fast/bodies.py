"""Coarse closed meshes for clips: a body is tens of pixels wide and is placed anew in every frame, so a few hundred faces do.

The shapes are fixed (they are part of what a seed means); a clip picks, stretches, turns and bends them.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from scenes.meshes import UnitMesh, mesh_library
from scenes.surfaces import face_cross, grid_faces, smooth_normals, unit, welded

Array = NDArray[np.float64]
Radius = Callable[[Array], Array]
"""Unit directions ``(..., 3)`` to how far a surface is from the origin, ``(...)``."""
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
    return (_ball(_no_lumps), *(_ball(_lumps(rng, 0.045)) for _ in range(2)), _ball(_ribs(8, 0.05)))


@functools.cache
def bodies() -> tuple[UnitMesh, ...]:
    """Return all bodies, the round ones first; at most 700 faces each."""
    rng = np.random.default_rng(_SEED + 1)
    return (
        *round_bodies(),
        *(_superellipsoid(*exponents) for exponents in ((0.3, 0.3), (0.25, 1.0), (1.0, 0.3), (1.9, 1.0))),
        *(_ball(_lumps(rng, 0.35)) for _ in range(2)),
        *(_turned(profile) for profile in (_PIN, _DUMBBELL, _BOTTLE, _TOP)),
        *(_tube(_circle(28), tube) for tube in (0.25, 0.45)),
        _tube(_trefoil(48), 0.24),
        *(mesh for mesh in mesh_library() if len(mesh.faces) <= _MOST_FACES),
    )


def closed_surface(points: Array) -> UnitMesh:
    """Triangulate a closed grid of points ``(rows, columns, 3)``, seams and poles stored twice, at size 1.

    Its bounding box is centred, its farthest vertex 1 from the origin; normals are averaged over the seams.
    """
    rows, columns = points.shape[:2]
    vertices = points.reshape(-1, 3) - (points.min(axis=(0, 1)) + points.max(axis=(0, 1))) / 2
    vertices = vertices / np.linalg.norm(vertices, axis=1).max()
    faces = grid_faces(rows, columns)
    cross = face_cross(vertices, faces)
    kept = np.linalg.norm(cross, axis=1) > 1e-9  # at poles one of the two triangles has no area
    faces = faces[kept]
    if np.einsum("fi,fi->", vertices[faces[:, 0]], cross[kept]) < 0:  # a negative volume: the grid is seen from inside
        faces = faces[:, ::-1]
    down, across = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
    uv = np.stack([across, down], axis=-1).reshape(-1, 2)
    return UnitMesh(vertices, smooth_normals(vertices, faces, welded(vertices)), uv, faces)


def _angles(columns: int, rows: int) -> tuple[Array, Array]:
    """Return angles around (0..2 pi) and up (-pi/2..pi/2), each ``(rows + 1, columns + 1)``."""
    up, around = np.meshgrid(
        np.linspace(-np.pi / 2, np.pi / 2, rows + 1), np.linspace(0, 2 * np.pi, columns + 1), indexing="ij"
    )
    return around, up


def _no_lumps(direction: Array) -> Array:
    return np.ones(direction.shape[:-1])


def _lumps(rng: np.random.Generator, strength: float) -> Radius:
    waves, phases = rng.normal(0, 2.2, (4, 3)), rng.uniform(0, 2 * np.pi, 4)

    def radius(direction: Array) -> Array:
        return 1 + strength * np.mean(np.sin(direction @ waves.T + phases), axis=-1)

    return radius


def _ribs(count: int, depth: float) -> Radius:
    def radius(direction: Array) -> Array:
        return 1 - depth * (1 + np.cos(count * np.arctan2(direction[..., 2], direction[..., 0]))) * (
            1 - direction[..., 1] ** 2
        )

    return radius


def _ball(radius: Radius) -> UnitMesh:
    around, up = _angles(_COLUMNS, _ROWS)
    direction = np.stack([np.cos(up) * np.cos(around), np.sin(up), np.cos(up) * np.sin(around)], axis=-1)
    return closed_surface(direction * radius(direction)[..., np.newaxis])


def _superellipsoid(e_up: float, e_around: float) -> UnitMesh:
    """Barr's superellipsoid: exponents of 0.3 give a rounded box or cylinder, near 2 a pinched spindle."""

    def power(base: Array, exponent: float) -> Array:
        base = np.round(base, 12)  # sin(pi) is 1e-16, and a small exponent would make that 1e-5
        return np.sign(base) * np.abs(base) ** exponent

    around, up = _angles(24, _ROWS)
    ring = power(np.cos(up), e_up)
    return closed_surface(
        np.stack(
            [ring * power(np.cos(around), e_around), power(np.sin(up), e_up), ring * power(np.sin(around), e_around)],
            -1,
        )
    )


def _turned(profile: tuple[tuple[float, float], ...]) -> UnitMesh:
    """Turn a profile, made round by one pass of corner cutting (Chaikin), about the y axis."""
    points = np.array(profile, dtype=float)
    cut = np.stack([0.75 * points[:-1] + 0.25 * points[1:], 0.25 * points[:-1] + 0.75 * points[1:]], axis=1)
    points = np.concatenate([points[:1], cut.reshape(-1, 2)[1:-1], points[-1:]])
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
