"""Where the surface points that one frame sees will be in the next: motion vectors by following the surfaces themselves."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.render.gbuffer import GBuffer, is_scalar
from simulator.render.library import aligned, mitsuba
from simulator.render.mesh import cuboid
from simulator.render.mitsuba_scene import UNITS_PER_M
from simulator.render.scene import Box, Material, Scene, Sphere, SphereLight, TriangleMesh
from simulator.types import View

# A point that is nearer to the camera than this share of its distance hides nothing: it is the point itself, rounded.
_CLEARANCE = 2e-4
_GLOW = Material(np.zeros((1, 1, 3), np.float32))  # lamps reflect nothing


def moved_points(hits: GBuffer, before: Scene, after: Scene) -> NDArray[np.float64]:
    """Return where the points that a frame sees will be: metres ``(H, W, 3)``; NaN where nothing is seen.

    A triangle's point keeps its weights of the triangle's vertices, a ball's its place on the ball.

    Args:
        hits: what the frame sees.
        before: the frame's scene.
        after: the next frame's scene, with the same slots.
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
    """Return the motion ``(H, W, 3)``: pixels to the right, pixels down, metres away; zero where nothing is seen.

    Args:
        points_m: of `moved_points`.
        hits: what the frame sees.
        view: the pinhole.
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
    """Return which points ``(H, W, 3)`` are in the picture of a loaded scene, with no surface before them.

    Args:
        scene: the ``mitsuba.Scene``.
        points_m: metres; NaN is not seen.
        view: the pinhole.
    """
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
