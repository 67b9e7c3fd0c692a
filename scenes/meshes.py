"""Triangle meshes: surfaces from grids of points, normals, and a library of closed shapes inside the unit ball.

The shapes are fixed (they are part of what a seed means); a scene picks, turns and scales them.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from simulator.render import Material, TriangleMesh
from simulator.types import View

Array = NDArray[np.float64]
Radius = Callable[[Array], Array]
"""Unit directions ``(..., 3)`` to how far a surface is from the origin, ``(...)``."""


def grid_faces(rows: int, columns: int) -> NDArray[np.int64]:
    """Return the triangles ``(2 (rows - 1) (columns - 1), 3)`` of a grid of points stored row by row.

    They run counter-clockwise seen from the side to which the cross product (along columns) x (along rows) points.

    Example:
        >>> grid_faces(2, 2)
        array([[0, 1, 2],
               [1, 3, 2]])
    """
    corner = (np.arange(rows - 1)[:, np.newaxis] * columns + np.arange(columns - 1)).ravel()
    right, below = corner + 1, corner + columns
    return np.concatenate([np.stack([corner, right, below], 1), np.stack([right, below + 1, below], 1)])


def face_cross(vertices: Array, faces: NDArray[np.integer]) -> Array:
    """Return the normals of triangles ``(F, 3)``, as long as twice their areas."""
    a, b, c = (vertices[faces[:, side]] for side in range(3))
    return np.cross(b - a, c - a)


def smooth_normals(vertices: Array, faces: NDArray[np.integer], weld: NDArray[np.integer] | None = None) -> Array:
    """Return unit normals ``(V, 3)``: the means of the adjoining triangles' normals, weighted by area.

    Args:
        vertices: ``(V, 3)``.
        faces: ``(F, 3)``.
        weld: ``(V,)`` group numbers of vertices that share one normal, of `welded`; None keeps each vertex apart, so that
            a seam shows.
    """
    place = np.arange(len(vertices)) if weld is None else weld
    cross = face_cross(vertices, faces)
    sums = np.zeros((place.max() + 1, 3))
    for side in range(3):
        np.add.at(sums, place[faces[:, side]], cross)
    return unit(sums)[place]


def welded(vertices: Array, tolerance: float = 1e-6) -> NDArray[np.int64]:
    """Return group numbers ``(V,)`` that vertices at the same place share, within a tolerance in their own units."""
    _, place = np.unique(np.round(vertices / tolerance), axis=0, return_inverse=True)
    return place.ravel()


def unit(vectors: Array) -> Array:
    """Return vectors ``(..., 3)`` at length 1; zero ones stay zero."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0, length, 1)


def backdrop(view: View, depth_m: float, material: Material, repeats: float) -> TriangleMesh:
    """Return a plane that fills a view with its margin, ``repeats`` textures to the image's width.

    One triangle, because a ray that hits an edge between two can slip through in float32.
    """
    corners = np.column_stack([np.array([(-1.1, -1.1), (3.4, -1.1), (-1.1, 3.4)]), np.ones(3)]) * depth_m
    corners[:, :2] *= (view.field.tan_half_width, view.field.tan_half_height)
    uv = corners[:, :2] * repeats / (2 * view.tan_half_width * depth_m)
    return TriangleMesh(corners, np.tile([0.0, 0, -1], (3, 1)), uv, np.array([(0, 2, 1)]), material)


_LIBRARY_SEED = 20260102


@dataclass(frozen=True)
class UnitMesh:
    """A closed surface whose farthest vertex is 1 from the origin; arrays as in `simulator.render.TriangleMesh`."""

    vertices: Array
    normals: Array
    uv: Array
    faces: NDArray[np.int64]


def placed(mesh: UnitMesh, material: Material, centre_m: ArrayLike, size_m: ArrayLike, turn: Array) -> TriangleMesh:
    """Return a unit mesh as a thing of a scene: its origin at ``centre_m``, turned by a rotation matrix to the world's axes.

    ``size_m`` is metres per unit, one number or one for each of the mesh's own axes.
    """
    scale = np.broadcast_to(np.asarray(size_m, dtype=float), 3)
    normals = mesh.normals / scale
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return TriangleMesh(
        vertices_m=np.asarray(centre_m) + (mesh.vertices * scale) @ turn.T,
        normals=normals @ turn.T,
        uv=mesh.uv,
        faces=mesh.faces,
        material=material,
    )


def closed_surface(points: Array) -> UnitMesh:
    """Triangulate a closed grid of points ``(rows, columns, 3)``, seams and poles stored twice, at size 1.

    Its bounding box is centred, its farthest vertex 1 from the origin; normals are averaged over the seams.
    """
    rows, columns = points.shape[:2]
    vertices = _normalised(points.reshape(-1, 3))
    faces = grid_faces(rows, columns)
    cross = face_cross(vertices, faces)
    kept = np.linalg.norm(cross, axis=1) > 1e-9  # at poles one of the two triangles has no area
    faces = faces[kept]
    if np.einsum("fi,fi->", vertices[faces[:, 0]], cross[kept]) < 0:  # a negative volume: the grid is seen from inside
        faces = faces[:, ::-1]
    down, across = np.meshgrid(np.linspace(0, 1, rows), np.linspace(0, 1, columns), indexing="ij")
    uv = np.stack([across, down], axis=-1).reshape(-1, 2)
    return UnitMesh(vertices, smooth_normals(vertices, faces, welded(vertices)), uv, faces)


@functools.cache
def mesh_library() -> tuple[UnitMesh, ...]:
    """Return the library, the same in every process."""
    rng = np.random.default_rng(_LIBRARY_SEED)
    smooth = [
        *(superellipsoid(*exponents) for exponents in ((0.3, 0.3), (0.3, 1.0), (1.0, 0.3), (2.2, 1.0), (0.4, 2.4))),
        *(_torus(tube) for tube in (0.2, 0.45)),
        *(_knot(p, q) for p, q in ((2, 3), (3, 2), (2, 5))),
        *(_lumpy_ball(rng, strength) for strength in (0.25, 0.35, 0.45)),
        *(_turned(profile) for profile in (_VASE, _BOWL, _PAWN, _CAPSULE)),
        *(_flower(petals, depth) for petals, depth in ((5, 0.3), (8, 0.15))),
    ]
    faceted = [
        *(_hull(points) for points in (_TETRAHEDRON, _OCTAHEDRON, _ICOSAHEDRON)),
        *(_hull(unit(rng.standard_normal((count, 3))) * (1, 0.8, 0.6)) for count in (9, 14, 20)),
        *(_prism(outline) for outline in (_star(5, 0.45), _star(8, 0.7), _CROSS, _ARROW)),
    ]
    return tuple(smooth + faceted)


# Smooth surfaces: a grid of (u, v) in the unit square, mapped to space. Their 700 to 1000 triangles keep silhouettes within
# a fifth of a pixel of the smooth ones at 50 pixels across; more would cost time: scenes load by the triangle.


def _surface(position: Callable[[Array, Array], tuple[Array, Array, Array]], columns: int, rows: int) -> UnitMesh:
    """Triangulate ``position(u, v)``."""
    v, u = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    return closed_surface(np.stack(position(u, v), axis=-1))


def superellipsoid(e_v: float, e_u: float, columns: int = 26, rows: int = 16) -> UnitMesh:
    """Barr's superellipsoid: exponents of 0.3 give a rounded box or cylinder, above 2 a pinched spindle."""

    def power(base: Array, exponent: float) -> Array:
        base = np.round(base, 12)  # sin(pi) is 1e-16, and a small exponent would make that 1e-5
        return np.sign(base) * np.abs(base) ** exponent

    def position(u: Array, v: Array) -> tuple[Array, Array, Array]:
        around, up = 2 * np.pi * u, np.pi * (v - 0.5)
        cos_up = np.maximum(np.cos(up), 0)  # not -6e-17 at the pole
        return (
            power(cos_up, e_v) * power(np.cos(around), e_u),
            power(np.sin(up), e_v),
            power(cos_up, e_v) * power(np.sin(around), e_u),
        )

    return _surface(position, columns, rows)


def _torus(tube: float) -> UnitMesh:
    def position(u: Array, v: Array) -> tuple[Array, Array, Array]:
        ring, around = 2 * np.pi * u, 2 * np.pi * v
        radius = 1 + tube * np.cos(around)
        return radius * np.cos(ring), tube * np.sin(around), radius * np.sin(ring)

    return _surface(position, 36, 11)


def _knot(p: int, q: int) -> UnitMesh:
    """A tube along the torus knot that winds p times around the axis and q times around the ring."""

    def centre(u: Array) -> Array:
        t = 2 * np.pi * u
        radius = 1 + 0.42 * np.cos(q * t)
        return np.stack([radius * np.cos(p * t), 0.42 * np.sin(q * t), radius * np.sin(p * t)], axis=-1)

    def position(u: Array, v: Array) -> tuple[Array, Array, Array]:
        along = unit(centre(u + 1e-4) - centre(u - 1e-4))
        # The ring's own axis circle gives a frame that closes after one turn.
        t = 2 * np.pi * u
        outwards = centre(u) - np.stack([np.cos(p * t), 0 * t, np.sin(p * t)], axis=-1)
        across = unit(np.cross(along, outwards))
        upwards = np.cross(across, along)
        angle = 2 * np.pi * v[..., np.newaxis]
        tube = centre(u) + 0.17 * (np.cos(angle) * across + np.sin(angle) * upwards)
        return tube[..., 0], tube[..., 1], tube[..., 2]

    return _surface(position, 64, 8)


def lumps(rng: np.random.Generator, count: int, spread: float, strength: float) -> Radius:
    """Draw ``count`` plane waves that push a ball in and out; ``spread`` is the deviation of their wave numbers."""
    waves, phases = rng.normal(0, spread, (count, 3)), rng.uniform(0, 2 * np.pi, count)
    return lambda direction: 1 + strength * np.mean(np.sin(direction @ waves.T + phases), axis=-1)


def _lumpy_ball(rng: np.random.Generator, strength: float) -> UnitMesh:
    """A pebble."""
    reach = lumps(rng, 6, 2.5, strength)

    def position(u: Array, v: Array) -> tuple[Array, Array, Array]:
        around, down = 2 * np.pi * u, np.pi * v
        direction = np.stack([np.sin(down) * np.cos(around), np.cos(down), np.sin(down) * np.sin(around)], axis=-1)
        ball = direction * reach(direction)[..., np.newaxis]
        return ball[..., 0], ball[..., 1], ball[..., 2]

    return _surface(position, 26, 15)


def _flower(petals: int, depth: float) -> UnitMesh:
    def position(u: Array, v: Array) -> tuple[Array, Array, Array]:
        around, down = 2 * np.pi * u, np.pi * v
        radius = (1 + depth * np.cos(petals * around)) * np.sin(down)
        return radius * np.cos(around), 0.45 * np.cos(down), radius * np.sin(around)

    return _surface(position, 48, 10)


# Profiles of turned shapes, (radius, height) from the top of the axis to its foot.
_VASE = ((0, 0.75), (0.3, 0.78), (0.36, 0.95), (0.4, 1), (0.44, 0.95), (0.3, 0.7), (0.5, 0.3), (0.62, -0.2))
_VASE += ((0.5, -0.65), (0.34, -0.8), (0.42, -0.95), (0.38, -1), (0, -1))
_BOWL = (
    (0, -0.25),
    (0.4, -0.15),
    (0.75, 0.2),
    (0.9, 0.5),
    (0.97, 0.5),
    (0.85, 0.1),
    (0.5, -0.3),
    (0.3, -0.42),
    (0, -0.45),
)
_PAWN = ((0, 1), (0.22, 0.94), (0.32, 0.72), (0.24, 0.52), (0.15, 0.42), (0.32, 0.36), (0.17, 0.3), (0.22, -0.2))
_PAWN += ((0.5, -0.6), (0.55, -0.75), (0.5, -0.85), (0, -0.88))
_CAPSULE = (
    (0, 1),
    (0.2, 0.95),
    (0.35, 0.83),
    (0.4, 0.65),
    (0.4, 0),
    (0.4, -0.65),
    (0.35, -0.83),
    (0.2, -0.95),
    (0, -1),
)


def rounded(profile: tuple[tuple[float, float], ...], passes: int) -> Array:
    """Return the points ``(n, 2)`` of a profile after some passes of corner cutting (Chaikin), which keep its ends."""
    points = np.array(profile, dtype=float)
    for _ in range(passes):
        cut = np.stack([0.75 * points[:-1] + 0.25 * points[1:], 0.25 * points[:-1] + 0.75 * points[1:]], axis=1)
        points = np.concatenate([points[:1], cut.reshape(-1, 2)[1:-1], points[-1:]])
    return points


def _turned(profile: tuple[tuple[float, float], ...]) -> UnitMesh:
    """Turn a profile about the y axis."""
    points = rounded(profile, 2)
    along = np.append(0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))

    def position(u: Array, v: Array) -> tuple[Array, Array, Array]:
        radius, height = (np.interp(v * along[-1], along, points[:, side]) for side in range(2))
        return radius * np.cos(2 * np.pi * u), -height, radius * np.sin(2 * np.pi * u)

    return _surface(position, 24, 18)


# Faceted solids: every triangle has its own vertices and the normal of its plane.

_GOLDEN = (1 + 5**0.5) / 2
_TETRAHEDRON = np.array([(1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)], dtype=float)
_OCTAHEDRON = np.concatenate([np.eye(3), -np.eye(3)])
_ICOSAHEDRON = np.array(
    [np.roll((0, a, b * _GOLDEN), shift) for shift in range(3) for a in (-1, 1) for b in (-1, 1)], dtype=float
)
_CROSS = np.array(
    [(1, 3), (-1, 3), (-1, 1), (-3, 1), (-3, -1), (-1, -1), (-1, -3), (1, -3), (1, -1), (3, -1), (3, 1), (1, 1)]
)
_ARROW = np.array([(0, 3), (-2.4, 0.4), (-0.9, 0.4), (-0.9, -2.6), (0.9, -2.6), (0.9, 0.4), (2.4, 0.4)])


def _star(points: int, inner: float) -> Array:
    angle = np.pi * np.arange(2 * points) / points
    radius = np.where(np.arange(2 * points) % 2, inner, 1.0)
    return np.stack([-radius * np.sin(angle), radius * np.cos(angle)], axis=1)


def _hull(points: Array) -> UnitMesh:
    """Convex hull of a few points in general position: the triples with all other points on one side."""
    triples = np.array(list(combinations(range(len(points)), 3)))
    cross = face_cross(points, triples)
    side = np.einsum("fi,fpi->fp", cross, points[np.newaxis] - points[triples[:, :1]])
    side[np.abs(side) < 1e-9] = 0
    outwards = np.all(side <= 0, axis=1)
    inwards = np.all(side >= 0, axis=1)
    return _faceted(points, np.concatenate([triples[outwards], triples[inwards][:, ::-1]]))


def _prism(outline: Array, half_depth: float = 0.3) -> UnitMesh:
    """Extrude a counter-clockwise outline, all of which is seen from its origin, along z."""
    outline = outline / np.abs(outline).max()
    count = len(outline)
    levels = [np.column_stack([np.vstack([outline, (0, 0)]), np.full(count + 1, z)]) for z in (-half_depth, half_depth)]
    here = np.arange(count)
    after, centre, up = (here + 1) % count, np.full(count, count), count + 1
    back = np.stack([here, centre, after], 1)
    front = np.stack([here, after, centre], 1) + up
    walls = [np.stack([here, after, after + up], 1), np.stack([here, after + up, here + up], 1)]
    return _faceted(np.concatenate(levels), np.concatenate([back, front, *walls]))


def _faceted(points: Array, faces: NDArray[np.integer]) -> UnitMesh:
    """Give each triangle its own vertices; texture coordinates are the two axes its plane faces least."""
    vertices = _normalised(points)[faces].reshape(-1, 3)
    own = np.arange(len(vertices)).reshape(-1, 3)
    normals = np.repeat(unit(face_cross(vertices, own)), 3, axis=0)
    facing = np.argmax(np.abs(normals), axis=1)
    axes = np.array([(2, 1), (0, 2), (0, 1)])[facing]
    return UnitMesh(vertices, normals, 0.5 + 0.5 * np.take_along_axis(vertices, axes, axis=1), own)


def _normalised(points: Array) -> Array:
    """Centre the bounding box on the origin and scale the farthest point to 1."""
    centred = points - (points.min(axis=0) + points.max(axis=0)) / 2
    return centred / np.linalg.norm(centred, axis=1).max()
