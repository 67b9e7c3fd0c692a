"""From a Scene in metres and a View to a Mitsuba scene: shapes, materials, lights, the pinhole camera, changes over frames.

Mitsuba works in centimetres here: its shadow rays start 9e-5 (1 + |position|) units off a surface, which in metres would
be a 0.1 mm gap at every contact of a scene that is centimetres deep. Nothing outside this package sees the unit.
"""

from __future__ import annotations

import math
from collections import defaultdict
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.render.backend import mitsuba
from simulator.render.bands import band_film
from simulator.render.scene import (
    Box,
    Environment,
    EnvironmentMap,
    Light,
    Material,
    Scene,
    Shape,
    Sphere,
    SphereLight,
    TriangleMesh,
)
from simulator.types import View

UNITS_PER_M = 100.0
# Scalar rendering seeds its sampler block by block and sizes blocks by the number of threads unless told a size.
BLOCK_SIZE = 16


def load_scene(scene: Scene, view: View, max_depth: int, bands_nm: tuple[float, ...] = ()) -> Any:
    """Return a ``mitsuba.Scene`` with a path tracer and the view's `cameras`; needs an active variant.

    Light paths have at most ``max_depth`` segments. Edges of wavelength bands need a spectral variant (see
    `simulator.render.bands`).
    """
    return mitsuba().load_dict(scene_parts(scene, view, max_depth, bands_nm))


def scene_parts(scene: Scene, view: View, max_depth: int, bands_nm: tuple[float, ...] = ()) -> dict[str, Any]:
    """Return the same as Mitsuba's dictionary, whose shapes are objects of the active variant."""
    parts: dict[str, Any] = {"type": "scene", "integrator": path_tracer(max_depth, scene.hide_lights)}
    parts |= cameras(view, bands_nm)
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
    """Return the integrator as a Mitsuba dictionary; hidden lights (lamps and surroundings) are invisible to the camera."""
    return {"type": "path", "max_depth": max_depth, "hide_emitters": hide_lights, "block_size": BLOCK_SIZE}


IMAGE, SURROUNDINGS = 0, 1
"""The cameras' places among a scene's sensors."""


def cameras(view: View, bands_nm: tuple[float, ...] = ()) -> dict[str, dict[str, Any]]:
    """Return the camera of a view's image and, where it has a margin, that of the whole field in coarse pixels."""
    image = {"camera0": pinhole(view, bands_nm)}
    return image if view.margin == (0, 0) else image | {"camera1": pinhole(view.coarse_field[0], bands_nm)}


def pinhole(view: View, bands_nm: tuple[float, ...] = ()) -> dict[str, Any]:
    """Return the pinhole camera at the mask centre as a Mitsuba dictionary.

    The box film keeps pixels apart (a wider filter would mix neighbours, and its result depends on the threads).
    """
    mi = mitsuba()
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
    return _mesh(cuboid(shape) if isinstance(shape, Box) else shape, bsdf)


def placement(centre_m: NDArray[np.float64], radius_m: float, rotation: NDArray[np.float64] | None = None) -> Any:
    """Return the transform from the unit ball to a ball of the scene."""
    mi = mitsuba()
    matrix = np.eye(4)
    matrix[:3, :3] = (np.eye(3) if rotation is None else rotation) * radius_m * UNITS_PER_M
    matrix[:3, 3] = centre_m * UNITS_PER_M
    return mi.ScalarTransform4f(matrix.tolist())


def _bsdf(material: Material) -> dict[str, Any]:
    reflectance = texture(material.reflectance)
    if material.roughness is None:
        front: dict[str, Any] = {"type": "diffuse", "reflectance": reflectance}
    else:
        # Not 'roughplastic': it integrates a table on construction, 0.05 CPU-s for every material of every scene.
        front = {"type": "principled", "base_color": reflectance, "roughness": material.roughness, "specular": 0.5}
    return {"type": "twosided", "front": front}


def texture(reflectance: NDArray[np.float32]) -> dict[str, Any]:
    """Return a texture as a Mitsuba dictionary."""
    return {"type": "bitmap", "bitmap": mitsuba().Bitmap(np.ascontiguousarray(reflectance, dtype=np.float32))}


def _mesh(mesh: TriangleMesh, bsdf: dict[str, Any]) -> Any:
    """Return a ``mitsuba.Mesh``; all that touches its interface, which changes with 3.10, is here and in `_mesh_arrays`."""
    mi = mitsuba()
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
    for name, values in _mesh_arrays(mesh).items():
        parameters[name] = values
    parameters.update()
    return shape


def _mesh_arrays(mesh: TriangleMesh, unlike: TriangleMesh | None = None) -> dict[str, np.ndarray]:
    """Return the arrays of a mesh under Mitsuba's names, flat, in its number types and units.

    Texture coordinates and faces that are the same objects as those of ``unlike`` are left out.
    """
    # Positions and normals always together: Mitsuba computes normals of its own for vertices that come without.
    floats = {"vertex_positions": mesh.vertices_m * UNITS_PER_M, "vertex_normals": mesh.normals}
    if unlike is None or unlike.uv is not mesh.uv:
        floats["vertex_texcoords"] = mesh.uv
    arrays = {name: aligned(np.ravel(values).astype(np.float32)) for name, values in floats.items()}
    if unlike is None or unlike.faces is not mesh.faces:
        arrays["faces"] = aligned(np.ravel(mesh.faces).astype(np.uint32))
    return arrays


def aligned(values: NDArray[Any]) -> NDArray[Any]:
    """Return a contiguous copy that begins at a multiple of 64 bytes.

    Dr.Jit takes NumPy's memory as it lies, and compiles other kernels for arrays that happen to be aligned than for those
    that are not: one in a few dozen scenes would be compiled anew.
    """
    memory = np.empty(values.nbytes + 64, np.uint8)
    start = -memory.ctypes.data % 64
    copy = memory[start : start + values.nbytes].view(values.dtype).reshape(values.shape)
    copy[...] = values
    return copy


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
        normal, first = sign * np.eye(3)[axis], np.eye(3)[(axis + 1) % 3]
        second = np.cross(normal, first)  # right-handed: corners run counter-clockwise seen from outside
        corners += [normal + a * first + b * second for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        normals += [normal] * 4
    uv = np.tile([(0.0, 0.0), (1, 0), (1, 1), (0, 1)], (6, 1))
    faces = np.concatenate([np.array([(0, 1, 2), (0, 2, 3)]) + 4 * side for side in range(6)])
    return np.array(corners), np.array(normals), uv, faces


_CORNERS, _NORMALS, _UV, _FACES = _unit_cube()


def _light(light: Light) -> dict[str, Any]:
    mi = mitsuba()
    if isinstance(light, EnvironmentMap):
        bitmap = mi.Bitmap(np.ascontiguousarray(light.radiance, dtype=np.float32))
        upright = mi.ScalarTransform4f().rotate([0, 0, 1], 180)  # Mitsuba's maps have their zenith at +y
        return {"type": "envmap", "bitmap": bitmap, "to_world": upright}
    radiance = {"type": "rgb", "value": [float(value) for value in light.radiance]}
    if isinstance(light, Environment):
        return {"type": "constant", "radiance": radiance}
    placed = placement(light.centre_m, light.radius_m)
    return {"type": "sphere", "to_world": placed, "emitter": {"type": "area", "radiance": radiance}}


class Stage:
    """A Mitsuba scene of the active variant and what stands on it.

    Replacing contents costs a third of loading them, and no kernel is compiled anew. With LLVM the old stage must be gone
    (no reference to it left) before the next is made: a new scene beside a living one is compiled from scratch.

    Attributes:
        scene: what is shown now.
        loaded: the ``mitsuba.Scene``.
    """

    def __init__(self, scene: Scene, view: View, max_depth: int, bands_nm: tuple[float, ...] = ()) -> None:
        self.scene = scene
        self.loaded = load_scene(scene, view, max_depth, bands_nm)
        self._parameters: Any = None
        self._keys: dict[str, list[str]] = defaultdict(list)

    def show(self, scene: Scene) -> None:
        """Replace what differs from the scene that is shown; what is the same object (``is``) counts as equal.

        Raises:
            InputError: when the scene has other slots: kinds of shapes, materials and lights in order, sizes of meshes.
        """
        if self._parameters is None:
            self._parameters = mitsuba().traverse(self.loaded)
            for key in list(self._parameters.keys()):
                self._keys[key.partition(".")[0]].append(key)
        old = self.scene
        if len(old.shapes) != len(scene.shapes) or len(old.lights) != len(scene.lights):
            raise InputError(
                "frames",
                f"one has {len(old.shapes)} shapes and {len(old.lights)} lights, the next {len(scene.shapes)} and "
                f"{len(scene.lights)}; frames of a clip share their slots: park what is unused out of view",
            )
        if old.hide_lights != scene.hide_lights:
            raise InputError("frames", "hide_lights changes, which is part of the compiled path tracer; keep it")
        for number, (before, after) in enumerate(zip(old.shapes, scene.shapes, strict=True)):
            if before is not after:
                self._replace_shape(number, before, after)
        for number, (before, after) in enumerate(zip(old.lights, scene.lights, strict=True)):
            if before is not after:
                self._replace_light(number, before, after)
        self._parameters.update()
        self.scene = scene

    def _set(self, slot: str, ending: str, value: Any) -> None:
        key = next(key for key in self._keys[slot] if key.endswith(ending))
        self._parameters[key] = value
        # Scalar variants skip values that are equal to the old ones; normals that come with moved vertices must stay.
        self._parameters.set_dirty(key)

    def _replace_shape(self, number: int, before: Shape, after: Shape) -> None:
        slot = shape_name(number)
        if _kind(before) != _kind(after):
            raise InputError(
                "frames",
                f"shape {number} changes from {_kind(before)} to {_kind(after)}; a slot keeps its kind and size",
            )
        if isinstance(after, Sphere):
            self._set(slot, ".to_world", placement(after.centre_m, after.radius_m, after.rotation))
        else:
            old, new = (cuboid(shape) if isinstance(shape, Box) else shape for shape in (before, after))
            assert isinstance(old, TriangleMesh)
            assert isinstance(new, TriangleMesh)
            for name, values in _mesh_arrays(new, unlike=old).items():
                self._set(slot, f".{name}", values)
        if after.material is not before.material:
            self._set(slot, ".data", _texture_data(after.material.reflectance))
            if after.material.roughness is not None:
                self._set(slot, ".roughness.value", after.material.roughness)

    def _replace_light(self, number: int, before: Light, after: Light) -> None:
        slot = light_name(number)
        if type(before) is not type(after):
            raise InputError("frames", f"light {number} changes from {type(before).__name__} to {type(after).__name__}")
        if isinstance(after, EnvironmentMap):
            raise InputError(
                "frames", f"light {number}, an EnvironmentMap, cannot change within a clip; keep the object"
            )
        for name, value in _radiance_parameters(after.radiance).items():
            self._set(slot, f".{name}", value)
        if isinstance(after, SphereLight):
            self._set(slot, ".to_world", placement(after.centre_m, after.radius_m))


def _kind(shape: Shape) -> str:
    """Say what must not change within a slot."""
    material = shape.material
    kind = type(shape).__name__
    if isinstance(shape, TriangleMesh):
        kind += f" of {len(shape.vertices_m)} vertices and {len(shape.faces)} faces"
    coat = "matt" if material.roughness is None else "coated"
    rows, columns = material.reflectance.shape[:2]
    return f"{kind}, {coat}, with a texture of {rows} x {columns}"


def _texture_data(reflectance: NDArray[np.float32]) -> Any:
    """Return a texture's data: its colours, or in a spectral variant the coefficients that Mitsuba makes of them."""
    mi = mitsuba()
    if mi.is_spectral:
        return mi.traverse(mi.load_dict(texture(reflectance)))["data"]
    return mi.TensorXf(aligned(reflectance.astype(np.float32)))


def _radiance_parameters(radiance: NDArray[np.float64]) -> dict[str, Any]:
    """Return a light's parameters: its colour, or in a spectral variant a spectrum's coefficients and a scaled D65."""
    mi = mitsuba()
    colour = [float(value) for value in radiance]
    if not mi.is_spectral:
        return {"radiance.value": colour}
    light = mi.traverse(mi.load_dict({"type": "constant", "radiance": {"type": "rgb", "value": colour}}))
    return {name: light[name] for name in ("radiance.value", "radiance.d65.values")}
