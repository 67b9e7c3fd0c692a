"""Things to handle, each made of two thin shells that meet along a jagged seam, and grains to pour.

A thing stands on its origin: x across, y down (its top at -height), z deep; metres. The shells are surfaces swept from a
profile (radius against height) around half an outline, so that any thing can be torn in two and any can be poured from.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.meshes import UnitMesh
from scenes.surfaces import face_cross, grid_faces, smooth_normals, unit

Array = NDArray[np.float64]

# Profiles from the top down: (radius, height) as shares of half the width and of the height; a point twice is a sharp edge.
_SHARP = ((0, 0), (0.5, 0), (1, 0), (1, 0), (1, 0.25), (1, 0.5), (1, 0.75), (1, 1), (1, 1), (0, 1))
_CUP = ((0, 0.92), (0.66, 0.9), (0.8, 0.5), (0.92, 0.03), (0.96, 0), (1, 0.02), (0.94, 0.25), (0.88, 0.5), (0.82, 0.75))
_CUP += ((0.75, 0.98), (0.7, 1), (0, 1))
_BOTTLE = ((0, 0), (0.38, 0), (0.4, 0), (0.4, 0.1), (0.4, 0.1), (0.33, 0.11), (0.34, 0.22), (0.6, 0.32), (0.93, 0.42))
_BOTTLE += ((1, 0.5), (0.97, 0.65), (1, 0.8), (1, 0.96), (0.92, 1), (0, 1))
_BALL = tuple((float(np.sin(a)), float(0.5 - 0.5 * np.cos(a))) for a in np.linspace(0, np.pi, 13))
_SOFT = (
    (0, 0.05),
    (0.35, 0),
    (0.65, 0.03),
    (0.87, 0.14),
    (0.97, 0.3),
    (1, 0.5),
    (1, 0.7),
    (0.95, 0.88),
    (0.84, 1),
    (0, 1),
)
_BRICK = ((0, 1), (0.5, 1), (1, 1), (1, 1), (1, 0.33), (1, -0.33), (1, -1), (1, -1), (0.5, -1), (0, -1))
_ROUND = tuple((float(np.sin(a)), float(np.cos(a))) for a in np.linspace(0, np.pi, 13))
_CUSHION = tuple(
    (float(np.sin(a) ** 0.6), float(np.sign(np.cos(a)) * np.abs(np.round(np.cos(a), 9)) ** 0.6))
    for a in np.linspace(0, np.pi, 13)
)


@dataclass(frozen=True)
class Kind:
    """Profile, half outline (x >= 0, from the far side to the near one) and ranges of width, depth and height in metres.

    ``depth_m`` None is as deep as wide; ``lumps`` is how far, as a share of the width, the surface is dented.
    """

    profile: tuple[tuple[float, float], ...]
    outline: tuple[tuple[float, float], ...]
    width_m: tuple[float, float]
    depth_m: tuple[float, float] | None
    height_m: tuple[float, float] | None
    lumps: float = 0.0


KINDS = {
    "box": Kind(_SHARP, _BRICK, (0.06, 0.09), (0.04, 0.075), (0.08, 0.14)),
    "cup": Kind(_CUP, _ROUND, (0.07, 0.09), None, (0.085, 0.12)),
    "bottle": Kind(_BOTTLE, _ROUND, (0.055, 0.075), None, (0.15, 0.19)),
    "ball": Kind(_BALL, _ROUND, (0.065, 0.09), None, None),
    "card": Kind(_SHARP, _BRICK, (0.075, 0.095), (0.004, 0.012), (0.10, 0.15)),
    "soft": Kind(_SOFT, _CUSHION, (0.07, 0.09), (0.05, 0.075), (0.08, 0.12), 0.035),
}
"""What things there are; a ball's height is its width."""


@dataclass(frozen=True)
class Thing:
    """A thing's kind, sizes in metres, and its two shells: left (x < 0) and right of the seam."""

    kind: str
    width_m: float
    depth_m: float
    height_m: float
    halves: tuple[UnitMesh, UnitMesh]

    def share_at(self, height_m: float) -> float:
        """Return the outer half width at a height above the table, as a share of the greatest."""
        profile = np.array(KINDS[self.kind].profile)
        outer = profile[np.argmax(profile[:, 0] >= 1 - 1e-9) if self.kind == "cup" else 0 :]
        return float(np.interp(1 - height_m / self.height_m, outer[:, 1], outer[:, 0]))


def draw_thing(rng: np.random.Generator) -> Thing:
    """Draw a thing; the same number of draws for every kind."""
    name = tuple(KINDS)[rng.integers(len(KINDS))]
    kind = KINDS[name]
    sizes = rng.random(3)
    width = _between(kind.width_m, sizes[0])
    depth = width if kind.depth_m is None else _between(kind.depth_m, sizes[1])
    height = width if kind.height_m is None else _between(kind.height_m, sizes[2])
    seam = 0.09 * rng.uniform(-1, 1, (2, 16))
    waves, phases = rng.normal(0, 2.2, (4, 3)), rng.uniform(0, 2 * np.pi, 4)

    def place(x: Array, y: Array, z: Array) -> Array:
        """Bend the halves' common seam and dent what is soft: one function of place, so that the seam stays closed."""
        near = (1 + z) / 2
        rows = np.linspace(0, 1, seam.shape[1])
        jag = near * np.interp(y, rows, seam[0]) + (1 - near) * np.interp(y, rows, seam[1])
        points = np.stack([x + jag * (1 - np.abs(x)), y, z], axis=-1)
        dent = np.sin(points @ waves.T + phases).mean(axis=-1) * kind.lumps * np.sin(np.pi * np.clip(y, 0, 1)) * 2
        return np.stack([(points[..., 0] + dent) * width / 2, (y - 1) * height, (z + dent) * depth / 2], axis=-1)

    profile, outline = np.array(kind.profile), np.array(kind.outline)
    radius, height_share = profile[:, :1], np.broadcast_to(profile[:, 1:], (len(profile), len(outline)))
    halves = []
    for side in (-1.0, 1.0):
        points = place(side * radius * outline[:, 0], height_share, side * radius * outline[:, 1])
        halves.append(_shell(points, 0.25 - 0.25 * side))
    return Thing(name, width, depth, height, (halves[0], halves[1]))


def _between(ends: tuple[float, float], share: float) -> float:
    return float(ends[0] + share * (ends[1] - ends[0]))


def _shell(points: Array, first_u: float) -> UnitMesh:
    """Triangulate a grid of points; texture coordinates follow its columns and rows."""
    rows, columns = points.shape[:2]
    vertices = points.reshape(-1, 3)
    faces = grid_faces(rows, columns)
    faces = faces[np.linalg.norm(face_cross(vertices, faces), axis=1) > 1e-10]  # edges and poles have empty ones
    across = first_u + 0.5 * np.arange(columns) / (columns - 1)
    down = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points[:, columns // 2], axis=0), axis=1))])
    uv = np.stack(np.broadcast_arrays(across, (down / down[-1])[:, np.newaxis]), axis=-1).reshape(-1, 2)
    return UnitMesh(vertices, smooth_normals(vertices, faces), uv, faces)


_OCTAHEDRON = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], dtype=float)
_OCTAHEDRON_FACES = np.array([(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)])


def grains_mesh(centres_m: Array, radii_m: Array) -> UnitMesh:
    """Return many small pieces as one mesh, in metres.

    Args:
        centres_m: ``(N, 3)``.
        radii_m: ``(N,)``.
    """
    count = len(centres_m)
    vertices = centres_m[:, np.newaxis] + radii_m[:, np.newaxis, np.newaxis] * _OCTAHEDRON
    faces = _OCTAHEDRON_FACES + 6 * np.arange(count)[:, np.newaxis, np.newaxis]
    normals = np.tile(unit(_OCTAHEDRON), (count, 1))
    uv = np.repeat(np.linspace(0, 1, count, endpoint=False), 6)[:, np.newaxis] * (1.0, 7.0)
    return UnitMesh(vertices.reshape(-1, 3), normals, uv, faces.reshape(-1, 3))
