"""The tip of an endoscope: where it looks, its lamps beside the camera, what it sees roughly, and how bright to shine."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.endoscopy.organs import Course
from scenes.layout import rotation
from scenes.lights import tint
from simulator.render import SphereLight
from simulator.types import View

Array = NDArray[np.float64]

CLEARANCE_M = 6e-3
"""The wall stays this far from the camera, beyond the lamps beside it."""

_LAMPS = 3  # a fixed number: another would compile new kernels
_SLACK_M = 2e-3  # about half an edge of the walls' triangles: what juts into the view between its corners


@dataclass(frozen=True)
class Pose:
    """The camera: its place in metres, and the rows of ``axes`` (3, 3), its x (right), y (down) and z (into the scene)."""

    position_m: Array
    axes: Array

    def seen(self, points_m: Array) -> Array:
        """Return points ``(V, 3)`` in the camera's coordinates."""
        return (points_m - self.position_m) @ self.axes.T


def draw_poses(
    course: Course,
    arcs_m: Array,
    seconds: Array,
    loose_m: float,
    widest_rad: float,
    bend: float,
    rng: np.random.Generator,
) -> list[Pose]:
    """Draw how the tip goes along a centreline: beside it by ``loose_m`` at most, tilted, rolled, and swaying a little.

    ``arcs_m`` ``(T,)`` are the camera's arc lengths, ``seconds`` ``(T,)`` the frames' times, ``widest_rad`` the largest
    tilt; with ``bend`` 0 it looks straight along the centreline from its middle, with 1 as freely as ever.
    """
    side, roll = rng.uniform(0, 2 * math.pi, 2)
    away = bend * loose_m * math.sqrt(rng.uniform(0, 1))
    offset = away * np.array([math.cos(side), math.sin(side), 0])
    towards, tilt = rng.uniform(0, 2 * math.pi), bend * widest_rad * math.sqrt(rng.uniform(0, 1))
    still = rotation([0, 0, 1], roll) @ rotation([math.cos(towards), math.sin(towards), 0], tilt)
    sway, rate, phase = bend * math.radians(rng.uniform(0.5, 3)), rng.uniform(0.3, 1.5), rng.uniform(0, 2 * math.pi)
    swing = sway * (np.sin(2 * math.pi * rate * seconds + phase) - math.sin(phase))
    points, frames = course.at(arcs_m)
    return [
        Pose(point + offset @ frame, rotation([1, 0, 0], angle) @ still @ frame)
        for point, frame, angle in zip(points, frames, swing, strict=True)
    ]


def fits(view: View, vertices_m: Array) -> bool:
    """Say whether a wall, in the camera's coordinates, keeps clear of the camera and inside near..far, hidden parts too."""
    return bool(vertices_m[:, 2].max() <= 0.99 * view.far_m) and clears(view, vertices_m)


def clears(view: View, vertices_m: Array) -> bool:
    """Say whether a wall, in the camera's coordinates, keeps `CLEARANCE_M` away, and is beyond near where it is in view.

    What may jut into the view between vertices is allowed for.
    """
    x, y, z = vertices_m.T
    if np.einsum("ij,ij->i", vertices_m, vertices_m).min() < CLEARANCE_M**2:
        return False
    front = np.flatnonzero((z > -_SLACK_M) & (z < 1.03 * view.near_m + 0.25 * _SLACK_M))
    reach = np.maximum(z[front], 0)
    inside = (np.abs(x[front]) < view.tan_half_width * reach + _SLACK_M) & (
        np.abs(y[front]) < view.tan_half_height * reach + _SLACK_M
    )
    return not inside.any()


def pressed(view: View, vertices_m: Array) -> Array:
    """Return vertices with those beyond the far depth pulled to it along their lines of sight: the image stays the same."""
    deepest = 0.99 * view.far_m
    return vertices_m * np.minimum(1, deepest / np.maximum(vertices_m[:, 2:], deepest))


def draw_lamps(rng: np.random.Generator) -> list[SphereLight]:
    """Draw the lamps: glowing beads of 1 to 1.6 mm, 2.5 to 4 mm beside the camera's middle and wholly behind its plane.

    Together they have the intensity (radiance x radius^2) of 1: a white surface that faces them from a distance d has the
    radiance 1 / d^2.
    """
    angles = rng.uniform(0, 2 * math.pi) + 2 * math.pi / _LAMPS * (np.arange(_LAMPS) + rng.uniform(-0.15, 0.15, _LAMPS))
    shares = rng.uniform(0.3, 1, _LAMPS)
    shares /= shares.sum()
    colour = tint(rng.uniform(-0.06, 0.06))
    lamps = []
    for angle, share in zip(angles, shares, strict=True):
        away, radius = rng.uniform(0.0025, 0.004), rng.uniform(0.0005, 0.0008)
        centre = np.array([away * math.cos(angle), away * math.sin(angle), -radius])
        lamps.append(SphereLight(centre, radius, share / radius**2 * colour))
    return lamps


def direct_light(lamps: list[SphereLight], points_m: Array, normals: Array) -> Array:
    """Return the radiance ``(N,)`` of a white matt surface at points of a wall, by lamp light alone and without shadows.

    A lamp of radiance L and radius r at a distance d much larger than r gives pi L (r / d)^2 cos(angle) of irradiance, of
    which a white surface returns 1 / pi in every direction.
    """
    total = np.zeros(len(points_m))
    for lamp in lamps:
        towards = lamp.centre_m - points_m
        distance = np.linalg.norm(towards, axis=1)
        cosine = np.maximum(np.einsum("ij,ij->i", towards, normals), 0) / distance
        total += float(lamp.radiance.mean()) * (lamp.radius_m / distance) ** 2 * cosine
    return total


def brightened(lamps: list[SphereLight], factor: float) -> tuple[SphereLight, ...]:
    """Return the lamps with their radiance multiplied."""
    return tuple(SphereLight(lamp.centre_m, lamp.radius_m, lamp.radiance * factor) for lamp in lamps)


_RAYS = 9


@dataclass(frozen=True)
class Hits:
    """Where rays through the middles and edges of an image meet a surface first.

    Attributes:
        points_m: ``(N, 3)`` in the camera's coordinates, of the rays that meet it.
        face: ``(N,)`` the faces that they meet.
        missed: how many rays meet nothing.
    """

    points_m: Array
    face: NDArray[np.int64]
    missed: int


def first_hits(view: View, vertices_m: Array, faces: NDArray[np.integer]) -> Hits:
    """Follow 9 x 9 rays, evenly over the image and to its very edges, to the nearest face that looks at the camera.

    A ray r meets the triangle (a, b, c) where the triple products r.(a x b), r.(b x c), r.(c x a) agree in sign; their
    sum is r.n with the normal n, and the depth is a.n / r.n (homogeneous rasterisation, Olano and Greer, 1997). Vertices
    ``(V, 3)`` are in the camera's coordinates.
    """
    columns = np.linspace(-1, 1, _RAYS) * view.tan_half_width
    points, met = [np.empty((0, 3))], [np.empty(0, np.int64)]
    ahead = np.flatnonzero((vertices_m[:, 2] > 0)[faces].any(axis=1))
    for row in np.linspace(-1, 1, _RAYS) * view.tan_half_height:
        above = (vertices_m[:, 1] > row * vertices_m[:, 2])[faces[ahead]].sum(axis=1)
        crossed = ahead[(above > 0) & (above < 3)]  # faces on both sides of the row: few are left
        a, b, c = (vertices_m[faces[crossed, corner]] for corner in range(3))
        edges = np.stack([np.cross(a, b), np.cross(b, c), np.cross(c, a)])
        offset = np.einsum("ij,ij->i", a, edges[1])
        looking = offset < 0
        crossed, edges, offset = crossed[looking], edges[:, looking], offset[looking]
        if not len(crossed):
            continue
        rays = np.stack([columns, np.full(_RAYS, row), np.ones(_RAYS)])
        products = edges @ rays
        inside = (products <= 0).all(axis=0)
        inverse_depth = np.where(inside, products.sum(axis=0) / offset[:, np.newaxis], 0)
        nearest = inverse_depth.max(axis=0)
        points.append((rays[:, nearest > 0] / nearest[nearest > 0]).T)
        met.append(crossed[inverse_depth.argmax(axis=0)[nearest > 0]])
    found = np.concatenate(met)
    return Hits(np.concatenate(points), found, _RAYS**2 - len(found))
