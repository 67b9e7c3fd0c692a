"""A set for actions: a table before a wall, seen from above at an angle, scaled so that it lies in the view's depth range.

Set axes: origin on the table where the action is, x right in the image, y down, z away from the viewer, in metres of the
real world (a hand is 0.19 m). The whole set is scaled down (or up) about the camera, which leaves the image unchanged.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.layout import far_end, rotation
from scenes.lights import tint
from simulator.errors import InputError
from simulator.render import Environment, Material, SphereLight, TriangleMesh
from simulator.types import View

Array = NDArray[np.float64]

_PITCH_RAD = (math.radians(14), math.radians(48))
_ROLL_RAD = math.radians(4)
_WALL_YAW_RAD = math.radians(14)
# Where the camera looks: this high above the action's place on the table.
_AIM_M = 0.1
# Half of the image's smaller side at the action, and the least distance to it.
_HALF_EXTENT_M = (0.22, 0.28)
_CLOSEST_M = 0.37
# Hands and things seldom come nearer to the camera than the action's place by more; see `Viewpoint.placed`.
_REACH_M = 0.2
_WALL_M = (0.15, 0.8)
# Sizes differ at most by this factor from clip to clip: deep ranges would else be full of tiny hands.
_SIZES = 2.5


@dataclass(frozen=True)
class Viewpoint:
    """Where the set stands before the camera.

    Attributes:
        turn: ``(3, 3)`` rotation from set axes to the camera's.
        eye_m: the camera in the set.
        scale: metres of the rendered world for each metre of the set.
        wall_m: distance of the wall behind the action.
        wall_yaw_rad: by which the wall is turned about the vertical.
        pitch_rad: by which the camera looks down.
        near_m: the view's near depth.
        knee_m: depth of what is 0.2 m of the set nearer than the action.
    """

    turn: Array
    eye_m: Array
    scale: float
    wall_m: float
    wall_yaw_rad: float
    pitch_rad: float
    near_m: float
    knee_m: float

    def to_world(self, points_m: Array) -> Array:
        """Return points of the set ``(..., 3)`` in the rendered world."""
        return self.scale * ((points_m - self.eye_m) @ self.turn.T)

    def placed(self, mesh: TriangleMesh) -> TriangleMesh:
        """Return a mesh of the set in the rendered world, where it is nearer than the near depth pushed back behind it.

        Points move along their line of sight, so that the image stays as it is; all depths below ``knee_m`` are
        compressed into those from the near depth to it. Only an arm or a thing that is shown comes that close.
        """
        points = self.to_world(mesh.vertices_m)
        # What is beside or behind the camera goes far aside, out of the image.
        depth = np.maximum(points[:, 2:], 0.02 * self.near_m)
        spare = self.knee_m - self.near_m
        stops = ([0, 0.25 * self.knee_m, self.knee_m], self.near_m + spare * np.array([0.02, 0.1, 1]))
        pushed = np.where(depth < self.knee_m, np.interp(depth, *stops), depth)
        points = np.column_stack([points[:, :2] * pushed / depth, pushed])
        return TriangleMesh(points, mesh.normals @ self.turn.T, mesh.uv, mesh.faces, mesh.material)


def draw_viewpoint(view: View, rng: np.random.Generator) -> Viewpoint:
    """Draw a viewpoint and a wall; everything that can be seen lies between near and far.

    The set's size is drawn log-uniformly from those that fit, but never larger than life where life's size fits or is too
    large, and as near to it as can be where only larger sizes fit; and never more than 2.5 times below the largest of
    these. A hand is about 3 to 6 cm long between 3.6 and 20 cm, and 6 to 19 cm between 3.6 cm and 1 m or more.

    Raises:
        InputError: when the depth range is too thin for any.
    """
    shares = rng.random(7)
    pitch = _PITCH_RAD[0] + shares[0] * (_PITCH_RAD[1] - _PITCH_RAD[0])
    roll = _ROLL_RAD * (2 * shares[1] - 1)
    extent = _HALF_EXTENT_M[0] + shares[2] * (_HALF_EXTENT_M[1] - _HALF_EXTENT_M[0])
    turn, eye = _camera(view, pitch, roll, extent)
    yaw, farther = _WALL_YAW_RAD * (2 * shares[3] - 1), shares[4]
    for ease in (1.0, 0.6, 0.35, 0.2, 0.1, 0.0):
        wall = _WALL_M[0] + ease * farther * (_WALL_M[1] - _WALL_M[0])
        least, most = _scales(view, turn, eye, wall, ease * yaw)
        if least <= most:
            break
    else:
        raise _too_thin(view, far_end(view) * least / most)
    scale = _size(least, most, shares[5])
    knee = scale * (_distance(turn, eye) - _REACH_M)
    return Viewpoint(turn, eye, scale, wall, ease * yaw, pitch, view.near_m, knee)


def _size(least: float, most: float, share: float) -> float:
    largest = min(most, max(1.0, least))
    smallest = max(least, largest / _SIZES)
    return smallest * (largest / smallest) ** share


def _too_thin(view: View, needed_m: float) -> InputError:
    return InputError(
        "scene",
        f"a table and a wall do not fit between near {view.near_m:g} m and far {view.far_m:g} m; "
        f"expected far of at least {1.001 * needed_m:.3g} m: set scene.near_cm and scene.far_cm, or widen the PSF's depths",
    )


def check_range(view: View) -> None:
    """Refuse a view in whose depth range some viewpoints do not fit (InputError with the far depth that is needed)."""
    reach, needed = far_end(view), 0.0
    for pitch in np.linspace(*_PITCH_RAD, 9):
        for roll in (-_ROLL_RAD, _ROLL_RAD):
            for extent in _HALF_EXTENT_M:
                least, most = _scales(view, *_camera(view, pitch, roll, extent), _WALL_M[0], 0.0)
                needed = max(needed, reach * least / most)
    if needed > reach:
        raise _too_thin(view, needed)


def _camera(view: View, pitch: float, roll: float, extent_m: float) -> tuple[Array, Array]:
    """Return the rotation from set to camera axes, and the camera's place."""
    distance = max(extent_m / min(view.tan_half_width, view.tan_half_height), _CLOSEST_M)
    turn = rotation([0, 0, 1], roll) @ rotation([1, 0, 0], pitch)
    return turn, np.array([0, -_AIM_M, 0]) - distance * turn[2]


def _distance(turn: Array, eye: Array) -> float:
    """Return the depth of the set's origin, metres of the set."""
    return float(-eye @ turn[2])


def _scales(view: View, turn: Array, eye: Array, wall_m: float, yaw: float) -> tuple[float, float]:
    """Return the least and the greatest scale at which what is seen keeps to the depth range."""
    across, down = np.meshgrid(np.linspace(-1.02, 1.02, 9), np.linspace(-1.02, 1.02, 33))
    rays = np.stack([across * view.tan_half_width, down * view.tan_half_height, np.ones_like(across)], -1) @ turn
    facing = np.array([math.sin(yaw), 0, math.cos(yaw)])
    with np.errstate(divide="ignore"):
        table = np.where(rays[..., 1] > 0, -eye[1] / rays[..., 1], np.inf)
        ahead = rays @ facing
        wall = np.where(ahead > 0, (wall_m * facing[2] - eye @ facing) / ahead, np.inf)
    depth = np.minimum(table, wall)
    nearest = min(float(depth.min()), (_distance(turn, eye) - _REACH_M) / 1.09)
    # The edge between table and wall runs between the rays: a little margin.
    return 1.01 * view.near_m / nearest, 0.97 * far_end(view) / float(depth.max())


def table_mesh(view: View, viewpoint: Viewpoint, material: Material, repeats: float) -> TriangleMesh:
    """Return the table's top, larger than the image; ``repeats`` textures for each metre."""
    half = _backdrop_half(view, viewpoint)
    corners = np.array([(-half, 0, -half), (half, 0, -half), (half, 0, half), (-half, 0, half)])
    uv = repeats * corners[:, [0, 2]]
    return _rectangle(viewpoint, corners, np.array([0.0, -1, 0]), uv, material)


def wall_mesh(view: View, viewpoint: Viewpoint, material: Material, repeats: float) -> TriangleMesh:
    """Return the wall, standing on the table."""
    half = _backdrop_half(view, viewpoint)
    along = np.array([math.cos(viewpoint.wall_yaw_rad), 0, -math.sin(viewpoint.wall_yaw_rad)])
    up = np.array([0, -2 * half, 0])
    foot = np.array([0, 0, viewpoint.wall_m])
    corners = np.stack([foot - half * along + up, foot + half * along + up, foot + half * along, foot - half * along])
    uv = repeats * np.array([(-half, 0), (half, 0), (half, 2 * half), (-half, 2 * half)])
    return _rectangle(viewpoint, corners, np.cross(along, [0.0, -1, 0]).astype(float), uv, material)


def _backdrop_half(view: View, viewpoint: Viewpoint) -> float:
    """Half an edge of the table and of the wall: beyond what the widest image shows."""
    farthest = far_end(view) / viewpoint.scale
    return 1.5 * farthest * max(1.0, view.field.tan_half_width, view.field.tan_half_height)


def _rectangle(viewpoint: Viewpoint, corners: Array, normal: Array, uv: Array, material: Material) -> TriangleMesh:
    faces = np.array([(0, 1, 2), (0, 2, 3)])
    if np.cross(corners[1] - corners[0], corners[2] - corners[0]) @ normal < 0:
        faces = faces[:, ::-1]
    normals = np.tile(normal @ viewpoint.turn.T, (4, 1))
    return TriangleMesh(viewpoint.to_world(corners), normals, uv, faces, material)


LIGHTS = ("daylight", "lamp", "warm lamp", "overcast")
"""Kinds of light: (share of the key lamp, its size, warmth) differ."""
_KEY = {
    "daylight": (0.55, 0.22, -0.06),
    "lamp": (0.7, 0.1, 0.03),
    "warm lamp": (0.62, 0.14, 0.17),
    "overcast": (0.25, 0.4, -0.1),
}


def draw_lights(viewpoint: Viewpoint, rng: np.random.Generator) -> tuple[str, tuple[SphereLight | Environment, ...]]:
    """Draw the kind of light and its lamps: a key and a fill above and behind the viewer, and light from all sides.

    Together they give a white table top a radiance of 0.9 to 1.5.
    """
    kind = LIGHTS[rng.integers(len(LIGHTS))]
    share, size, warmth = _KEY[kind]
    draws = rng.random(8)
    exposure = 0.9 + 0.6 * draws[0]
    side = 1.0 if draws[1] < 0.5 else -1.0
    shares = (share * (0.9 + 0.2 * draws[2]), 0.12 + 0.1 * draws[3])
    span = float(np.linalg.norm(viewpoint.eye_m))
    lamps: list[SphereLight | Environment] = []
    for part, towards, colour, width, angles in (
        (shares[0], side, warmth, size, draws[4:6]),
        (shares[1], -side, -warmth / 2, 0.2, draws[6:8]),
    ):
        azimuth, elevation = towards * math.radians(10 + 65 * angles[0]), math.radians(38 + 37 * angles[1])
        level = math.cos(elevation)
        direction = np.array([level * math.sin(azimuth), -math.sin(elevation), -level * math.cos(azimuth)])
        distance = span * (3 + angles[1])
        # A lamp of radiance L seen under the half angle asin(r / D) gives pi L (r / D)^2 sin(elevation) of irradiance.
        radiance = exposure * part / width**2 / math.sin(elevation)
        centre = viewpoint.to_world(distance * direction)
        lamps.append(SphereLight(centre, viewpoint.scale * distance * width, radiance * tint(colour)))
    return kind, (*lamps, Environment(exposure * (1 - sum(shares)) * tint(-warmth / 3)))
