"""Where clips are acted: the part of the view that things may use, a wall and a floor around it, and their lights."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.layout import far_end
from scenes.lights import draw_room as draw_surroundings
from scenes.lights import lamp
from scenes.meshes import backdrop, face_cross, unit
from scenes.textures import draw_ramp, draw_reflectance
from simulator.render import EnvironmentMap, Material, SphereLight, TriangleMesh
from simulator.types import View

Array = NDArray[np.float64]
_MARGIN = 1.005
# A wall or floor is one triangle, larger than the image: a ray that hits an edge between two triangles can slip through in
# float32, and the diagonal of a rectangle runs through many pixels' centres when it is the image's own.
_FACE = np.array([(0, 1, 2)])


@dataclass(frozen=True)
class Room:
    """The space of a view between its near depth, a wall and a floor.

    Attributes:
        view: the frustum.
        near_m: nothing comes nearer.
        wall_m: depth of the wall's nearest point.
        wall_slant: how much the wall's disparity grows from the image's middle to its right edge, in units of the largest.
        floor_m: how far below the optical axis the floor lies, y.
    """

    view: View
    near_m: float
    wall_m: float
    wall_slant: float
    floor_m: float

    @property
    def half(self) -> Array:
        """Tangents of the angles to the image's right and lower edge, ``(2,)``."""
        return np.array([self.view.tan_half_width, self.view.tan_half_height])

    @property
    def floor_begins_m(self) -> float:
        """Depth from which on the floor is in the image."""
        return self.floor_m / self.view.tan_half_height

    def place(self, across: ArrayLike, depth_m: float) -> Array:
        """Return the point that is seen at a place of the image, both -1..1 from edge to edge, in a depth."""
        return np.array([*(np.asarray(across) * self.half * depth_m), depth_m])

    def seen(self, points_m: Array) -> NDArray[np.bool_]:
        """Return which points ``(n, 3)`` are in the image."""
        return np.all(np.abs(points_m[:, :2]) <= self.half * points_m[:, 2:], axis=1)

    def holds(self, points_m: Array, radius_m: float, *, above_floor: bool = True) -> bool:
        """Whether a ball stays between near depth, wall and floor at all points ``(n, 3)``."""
        depth = points_m[:, 2]
        inside = depth.min() - radius_m >= self.near_m and depth.max() + radius_m <= self.wall_m
        return bool(inside and (not above_floor or points_m[:, 1].max() + radius_m <= self.floor_m))


def draw_room(view: View, rng: np.random.Generator) -> Room:
    """Draw how deep a room is and how high the camera stands over its floor, which is seen in the lower part.

    Raises:
        InputError: when the depth range is too thin to hold solids.
    """
    near, far = view.near_m * _MARGIN, far_end(view) / _MARGIN
    farthest = far * (near / far) ** rng.uniform(0, 0.3)
    slant = rng.uniform(-0.15, 0.15) * (1 - near / farthest)
    wall = farthest * (1 - 2 * abs(slant))
    # In the depth ``wall`` the floor is this share of the way from the axis to the image's lower edge.
    lowest = near / wall
    share = max(rng.uniform(0.35, 0.75), lowest)
    return Room(view, near, wall, slant, share * view.tan_half_height * wall)


def wall_of(room: Room, theme: Array, size: int, rng: np.random.Generator) -> TriangleMesh:
    """Return a textured plane that fills the image behind the room; its disparity is linear over the image."""
    across = np.array([(-1.1, -1.1), (3.4, -1.1), (-1.1, 3.4)])
    disparity = (1 - abs(room.wall_slant) + room.wall_slant * across[:, 0]) / room.wall_m
    corners = np.column_stack([across * room.half, np.ones(3)]) / disparity[:, np.newaxis]
    uv = corners[:, :2] * rng.uniform(1.0, 2.5) / (2 * room.view.tan_half_width * room.wall_m)
    return _plane(corners, uv, _muted(theme, size, rng))


def behind(room: Room, theme: Array, size: int, rng: np.random.Generator) -> TriangleMesh:
    """Return a plane that fills the view's margin where the wall ends; it lies behind all of it."""
    return backdrop(room.view, 2.5 * room.wall_m, Material(_muted(theme, size, rng)), rng.uniform(1.0, 2.5))


def floor_of(room: Room, theme: Array, size: int, rng: np.random.Generator) -> TriangleMesh:
    """Return the textured floor, a wedge from behind the camera to behind the wall."""
    tip = -0.2 * room.wall_m
    back = 1.3 * room.wall_m / (1 - 2 * abs(room.wall_slant))
    reach = 1.1 * room.view.field.tan_half_width * (back - tip)
    corners = np.array([(-reach, room.floor_m, back), (reach, room.floor_m, back), (0, room.floor_m, tip)])
    turn = rng.uniform(0, np.pi)
    along = np.array([np.cos(turn), np.sin(turn)])
    ground = corners[:, [0, 2]] * rng.uniform(0.6, 1.4) / room.wall_m
    uv = np.stack([ground @ along, ground @ (-along[1], along[0])], axis=1)
    return _plane(corners, uv, _muted(theme, size, rng))


def lamps_of(room: Room, rng: np.random.Generator) -> tuple[SphereLight, EnvironmentMap]:
    """Return a lamp behind the camera and surroundings with windows, with white balanced only roughly.

    Together they give a white surface that faces the camera a radiance of 1.2 to 1.9.
    """
    exposure, share = rng.uniform(1.2, 1.9), rng.uniform(0.5, 0.8)
    warmth = rng.uniform(-0.15, 0.15)
    direction = unit(np.array([rng.choice([-1.0, 1.0]) * rng.uniform(0.2, 1.0), rng.uniform(-1.3, -0.3), -1.0]))
    distance = room.wall_m * rng.uniform(2.0, 3.5)
    radius = distance * rng.uniform(0.1, 0.2)
    return (
        lamp(np.array([0, 0, room.wall_m / 2]), direction, distance, radius, exposure * share, warmth),
        draw_surroundings(rng, exposure * (1 - share), -warmth / 2),
    )


def _muted(theme: Array, size: int, rng: np.random.Generator) -> NDArray[np.float32]:
    """Draw a reflectance of less colour and contrast than that of things, which stand out from it."""
    reflectance = draw_reflectance(rng, draw_ramp(rng, theme, saturation=(0.02, 0.35)), size)
    tone = reflectance.mean(axis=(0, 1))
    return tone + np.float32(rng.uniform(0.3, 0.9)) * (reflectance - tone)


def _plane(corners: Array, uv: Array, reflectance: NDArray[np.float32]) -> TriangleMesh:
    """Return a triangle that faces the camera."""
    normal = unit(face_cross(corners, _FACE)[0])
    faces = _FACE
    if normal @ corners[0] > 0:
        normal, faces = -normal, _FACE[:, ::-1]
    return TriangleMesh(corners, np.tile(normal, (3, 1)), uv, faces, Material(reflectance))
