"""Triangle meshes as Mitsuba shapes; all that touches Mitsuba's mesh interface, which changes with 3.10, is here."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

from simulator.render.library import aligned
from simulator.render.scene import Box, TriangleMesh


def mitsuba_mesh(mesh: TriangleMesh, bsdf: dict[str, Any], units_per_m: float) -> Any:
    """Return a ``mitsuba.Mesh`` of the active variant.

    Args:
        mesh: the surface, metres.
        bsdf: its material as a Mitsuba dictionary.
        units_per_m: Mitsuba world units per metre.
    """
    import mitsuba as mi

    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    shape = mi.Mesh(
        "mesh",
        vertex_count=len(mesh.vertices_m),
        face_count=len(mesh.faces),
        has_vertex_normals=True,
        has_vertex_texcoords=True,
        props=properties,
    )
    parameters = mi.traverse(shape)
    for name, values in mesh_arrays(mesh, units_per_m).items():
        parameters[name] = values
    parameters.update()
    return shape


def mesh_arrays(mesh: TriangleMesh, units_per_m: float, unlike: TriangleMesh | None = None) -> dict[str, np.ndarray]:
    """Return the arrays of a mesh under Mitsuba's names, flat, in its number types.

    Args:
        mesh: the surface, metres.
        units_per_m: Mitsuba world units per metre.
        unlike: leave out texture coordinates and faces that are the same objects as this mesh's.
    """
    # Positions and normals always together: Mitsuba computes normals of its own for vertices that come without.
    floats = {"vertex_positions": mesh.vertices_m * units_per_m, "vertex_normals": mesh.normals}
    if unlike is None or unlike.uv is not mesh.uv:
        floats["vertex_texcoords"] = mesh.uv
    arrays = {name: aligned(np.ravel(values).astype(np.float32)) for name, values in floats.items()}
    if unlike is None or unlike.faces is not mesh.faces:
        arrays["faces"] = aligned(np.ravel(mesh.faces).astype(np.uint32))
    return arrays


def cuboid(box: Box) -> TriangleMesh:
    """Return a box as 12 triangles; every side shows its whole texture."""
    return TriangleMesh(
        vertices_m=box.centre_m + (_CORNERS * box.half_size_m) @ box.rotation.T,
        normals=_NORMALS @ box.rotation.T,
        uv=_UV,
        faces=_FACES,
        material=box.material,
    )


def _unit_cube() -> tuple[np.ndarray, ...]:
    """Four corners for each of six sides, their normals and texture coordinates, and two triangles a side."""
    corners, normals = [], []
    for axis, sign in product(range(3), (-1.0, 1.0)):
        normal, first, second = _side(axis, sign)
        corners += [normal + a * first + b * second for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        normals += [normal] * 4
    uv = np.tile([(0.0, 0.0), (1, 0), (1, 1), (0, 1)], (6, 1))
    faces = np.concatenate([np.array([(0, 1, 2), (0, 2, 3)]) + 4 * side for side in range(6)])
    return np.array(corners), np.array(normals), uv, faces


def _side(axis: int, sign: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Outward normal of a side and two axes along it, right-handed, so that corners run counter-clockwise from outside."""
    normal = sign * np.eye(3)[axis]
    first = np.eye(3)[(axis + 1) % 3]
    return normal, first, np.cross(normal, first)


_CORNERS, _NORMALS, _UV, _FACES = _unit_cube()
