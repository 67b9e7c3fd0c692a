"""What one ray through each pixel's centre meets: depth, which shape, where on it, and where that will be in the next frame.

Depth is z from the mask plane, not ray length, and never a mix of two surfaces. The camera stands at the world's origin and
looks along z, so z is the hit's own coordinate. Mitsuba's `aov` integrator mixes fore- and background at edges, and
measures from its near plane.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.render.backend import drjit, mitsuba
from simulator.render.bands import albedo_of
from simulator.render.mitsuba_scene import IMAGE, UNITS_PER_M, aligned, cuboid, scene_order
from simulator.render.scene import Box, Material, Scene, Sphere, SphereLight, TriangleMesh
from simulator.types import View

NOTHING = -1
"""Shape id where no surface is seen."""


@dataclass(frozen=True)
class GBuffer:
    """What the pixels' centres see.

    Attributes:
        depth_m: ``(H, W)`` float64, z in metres; ``inf`` where nothing is seen.
        shape_id: ``(H, W)`` int32, position in ``Scene.shapes`` and, after them, ``Scene.lights``; -1 where nothing is seen.
        point_m: ``(H, W, 3)`` float32, where the ray hits.
        triangle: ``(H, W)`` int64, number of the triangle of a mesh or box.
        barycentric: ``(H, W, 2)`` float32, weights of the triangle's second and third vertex.
        normal: ``(H, W, 3)`` float32, unit shading normal in world axes, turned towards the camera.
        albedo: ``(H, W, 3)`` float32, diffuse reflectance.
    """

    depth_m: NDArray[np.float64]
    shape_id: NDArray[np.int32]
    point_m: NDArray[np.float32]
    triangle: NDArray[np.int64]
    barycentric: NDArray[np.float32]
    normal: NDArray[np.float32]
    albedo: NDArray[np.float32]


def centre_depth(scene: Any, camera: int = IMAGE) -> NDArray[np.float64]:
    """Return z in metres ``(H, W)`` of what the pixels' centres see in a ``mitsuba.Scene``; ``inf`` where nothing is seen."""
    rows, columns = film_shape(scene, camera)
    if is_scalar():
        z = np.full(rows * columns, np.inf)
        for pixel, ray in enumerate(centre_rays(scene, camera)):
            hit = scene.ray_intersect_preliminary(ray)
            if hit.is_valid():
                z[pixel] = ray(hit.t).z
    else:
        dr = drjit()
        ray = centre_rays(scene, camera)
        hit = scene.ray_intersect_preliminary(ray)
        z = np.array(dr.select(hit.is_valid(), ray(hit.t).z, dr.inf), dtype=np.float64)
    return z.reshape(rows, columns) / UNITS_PER_M


def centre_gbuffer(scene: Any, camera: int = IMAGE) -> GBuffer:
    """Return all that is known of what each pixel's centre sees in a ``mitsuba.Scene`` of `load_scene`, of either variant."""
    rows, columns = film_shape(scene, camera)
    found = _look_one_by_one(scene, camera) if is_scalar() else _look_at_all(scene, camera)
    shaped = {name: values.reshape(rows, columns, *values.shape[1:]) for name, values in found.items()}
    seen = shaped["seen"].astype(bool)
    return GBuffer(
        # As in `centre_depth`, bit for bit: what else is asked for must not change a depth.
        depth_m=np.where(seen, shaped["z"], np.inf).astype(np.float64) / UNITS_PER_M,
        shape_id=np.where(seen, shaped["shape"], NOTHING).astype(np.int32),
        point_m=(shaped["point"] / UNITS_PER_M).astype(np.float32),
        triangle=shaped["triangle"].astype(np.int64),
        barycentric=shaped["barycentric"].astype(np.float32),
        normal=shaped["normal"].astype(np.float32),
        albedo=np.clip(shaped["albedo"], 0, 1).astype(np.float32),  # rough metals of a user's own scene say 20
    )


def is_scalar() -> bool:
    """Whether the active variant handles one ray at a time."""
    return str(mitsuba().variant()).startswith("scalar")


def film_shape(scene: Any, camera: int = IMAGE) -> tuple[int, int]:
    """Return rows and columns of a camera's image."""
    columns, rows = (int(size) for size in scene.sensors()[camera].film().size())
    return rows, columns


def centre_rays(scene: Any, camera: int = IMAGE) -> Any:
    """Return the rays through the pixels' centres, row by row: all of them at once, or one by one in a scalar variant."""
    mi = mitsuba()
    sensor = scene.sensors()[camera]
    rows, columns = film_shape(scene, camera)
    if is_scalar():
        return (
            sensor.sample_ray(0.0, 0.5, [(column + 0.5) / columns, (row + 0.5) / rows], [0.5, 0.5])[0]
            for row in range(rows)
            for column in range(columns)
        )
    dr = drjit()
    pixel = dr.arange(mi.UInt32, rows * columns)
    row = pixel // columns
    column = pixel - row * columns
    position = mi.Point2f((mi.Float(column) + 0.5) / columns, (mi.Float(row) + 0.5) / rows)
    return sensor.sample_ray(0.0, 0.5, position, 0.5)[0]


def order_by_registry(scene: Any) -> NDArray[np.int64]:
    """Return a table from the numbers of Dr.Jit's registry, given as shapes are made, to a loaded scene's own."""
    dr, mi = drjit(), mitsuba()
    numbers = [int(dr.reinterpret_array(mi.UInt32, mi.ShapePtr(shape))[0]) for shape in scene.shapes()]
    order = np.full(max(numbers, default=0) + 1, NOTHING)
    order[numbers] = scene_order(scene)
    return order


def order_by_id(scene: Any) -> dict[str, int]:
    """Return the same for a scalar variant, by the shapes' names."""
    return dict(zip((shape.id() for shape in scene.shapes()), scene_order(scene), strict=True))


def _look_at_all(scene: Any, camera: int) -> dict[str, NDArray[Any]]:
    dr, mi = drjit(), mitsuba()
    ray = centre_rays(scene, camera)
    first = scene.ray_intersect_preliminary(ray)
    seen = first.is_valid()
    hit = first.compute_surface_interaction(ray, mi.RayFlags.All, seen)
    albedo = _albedo(hit.bsdf(ray), hit, seen)
    normal = dr.select(dr.dot(hit.sh_frame.n, ray.d) > 0, -hit.sh_frame.n, hit.sh_frame.n)
    order = order_by_registry(scene)
    shape = dr.reinterpret_array(mi.UInt32, hit.shape)
    instance = dr.reinterpret_array(mi.UInt32, hit.instance)
    return {
        "seen": np.array(seen),
        "shape": order[np.array(dr.select(seen, dr.select(instance != 0, instance, shape), 0))],
        "z": np.array(dr.select(seen, ray(first.t).z, 0)),
        "point": _columns(dr.select(seen, hit.p, 0)),
        "triangle": np.array(dr.select(seen, first.prim_index, 0)),
        "barycentric": _columns(dr.select(seen, first.prim_uv, 0)),
        "normal": _columns(dr.select(seen, normal, 0)),
        "albedo": _columns(dr.select(seen, albedo, 0)),
    }


def _albedo(bsdf: Any, hit: Any, *more: Any) -> Any:
    if mitsuba().is_spectral:
        return albedo_of(bsdf, hit, *more)
    return bsdf.eval_diffuse_reflectance(hit, *more)


def _columns(vectors: Any) -> NDArray[Any]:
    """Dr.Jit keeps the components first."""
    return np.array(vectors).T


def _look_one_by_one(scene: Any, camera: int) -> dict[str, NDArray[Any]]:
    mi = mitsuba()
    order = order_by_id(scene)
    rows, columns = film_shape(scene, camera)
    count = rows * columns
    found = {"seen": np.zeros(count, bool), "shape": np.zeros(count, np.int32), "triangle": np.zeros(count, np.int64)}
    found |= {name: np.zeros((count, 3)) for name in ("point", "normal", "albedo")} | {
        "barycentric": np.zeros((count, 2)),
        "z": np.zeros(count),
    }
    for pixel, ray in enumerate(centre_rays(scene, camera)):
        first = scene.ray_intersect_preliminary(ray)
        if not first.is_valid():
            continue
        hit = first.compute_surface_interaction(ray, mi.RayFlags.All)
        normal = np.array(hit.sh_frame.n)
        found["seen"][pixel] = True
        found["shape"][pixel] = order[(hit.instance or hit.shape).id()]
        found["z"][pixel] = ray(first.t).z
        found["point"][pixel] = hit.p
        found["triangle"][pixel] = first.prim_index
        found["barycentric"][pixel] = first.prim_uv
        found["normal"][pixel] = -normal if normal @ np.array(ray.d) > 0 else normal
        found["albedo"][pixel] = _albedo(hit.bsdf(), hit)
    return found


# A point that is nearer to the camera than this share of its distance hides nothing: it is the point itself, rounded.
_CLEARANCE = 2e-4
_GLOW = Material(np.zeros((1, 1, 3), np.float32))  # lamps reflect nothing


def moved_points(hits: GBuffer, before: Scene, after: Scene) -> NDArray[np.float64]:
    """Return where the points that a frame sees will be in the next one: metres ``(H, W, 3)``; NaN where nothing is seen.

    A triangle's point keeps its weights of the triangle's vertices, a ball's its place on the ball. Both scenes have the same
    slots.
    """
    points = np.full((*hits.shape_id.shape, 3), np.nan)
    for number in np.unique(hits.shape_id[hits.shape_id >= 0]):
        seen = hits.shape_id == number
        old, new = (_shape(scene, int(number)) for scene in (before, after))
        if old is new:
            points[seen] = hits.point_m[seen]
        elif isinstance(new, Sphere):
            assert isinstance(old, Sphere)
            place = (hits.point_m[seen] - old.centre_m) @ old.rotation / old.radius_m
            points[seen] = new.centre_m + new.radius_m * place @ new.rotation.T
        else:
            second, third = np.moveaxis(hits.barycentric[seen].astype(np.float64), -1, 0)
            corners = new.vertices_m[new.faces[hits.triangle[seen]]]
            weights = np.stack([1 - second - third, second, third], axis=-1)
            points[seen] = np.einsum("nc,ncx->nx", weights, corners)
    return points


def motion_vectors(points_m: NDArray[np.float64], hits: GBuffer, view: View) -> NDArray[np.float32]:
    """Return the motion ``(H, W, 3)`` of what a frame sees to `moved_points`.

    Pixels to the right, pixels down, metres away; zero where nothing is seen.
    """
    rows, columns = hits.shape_id.shape
    column, row = np.meshgrid(np.arange(columns), np.arange(rows))
    here = np.stack([column, row, hits.depth_m], axis=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        there = np.concatenate([project(points_m, view), points_m[..., 2:]], axis=-1)
        return np.nan_to_num(there - here, nan=0.0, posinf=0.0, neginf=0.0).astype(np.float32)


def project(points_m: NDArray[np.float64], view: View) -> NDArray[np.float64]:
    """Return column and row ``(..., 2)`` of points ``(..., 3)`` in metres; pixel centres are whole numbers."""
    scale = view.distance_m / view.pixel_pitch_m
    middle = (np.array([view.shape[1], view.shape[0]]) - 1) / 2
    return points_m[..., :2] / points_m[..., 2:] * scale + middle


def seen_points(scene: Any, points_m: NDArray[np.float64], view: View) -> NDArray[np.bool_]:
    """Return which points ``(H, W, 3)``, metres or NaN, are in the image of a loaded scene with no surface before them."""
    with np.errstate(invalid="ignore", divide="ignore"):
        place = project(points_m, view)
        inside = np.all((place > -0.5) & (place < np.array(view.shape)[::-1] - 0.5), axis=-1) & (points_m[..., 2] > 0)
    # Points that need no ray get one all the same: as many rays in every frame use one compiled kernel.
    targets = np.where(inside[..., np.newaxis], points_m * UNITS_PER_M, (0.0, 0.0, 1.0)).reshape(-1, 3)
    return inside & ~_blocked(scene, targets).reshape(inside.shape)


def _blocked(scene: Any, targets: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether something stands between the origin and each target ``(N, 3)``."""
    mi = mitsuba()
    distance = np.linalg.norm(targets, axis=-1)
    directions = targets / distance[:, np.newaxis]
    reach = distance * (1 - _CLEARANCE)
    if is_scalar():
        blocked = np.zeros(len(targets), bool)
        for number, (direction, limit) in enumerate(zip(directions, reach, strict=True)):
            ray = mi.Ray3f([0.0, 0.0, 0.0], direction.tolist())
            ray.maxt = float(limit)
            blocked[number] = scene.ray_test(ray)
        return blocked
    ray = mi.Ray3f(o=mi.Point3f(0.0), d=mi.Vector3f(aligned(directions.T.astype(np.float32))))
    ray.maxt = mi.Float(aligned(reach.astype(np.float32)))
    return np.array(scene.ray_test(ray))


def _shape(scene: Scene, number: int) -> Sphere | TriangleMesh:
    """Return a shape, or a lamp, whose number comes after those of the shapes; boxes as triangles."""
    if number >= len(scene.shapes):
        lamp = scene.lights[number - len(scene.shapes)]
        assert isinstance(lamp, SphereLight)
        return Sphere(lamp.centre_m, lamp.radius_m, _GLOW, np.eye(3))
    shape = scene.shapes[number]
    return cuboid(shape) if isinstance(shape, Box) else shape
