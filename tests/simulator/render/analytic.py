"""Rays against spheres, boxes and triangles in closed form, float64, without Mitsuba: what the renderer must agree with.

Tests get it as the fixture ``analytic``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.render import Box, Scene, Sphere, SphereLight, TriangleMesh
from simulator.types import View

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Crossings:
    """All surfaces along rays from the origin, nearest first; a direction has z = 1, so a ray's parameter is depth.

    Attributes:
        z: ``(N, S)`` metres, ``inf`` after the last.
        shape: ``(N, S)`` number of the shape, lamps after them; -1 after the last.
        normal: ``(N, S, 3)`` outward unit normal of the surface itself.
        facing: ``(N, S)`` whether its outside is met.
        grazing: ``(N, S)`` cosine between ray and normal.
        weights: ``(N, S, 2)`` of a triangle's second and third vertex, else 0.
        triangle: ``(N, S)`` number of the triangle, else 0.
    """

    z: Array
    shape: NDArray[np.int64]
    normal: Array
    facing: NDArray[np.bool_]
    grazing: Array
    weights: Array
    triangle: NDArray[np.int64]


def directions(view: View) -> NDArray[Any]:
    """Directions ``(H W, 3)`` of the pixels' centres, z = 1: PHYSICS section 1, written out anew."""
    rows, columns = view.shape
    right = (np.arange(columns) - (columns - 1) / 2) * view.pixel_pitch_m / view.distance_m
    down = (np.arange(rows) - (rows - 1) / 2) * view.pixel_pitch_m / view.distance_m
    x, y = np.meshgrid(right, down)
    return np.stack([x, y, np.ones(view.shape)], axis=-1).reshape(-1, 3)


def trace(scene: Scene, rays: Array) -> Crossings:
    """Return all crossings of rays ``(N, 3)`` with z = 1."""
    found = []
    lamps = [light for light in scene.lights if isinstance(light, SphereLight)]
    for number, shape in enumerate((*scene.shapes, *lamps)):
        if isinstance(shape, Sphere | SphereLight):
            parts = _ball(shape.centre_m, shape.radius_m, rays)
        elif isinstance(shape, Box):
            parts = _box(shape, rays)
        else:
            parts = _triangles(shape, rays)
        found += [(z, np.full(len(rays), number), *rest) for z, *rest in parts]
    z, shape_id, normal, weights, triangle = (np.stack(values, axis=1) for values in zip(*found, strict=True))
    order = np.argsort(z, axis=1, kind="stable")
    z, shape_id, triangle = (np.take_along_axis(values, order, 1) for values in (z, shape_id, triangle))
    normal, weights = (np.take_along_axis(values, order[..., np.newaxis], 1) for values in (normal, weights))
    cosine = np.einsum("nsx,nx->ns", normal, rays / np.linalg.norm(rays, axis=1, keepdims=True))
    return Crossings(z, np.where(np.isfinite(z), shape_id, -1), normal, cosine < 0, np.abs(cosine), weights, triangle)


def _ball(centre: Array, radius: float, rays: Array) -> list[tuple[Array, ...]]:
    half_b, a = rays @ centre, np.sum(rays**2, axis=1)
    root = half_b**2 - a * (centre @ centre - radius**2)
    parts = []
    for sign in (-1, 1):
        with np.errstate(invalid="ignore"):
            z = np.where(root > 0, (half_b + sign * np.sqrt(root)) / a, np.inf)
        z = np.where(z > 0, z, np.inf)
        with np.errstate(invalid="ignore"):
            normal = np.nan_to_num((rays * z[:, np.newaxis] - centre) / radius, posinf=0, neginf=0)
        parts.append((z, normal, np.zeros((len(rays), 2)), np.zeros(len(rays), int)))
    return parts


def _box(box: Box, rays: Array) -> list[tuple[Array, ...]]:
    """Where a ray is between all three pairs of sides; normals are those of the sides met last and left first."""
    origin, along = -box.centre_m @ box.rotation, rays @ box.rotation
    sides = np.stack([(sign * box.half_size_m - origin) / along for sign in (-1, 1)])
    enters, leaves = sides.min(axis=0), sides.max(axis=0)
    hit = (enters.max(axis=1) < leaves.min(axis=1)) & (enters.max(axis=1) > 0)
    parts = []
    for z, axis, sign in (
        (enters.max(axis=1), enters.argmax(axis=1), -1),
        (leaves.min(axis=1), leaves.argmin(axis=1), 1),
    ):
        along_axis = np.take_along_axis(along, axis[:, np.newaxis], 1)[:, 0]
        normal = box.rotation.T[axis] * (sign * np.sign(along_axis))[:, np.newaxis]
        parts.append((np.where(hit, z, np.inf), normal, np.zeros((len(rays), 2)), np.zeros(len(rays), int)))
    return parts


def _triangles(mesh: TriangleMesh, rays: Array) -> list[tuple[Array, ...]]:
    parts = []
    for number, (first, second, third) in enumerate(mesh.vertices_m[mesh.faces]):
        normal = np.cross(second - first, third - first)
        basis = np.column_stack([second - first, third - first])
        with np.errstate(divide="ignore", invalid="ignore"):
            z = (normal @ first) / (rays @ normal)
            point = rays * z[:, np.newaxis]
            weights = np.linalg.lstsq(basis, (point - first).T, rcond=None)[0].T
            # Rays on the edge between two triangles meet both: better two crossings at one depth than none.
            inside = (z > 0) & np.all(weights >= -1e-9, axis=1) & (weights.sum(axis=1) <= 1 + 1e-9)
        unit = np.broadcast_to(normal / np.linalg.norm(normal), rays.shape)
        parts.append((np.where(inside, z, np.inf), unit, weights, np.full(len(rays), number)))
    return parts


def project(points: Array, view: View) -> Array:
    """Column and row of points ``(N, 3)``, pixel centres at whole numbers."""
    rows, columns = view.shape
    place = points[:, :2] / points[:, 2:] * view.distance_m / view.pixel_pitch_m
    return place + np.array([(columns - 1) / 2, (rows - 1) / 2])
