"""Triangle meshes as Mitsuba shapes; all that touches Mitsuba's mesh interface, which changes with 3.10, is here."""

from __future__ import annotations

from typing import Any

import numpy as np

from simulator.render.scene import TriangleMesh


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
    parameters["vertex_positions"] = np.ravel(mesh.vertices_m * units_per_m).astype(np.float32)
    parameters["vertex_normals"] = np.ravel(mesh.normals).astype(np.float32)
    parameters["vertex_texcoords"] = np.ravel(mesh.uv).astype(np.float32)
    parameters["faces"] = np.ravel(mesh.faces).astype(np.uint32)
    parameters.update()
    return shape
