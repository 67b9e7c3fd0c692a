"""What can be in a rendered scene, in metres and world axes (x right, y down, z into the scene, origin at the mask).

Plain data without Mitsuba, so that a family of scenes is geometry and numbers only; `mitsuba_scene` translates.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError

Vector: TypeAlias = NDArray[np.float64]
"""Three numbers: a position or size in metres, or R, G, B."""


@dataclass(frozen=True)
class Material:
    """How a surface reflects, on both its sides: there are no black backs, nor rims where smoothed normals lean away.

    Attributes:
        reflectance: linear RGB ``(h, w, 3)`` float32 in 0..1, wrapped over the surface's texture coordinates; it repeats.
            There is no transform of these coordinates: Dr.Jit would bake it into the kernel and compile every scene anew.
        roughness: None for a matt (Lambertian) surface, else 0..1: a dielectric coat of that roughness, like plastic.
    """

    reflectance: NDArray[np.float32]
    roughness: float | None = None

    def __post_init__(self) -> None:
        shape = self.reflectance.shape
        if len(shape) != 3 or shape[-1] != 3 or 0 in shape:
            raise InputError("Material.reflectance", f"expected (h, w, 3) linear RGB, got {shape}")
        if self.roughness is not None and not 0 <= self.roughness <= 1:
            raise InputError("Material.roughness", f"expected None or 0..1, got {self.roughness}")
        mean = float(self.reflectance.mean())
        # Texels that only steer interpolation, beside what is seen, may lie outside; the mean may not.
        if not (np.all(np.isfinite(self.reflectance)) and 0 <= mean <= 1):
            raise InputError(
                "Material.reflectance",
                f"expected finite and 0..1, got a mean of {mean:g}; more than 1 would make light",
            )


@dataclass(frozen=True)
class Sphere:
    """A ball: centre and radius in metres; ``rotation`` (3, 3) turns its texture."""

    centre_m: Vector
    radius_m: float
    material: Material
    rotation: NDArray[np.float64]

    def __post_init__(self) -> None:
        _check_ball("Sphere", self.centre_m, self.radius_m)


@dataclass(frozen=True)
class Box:
    """A cuboid: centre and half edge lengths in metres, ``rotation`` (3, 3) from its own axes to the world's."""

    centre_m: Vector
    half_size_m: Vector
    material: Material
    rotation: NDArray[np.float64]

    def __post_init__(self) -> None:
        if not (np.all(np.isfinite(self.centre_m)) and np.all(np.asarray(self.half_size_m) > 0)):
            raise InputError(
                "Box", f"expected a finite centre and positive half edges, got {self.centre_m} and {self.half_size_m}"
            )


@dataclass(frozen=True)
class TriangleMesh:
    """A surface of triangles.

    Attributes:
        vertices_m: ``(V, 3)`` metres.
        normals: ``(V, 3)`` unit shading normals, pointing outwards.
        uv: ``(V, 2)`` texture coordinates.
        faces: ``(F, 3)`` vertex numbers, counter-clockwise seen from outside.

    Raises:
        InputError: no faces, other shapes, numbers that are not finite, or faces of vertices that are not there.
    """

    vertices_m: NDArray[np.float64]
    normals: NDArray[np.float64]
    uv: NDArray[np.float64]
    faces: NDArray[np.integer]
    material: Material

    def __post_init__(self) -> None:
        count = len(self.vertices_m)
        for name, width in (("vertices_m", 3), ("normals", 3), ("uv", 2)):
            values = getattr(self, name)
            if values.shape != (count, width) or not np.all(np.isfinite(values)):
                raise InputError(
                    f"TriangleMesh.{name}",
                    f"expected ({count}, {width}) finite numbers, got {values.shape}; NaN is refused",
                )
        if self.faces.ndim != 2 or self.faces.shape[1] != 3 or len(self.faces) == 0:
            raise InputError("TriangleMesh.faces", f"expected (F, 3) with at least one face, got {self.faces.shape}")
        if self.faces.min() < 0 or self.faces.max() >= count:
            span = f"{self.faces.min()} to {self.faces.max()}"
            raise InputError(
                "TriangleMesh.faces", f"expected numbers of its {count} vertices, 0 to {count - 1}; got {span}"
            )


@dataclass(frozen=True)
class SphereLight:
    """A glowing ball: radiance linear RGB; large ones give soft shadows and little noise."""

    centre_m: Vector
    radius_m: float
    radiance: Vector

    def __post_init__(self) -> None:
        _check_ball("SphereLight", self.centre_m, self.radius_m)
        _check_radiance("SphereLight", self.radiance)


@dataclass(frozen=True)
class Environment:
    """Light of equal radiance (linear RGB) from everywhere, seen where no surface is."""

    radiance: Vector

    def __post_init__(self) -> None:
        _check_radiance("Environment", self.radiance)


@dataclass(frozen=True)
class EnvironmentMap:
    """Light from everywhere with an image of it: ``radiance`` ``(h, 2 h, 3)`` float32 linear RGB, latitude by longitude.

    Row 0 shines from above (-y); columns go once around the horizon, with the middle one straight ahead (+z).
    """

    radiance: NDArray[np.float32]

    def __post_init__(self) -> None:
        shape = self.radiance.shape
        if len(shape) != 3 or shape[0] < 2 or shape[1:] != (2 * shape[0], 3):
            raise InputError("EnvironmentMap.radiance", f"expected (h, 2 h, 3) with h of at least 2, got {shape}")
        _check_radiance("EnvironmentMap", self.radiance)


def _check_ball(kind: str, centre_m: Vector, radius_m: float) -> None:
    if not (np.all(np.isfinite(centre_m)) and 0 < radius_m < np.inf):
        raise InputError(kind, f"expected a finite centre and a positive radius, got {centre_m} and {radius_m} m")


def _check_radiance(kind: str, radiance: Vector | NDArray[np.float32]) -> None:
    low, high = np.min(radiance), np.max(radiance)
    if not (low >= 0 and high < np.inf):  # also catches NaN
        raise InputError(f"{kind}.radiance", f"expected finite numbers of at least 0, got {low:g} to {high:g}")


Shape: TypeAlias = Sphere | Box | TriangleMesh
Light: TypeAlias = SphereLight | Environment | EnvironmentMap


@dataclass(frozen=True)
class Scene:
    """Shapes and lights.

    With LLVM, scenes that hold the same kinds of shape, material and light in the same order share their compiled kernels;
    a new order costs about half a CPU-second. So a family gives each slot a fixed kind.

    Attributes:
        shapes: what is seen; a shape's number is its id in G-buffers.
        lights: what shines; lamps are seen too, with ids after those of the shapes.
        hide_lights: lamps and surroundings shine but are not seen: where no surface is, the image is black.

    Raises:
        InputError: no light, none that shines, or two surroundings.
    """

    shapes: tuple[Shape, ...]
    lights: tuple[Light, ...]
    hide_lights: bool = False

    def __post_init__(self) -> None:
        if not self.lights:
            raise InputError("Scene.lights", "got none, so the image would be black; add an Environment")
        if not any(np.any(light.radiance) for light in self.lights):
            raise InputError(
                "Scene.lights", f"all {len(self.lights)} have radiance 0, so the image would be black; let one shine"
            )
        surroundings = sum(not isinstance(light, SphereLight) for light in self.lights)
        if surroundings > 1:
            raise InputError(
                "Scene.lights", f"got {surroundings} surroundings (Environment, EnvironmentMap), expected at most one"
            )
