"""From a Scene in metres and a View to a Mitsuba scene: shapes, materials, lights and the pinhole camera.

Mitsuba works in centimetres here: its shadow rays start 9e-5 (1 + |position|) units off a surface, which in metres would
be a 0.1 mm gap at every contact of a scene that is centimetres deep. Nothing outside this package sees the unit.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.render.mesh import mitsuba_mesh
from simulator.render.scene import Box, Environment, Material, Scene, Shape, Sphere, SphereLight, TriangleMesh
from simulator.types import View

UNITS_PER_M = 100.0
# Scalar rendering seeds its sampler block by block and sizes blocks by the number of threads unless told a size.
_BLOCK_SIZE = 16


def load_scene(scene: Scene, view: View, max_depth: int) -> Any:
    """Return a ``mitsuba.Scene`` with a path tracer and the view's pinhole camera; needs an active variant.

    Args:
        scene: shapes and lights.
        view: image shape, pinhole geometry and depth range.
        max_depth: longest light path, in segments.
    """
    import mitsuba as mi

    parts: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": max_depth, "block_size": _BLOCK_SIZE},
        "sensor": pinhole(view),
    }
    parts |= {f"light{number:03d}": _light(light) for number, light in enumerate(scene.lights)}
    parts |= {f"shape{number:04d}": _shape(shape) for number, shape in enumerate(scene.shapes)}
    return mi.load_dict(parts)


def pinhole(view: View) -> dict[str, Any]:
    """Return the pinhole camera at the mask centre as a Mitsuba dictionary.

    The box film keeps pixels apart (a wider filter would mix neighbours, and its result depends on the threads).
    """
    import mitsuba as mi

    rows, columns = view.shape
    look_into_scene = mi.ScalarTransform4f().look_at(origin=[0, 0, 0], target=[0, 0, 1], up=[0, -1, 0])
    nearest = view.near_m * UNITS_PER_M
    farthest = view.far_m * UNITS_PER_M if math.isfinite(view.far_m) else nearest
    return {
        "type": "perspective",
        "fov_axis": "x",
        "fov": math.degrees(2 * math.atan(view.tan_half_width)),
        "to_world": look_into_scene,
        # Far outside the depth range: clipping must never hide that a scene breaks it.
        "near_clip": 0.01 * nearest,
        "far_clip": 1e4 * farthest,
        # A fifth of the variance of independent samples at 6 % more time, and no correlation between pixels.
        "sampler": {"type": "multijitter"},
        "film": {
            "type": "hdrfilm",
            "width": columns,
            "height": rows,
            "rfilter": {"type": "box"},
            "pixel_format": "rgb",
            "component_format": "float32",
        },
    }


def _shape(shape: Shape) -> Any:
    bsdf = _bsdf(shape.material)
    if isinstance(shape, TriangleMesh):
        return mitsuba_mesh(shape, bsdf, UNITS_PER_M)
    if isinstance(shape, Sphere):
        return {"type": "sphere", "to_world": _placed(shape.centre_m, shape.rotation, shape.radius_m), "bsdf": bsdf}
    assert isinstance(shape, Box)
    return {"type": "cube", "to_world": _placed(shape.centre_m, shape.rotation, shape.half_size_m), "bsdf": bsdf}


def _placed(centre_m: NDArray[np.float64], rotation: NDArray[np.float64], scale_m: float | NDArray[np.float64]) -> Any:
    import mitsuba as mi

    matrix = np.eye(4)
    matrix[:3, :3] = rotation * scale_m * UNITS_PER_M  # broadcasts along columns: scale first, then turn
    matrix[:3, 3] = centre_m * UNITS_PER_M
    return mi.ScalarTransform4f(matrix.tolist())


def _bsdf(material: Material) -> dict[str, Any]:
    import mitsuba as mi

    texture = {
        "type": "bitmap",
        "bitmap": mi.Bitmap(np.ascontiguousarray(material.reflectance, dtype=np.float32)),
    }
    if material.roughness is None:
        return {"type": "diffuse", "reflectance": texture}
    # Not 'roughplastic': it integrates a table on construction, 0.05 CPU-s for every material of every scene.
    return {"type": "principled", "base_color": texture, "roughness": material.roughness, "specular": 0.5}


def _light(light: SphereLight | Environment) -> dict[str, Any]:
    radiance = {"type": "rgb", "value": [float(value) for value in light.radiance]}
    if isinstance(light, Environment):
        return {"type": "constant", "radiance": radiance}
    return {
        "type": "sphere",
        "center": [float(value) for value in light.centre_m * UNITS_PER_M],
        "radius": light.radius_m * UNITS_PER_M,
        "emitter": {"type": "area", "radiance": radiance},
    }
