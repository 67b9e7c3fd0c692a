"""Meshes from files: OBJ, PLY, STL, glTF and GLB through trimesh, as triangles in our axes with textures of linear light.

What is read: geometry of all nodes in place, normals, texture coordinates, base colour (texture, factor, vertex and face
colours), gloss. What is not: transparency, metal, emission, normal maps, skins and animation.
"""

from __future__ import annotations

import functools
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from scenes.models.mesh_colours import Surface, baked, surface_of
from scenes.motion import rotation
from scenes.surfaces import face_cross, unit, welded
from simulator.errors import InputError

Array = NDArray[np.float64]
Up = Literal["auto", "y", "z"]
MESH_SUFFIXES = (".obj", ".ply", ".stl", ".gltf", ".glb")

# Where a facet leans away from its surroundings by more than this, an edge is meant.
_CREASE_COS = np.cos(np.radians(35))
# From the file's axes to ours: x stays to the right, up becomes -y, and what looks at the viewer keeps doing so.
_TO_OURS = {"y": np.diag([1.0, -1, -1]), "z": np.array([(1.0, 0, 0), (0, 0, -1), (0, 1, 0)])}
_STL_HEAD = 84


@dataclass(frozen=True)
class Part:
    """Triangles of one material; each has three corners of its own.

    Attributes:
        corners: ``(3 F, 3)`` in the file's unit and our axes, counter-clockwise from outside.
        normals: ``(3 F, 3)`` unit.
        uv: ``(3 F, 2)``, v downwards.
        reflectance: linear RGB ``(h, w, 3)``.
        roughness: None is matt.
    """

    corners: Array
    normals: Array
    uv: Array
    reflectance: NDArray[np.float32]
    roughness: float | None


@dataclass(frozen=True)
class Model:
    """All that a file holds; ``centre`` (of its bounding box) and ``radius`` (of the ball around that) in its unit."""

    parts: tuple[Part, ...]
    centre: Array
    radius: float


def load_model(path: Path, up: Up = "auto", turn_degrees: float = 0.0) -> Model:
    """Return the mesh of a file; a process keeps the latest few.

    Args:
        path: the file.
        up: which of its axes points up; ``auto`` is z for STL and y for all others.
        turn_degrees: about the upright, to the right as seen from above.

    Raises:
        InputError: when it cannot be read, or has no faces, no size, or vertices that are not finite.
    """
    axis = ("z" if path.suffix.lower() == ".stl" else "y") if up == "auto" else up
    state = path.stat()
    return _load(path, axis, turn_degrees, state.st_mtime_ns, state.st_size)


@functools.lru_cache(maxsize=8)
def _load(path: Path, axis: str, turn_degrees: float, *_when: int) -> Model:
    # A quarter turn to the right takes what is ahead (+z) to the right (+x).
    to_ours = rotation([0, 1, 0], np.radians(turn_degrees)) @ _TO_OURS[axis] if turn_degrees else _TO_OURS[axis]
    pieces = [_triangles(path, *node, to_ours) for node in _nodes(path)]
    if not pieces:
        _refuse_cut_stl(path)
        msg = f"{path} holds no faces: a point cloud or an empty file; export it as triangles"
        raise InputError(msg)
    every = np.concatenate([corners for corners, _, _ in pieces])
    low, high = every.min(axis=0), every.max(axis=0)
    centre = (low + high) / 2
    return Model(tuple(_merged(pieces)), centre, float(np.linalg.norm(every - centre, axis=1).max()))


def _refuse_cut_stl(path: Path) -> None:
    """Name the fault of a binary STL file, of 50 bytes a triangle after 80 and their count, whose length is not that."""
    head, size = path.read_bytes()[:_STL_HEAD], path.stat().st_size
    if path.suffix.lower() != ".stl" or len(head) < _STL_HEAD or b"facet" in head:
        return
    count = int.from_bytes(head[80:84], "little")
    expected = _STL_HEAD + 50 * count
    if size != expected:
        msg = (
            f"{path} is damaged or cut short: its header promises {count} triangles, which are {expected} bytes, "
            f"and it has {size}; fetch it or export it again"
        )
        raise InputError(msg)


def _nodes(path: Path) -> list[tuple[Any, Array]]:
    """Return each geometry with its transform; trimesh is heavy, and imported only here."""
    import trimesh

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of NaN, which gets a message of its own
            scene = trimesh.load_scene(path, process=False)
    except Exception as error:  # trimesh raises whatever the broken bytes lead to
        _refuse_cut_stl(path)
        msg = f"{path} cannot be read as a mesh ({type(error).__name__}: {error}); export it again"
        raise InputError(msg) from error
    placed = [scene.graph[node] for node in scene.graph.nodes_geometry]
    found = [(scene.geometry[name], np.asarray(matrix, dtype=np.float64)) for matrix, name in placed]
    return [(mesh, matrix) for mesh, matrix in found if len(getattr(mesh, "faces", ()))]


def _triangles(path: Path, mesh: Any, matrix: Array, to_ours: Array) -> tuple[Array, Array, Surface]:
    """Return a geometry's corners and normals in our axes, and how it looks."""
    # Only what came with the file: asking for the attribute would make normals up.
    normals = mesh._cache["vertex_normals"]
    vertices, faces = (
        np.asarray(mesh.vertices, dtype=np.float64),
        np.asarray(mesh.faces),
    )
    broken = ~np.isfinite(vertices).all(axis=1)
    if broken.any():
        msg = f"{path}: {np.count_nonzero(broken)} of {len(vertices)} vertices are NaN or inf; clean the mesh"
        raise InputError(msg)
    turn = to_ours @ matrix[:3, :3]
    places = vertices @ turn.T + to_ours @ matrix[:3, 3]
    cross = face_cross(places, faces)
    length = np.linalg.norm(cross, axis=1)
    if not length.max() > 0:
        msg = (
            f"{path}: all its vertices lie on one line or point, so it has no size; check its unit and export it again"
        )
        raise InputError(msg)
    kept = length > 1e-12 * length.max()
    surface = surface_of(mesh, kept, path)
    faces, cross = faces[kept], cross[kept]
    if np.linalg.det(turn) < 0:  # a mirror turns the corners' order round
        faces, cross, surface = faces[:, ::-1], -cross, surface.reversed()
    corners = places[faces].reshape(-1, 3)
    usable = normals is not None and len(normals) == len(vertices) and np.isfinite(normals).all()
    if not usable:
        return corners, _made_up_normals(corners, cross), surface
    turned = np.asarray(normals, dtype=np.float64) @ np.linalg.inv(turn).astype(np.float64)
    given = unit(turned[faces].reshape(-1, 3))
    flat = np.repeat(unit(cross), 3, axis=0)
    given = np.where(np.linalg.norm(given, axis=1, keepdims=True) > 0, given, flat)
    return corners, given, surface


def _made_up_normals(corners: Array, cross: Array) -> Array:
    """Smooth the facets' normals over what bends gently, and keep the edges."""
    size = float(np.ptp(corners, axis=0).max())
    place = welded(corners, 1e-6 * size)
    flat, weighted = np.repeat(unit(cross), 3, axis=0), np.repeat(cross, 3, axis=0)
    sums = [np.bincount(place, weights=weighted[:, axis]).astype(np.float64) for axis in range(3)]
    smooth = unit(np.stack(sums, axis=1))[place]
    gentle = np.einsum("ij,ij->i", flat, smooth) > _CREASE_COS
    return np.where(gentle[:, np.newaxis], smooth, flat)


def _merged(pieces: list[tuple[Array, Array, Surface]]) -> list[Part]:
    """Join what looks alike: every shape costs rendering time. What has no texture shares one of baked colours."""
    groups: dict[tuple[Any, ...], list[tuple[Array, Array, Surface]]] = {}
    for piece in pieces:
        surface = piece[2]
        groups.setdefault((id(surface.texture) if surface.texture is not None else None, surface.roughness), []).append(
            piece
        )
    parts = []
    for (_, roughness), group in groups.items():
        corners = np.concatenate([corners for corners, _, _ in group])
        normals = np.concatenate([normals for _, normals, _ in group])
        texture = group[0][2].texture
        if texture is None:
            uv, texture = baked(np.concatenate([surface.colours for _, _, surface in group]))
        else:
            uv = np.concatenate([surface.uv for _, _, surface in group])
        parts.append(Part(corners, normals, uv, texture, roughness))
    return parts
