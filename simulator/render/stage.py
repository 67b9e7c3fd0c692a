"""A scene that is loaded into Mitsuba, whose contents are replaced slot by slot from frame to frame."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.render.library import aligned, mitsuba
from simulator.render.mesh import cuboid, mesh_arrays
from simulator.render.mitsuba_scene import UNITS_PER_M, light_name, load_scene, placement, shape_name, texture
from simulator.render.scene import Box, EnvironmentMap, Light, Scene, Shape, Sphere, SphereLight, TriangleMesh
from simulator.types import View


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

        Args:
            scene: the same kinds of shapes, materials and lights in the same order, meshes with as many vertices and faces.

        Raises:
            InputError: when it has other slots.
        """
        if self._parameters is None:
            self._parameters = _traversed(self.loaded)
            for key in self._parameters.keys():  # noqa: SIM118 (no dictionary)
                self._keys[key.partition(".")[0]].append(key)
        old = self.scene
        if len(old.shapes) != len(scene.shapes) or len(old.lights) != len(scene.lights):
            msg = (
                f"frames: one has {len(old.shapes)} shapes and {len(old.lights)} lights, the next {len(scene.shapes)} and "
                f"{len(scene.lights)}; frames of a clip share their slots: park what is unused out of view"
            )
            raise InputError(msg)
        if old.hide_lights != scene.hide_lights:
            msg = "frames: hide_lights changes within a clip; it belongs to the compiled path tracer, so keep it"
            raise InputError(msg)
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
            msg = (
                f"frames: shape {number} changes from {_kind(before)} to {_kind(after)}; a slot keeps its kind and size"
            )
            raise InputError(msg)
        if isinstance(after, Sphere):
            self._set(slot, ".to_world", placement(after.centre_m, after.radius_m, after.rotation))
        else:
            old, new = (cuboid(shape) if isinstance(shape, Box) else shape for shape in (before, after))
            assert isinstance(old, TriangleMesh)
            assert isinstance(new, TriangleMesh)
            for name, values in mesh_arrays(new, UNITS_PER_M, unlike=old).items():
                self._set(slot, f".{name}", values)
        if after.material is not before.material:
            self._set(slot, ".data", _texture_data(after.material.reflectance))
            if after.material.roughness is not None:
                self._set(slot, ".roughness.value", after.material.roughness)

    def _replace_light(self, number: int, before: Light, after: Light) -> None:
        slot = light_name(number)
        if type(before) is not type(after):
            msg = f"frames: light {number} changes from {type(before).__name__} to {type(after).__name__}"
            raise InputError(msg)
        if isinstance(after, EnvironmentMap):
            msg = (
                f"frames: light {number} is an EnvironmentMap, which cannot change within a clip; keep the same object"
            )
            raise InputError(msg)
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
        return _traversed(mi.load_dict(texture(reflectance)))["data"]
    return mi.TensorXf(aligned(reflectance.astype(np.float32)))


def _radiance_parameters(radiance: NDArray[np.float64]) -> dict[str, Any]:
    """Return a light's parameters: its colour, or in a spectral variant a spectrum's coefficients and a scaled D65."""
    mi = mitsuba()

    colour = [float(value) for value in radiance]
    if not mi.is_spectral:
        return {"radiance.value": colour}
    light = _traversed(mi.load_dict({"type": "constant", "radiance": {"type": "rgb", "value": colour}}))
    return {name: light[name] for name in ("radiance.value", "radiance.d65.values")}


def _traversed(loaded: Any) -> Any:
    mi = mitsuba()

    return mi.traverse(loaded)
