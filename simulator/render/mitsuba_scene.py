"""From a Scene in metres and a View to a Mitsuba scene: shapes, materials, lights and the pinhole camera.

Mitsuba works in centimetres here: its shadow rays start 9e-5 (1 + |position|) units off a surface, which in metres would
be a 0.1 mm gap at every contact of a scene that is centimetres deep. Nothing outside this package sees the unit.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.render.bands import band_film
from simulator.render.mesh import cuboid, mitsuba_mesh
from simulator.render.scene import Box, Environment, EnvironmentMap, Light, Material, Scene, Shape, Sphere
from simulator.types import View

UNITS_PER_M = 100.0
# Scalar rendering seeds its sampler block by block and sizes blocks by the number of threads unless told a size.
BLOCK_SIZE = 16


def load_scene(scene: Scene, view: View, max_depth: int, bands_nm: tuple[float, ...] = ()) -> Any:
    """Return a ``mitsuba.Scene`` with a path tracer and the view's pinhole camera; needs an active variant.

    Args:
        scene: shapes and lights.
        view: image shape, pinhole geometry and depth range.
        max_depth: longest light path, in segments.
        bands_nm: edges of wavelength bands; needs a spectral variant (see `simulator.render.bands`).
    """
    import mitsuba as mi

    return mi.load_dict(scene_parts(scene, view, max_depth, bands_nm))


def scene_parts(scene: Scene, view: View, max_depth: int, bands_nm: tuple[float, ...] = ()) -> dict[str, Any]:
    """Return the same as Mitsuba's dictionary, whose shapes are objects of the active variant."""
    parts: dict[str, Any] = {"type": "scene", "integrator": path_tracer(max_depth, scene.hide_lights)}
    parts["sensor"] = pinhole(view, bands_nm)
    parts |= {light_name(number): _light(light) for number, light in enumerate(scene.lights)}
    return parts | {shape_name(number): _shape(shape) for number, shape in enumerate(scene.shapes)}


def shape_name(number: int) -> str:
    """Return the name by which Mitsuba knows a shape of a scene."""
    return f"shape{number:04d}"


def light_name(number: int) -> str:
    """Return the name by which Mitsuba knows a light of a scene."""
    return f"light{number:03d}"


def scene_order(loaded: Any) -> list[int]:
    """Return, for each shape of a loaded scene, its number: its place among the shapes, lamps after them."""
    names = [shape.id() for shape in loaded.shapes()]
    shapes = sum(name.startswith("shape") for name in names)
    return [int(name[5:]) + (0 if name.startswith("shape") else shapes) for name in names]


def path_tracer(max_depth: int, hide_lights: bool = False) -> dict[str, Any]:
    """Return the integrator as a Mitsuba dictionary.

    Args:
        max_depth: longest light path, in segments.
        hide_lights: whether lamps and surroundings are invisible to the camera.
    """
    return {"type": "path", "max_depth": max_depth, "hide_emitters": hide_lights, "block_size": BLOCK_SIZE}


def pinhole(view: View, bands_nm: tuple[float, ...] = ()) -> dict[str, Any]:
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
            "width": columns,
            "height": rows,
            "rfilter": {"type": "box"},
            "component_format": "float32",
            **({"type": "specfilm"} | band_film(bands_nm) if bands_nm else {"type": "hdrfilm", "pixel_format": "rgb"}),
        },
    }


def _shape(shape: Shape) -> Any:
    bsdf = _bsdf(shape.material)
    if isinstance(shape, Sphere):
        return {"type": "sphere", "to_world": placement(shape.centre_m, shape.radius_m, shape.rotation), "bsdf": bsdf}
    return mitsuba_mesh(cuboid(shape) if isinstance(shape, Box) else shape, bsdf, UNITS_PER_M)


def placement(centre_m: NDArray[np.float64], radius_m: float, rotation: NDArray[np.float64] | None = None) -> Any:
    """Return the transform from the unit ball to a ball of the scene."""
    import mitsuba as mi

    matrix = np.eye(4)
    matrix[:3, :3] = (np.eye(3) if rotation is None else rotation) * radius_m * UNITS_PER_M
    matrix[:3, 3] = centre_m * UNITS_PER_M
    return mi.ScalarTransform4f(matrix.tolist())


def texture(reflectance: NDArray[np.float32]) -> dict[str, Any]:
    """Return a texture as a Mitsuba dictionary."""
    import mitsuba as mi

    return {"type": "bitmap", "bitmap": mi.Bitmap(np.ascontiguousarray(reflectance, dtype=np.float32))}


def _bsdf(material: Material) -> dict[str, Any]:
    reflectance = texture(material.reflectance)
    if material.roughness is None:
        front: dict[str, Any] = {"type": "diffuse", "reflectance": reflectance}
    else:
        # Not 'roughplastic': it integrates a table on construction, 0.05 CPU-s for every material of every scene.
        front = {"type": "principled", "base_color": reflectance, "roughness": material.roughness, "specular": 0.5}
    return {"type": "twosided", "front": front}


def _light(light: Light) -> dict[str, Any]:
    import mitsuba as mi

    if isinstance(light, EnvironmentMap):
        bitmap = mi.Bitmap(np.ascontiguousarray(light.radiance, dtype=np.float32))
        upright = mi.ScalarTransform4f().rotate([0, 0, 1], 180)  # Mitsuba's maps have their zenith at +y
        return {"type": "envmap", "bitmap": bitmap, "to_world": upright}
    radiance = {"type": "rgb", "value": [float(value) for value in light.radiance]}
    if isinstance(light, Environment):
        return {"type": "constant", "radiance": radiance}
    placed = placement(light.centre_m, light.radius_m)
    return {"type": "sphere", "to_world": placed, "emitter": {"type": "area", "radiance": radiance}}
