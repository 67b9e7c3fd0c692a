"""A model from a file as a scene: where it stands in the view, what stands behind it, and the light of a studio."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scenes.files.mesh_files import Model
from scenes.layout import far_end, random_rotation
from scenes.lights import draw_room, tint
from scenes.textures import draw_ramp, draw_reflectance, draw_theme
from simulator.errors import InputError
from simulator.render import Environment, Light, Material, Scene, SphereLight, TriangleMesh
from simulator.types import View

Array = NDArray[np.float64]
Pose = Literal["random", "upright", "as_is"]

_MARGIN = 1e-3  # of depth, so that rounding to float32 never leaves near..far
_WALL_SHARE = 0.98  # of the far depth
_WALL_TEXTURE = 256
_STUDIO_EXPOSURE = 1.3  # radiance of a white matt surface that faces the camera


@dataclass(frozen=True)
class Placement:
    """Where a model stands: ``scale`` metres per unit of its file, ``turn`` (3, 3), and its centre in metres."""

    scale: float
    turn: Array
    centre_m: Array


def back_m(view: View, wall: bool) -> float:
    """Return the depth that models must not reach: the wall's or the far end's, metres."""
    return far_end(view) * (_WALL_SHARE if wall else 1.0)


def place_model(
    path: Path, model: Model, view: View, pose: Pose, unit_m: float | None, wall: bool, rng: np.random.Generator
) -> Placement:
    """Choose where a model stands; in any pose but ``as_is`` its bounding ball lies between near and far.

    Args:
        path: its file, for messages.
        model: what stands.
        view: the frustum.
        pose: ``random``: any rotation and place, sizes that vary by 1.6; ``upright``: in the middle, as large as fits;
            ``as_is``: the file's coordinates are the camera's.
        unit_m: metres per unit of the file; None makes it fit.
        wall: whether a wall stands behind.
        rng: decides rotation, size and place.

    Raises:
        InputError: when it is too large, or lies outside near..far as it is.
    """
    near, back = view.near_m * (1 + _MARGIN), back_m(view, wall) * (1 - _MARGIN)
    if pose == "as_is":
        assert unit_m is not None
        _check_as_is(path, model, unit_m, view, back if wall else math.inf)
        return Placement(unit_m, np.eye(3), model.centre * unit_m)
    random = pose == "random"
    turn = random_rotation(rng) if random else np.eye(3)
    half = np.array([view.tan_half_width, view.tan_half_height])
    slope = np.sqrt(1 + half**2)
    if unit_m is None:
        # A ball of relative size s = radius / depth touches the view's sides at s = sin(half angle).
        largest = min(float(np.min(half / slope)), (back - near) / (back + near))
        size = largest * (rng.uniform(0.6, 0.97) if random else 0.97)
        front = 1 / rng.uniform((1 + size) / ((1 - size) * back), 1 / near) if random else None
        depth = math.sqrt(near / (1 - size) * back / (1 + size)) if front is None else front / (1 - size)
        radius = size * depth
    else:
        radius = model.radius * unit_m
        first, last = near + radius, back - radius
        if first > last:
            raise InputError(
                path,
                f"at length_of_unit_cm = {unit_m * 100:g} it is {2 * radius * 100:.4g} cm across, which does not fit "
                f"between {near * 100:.4g} and {back * 100:.4g} cm; make length_of_unit_cm smaller or leave it out, or "
                "widen scene.near_cm and scene.far_cm",
            )
        depth = 1 / rng.uniform(1 / last, 1 / first) if random else math.sqrt(first * last)
    room = np.maximum(half * depth - radius * slope, 0)
    across = rng.uniform(-1, 1, 2) * room if random else np.zeros(2)
    return Placement(radius / model.radius, turn, np.array([*across, depth]))


def model_shapes(model: Model, placement: Placement) -> list[TriangleMesh]:
    """Return a model's parts where they stand."""
    return [
        TriangleMesh(
            vertices_m=placement.centre_m + placement.scale * (part.corners - model.centre) @ placement.turn.T,
            normals=part.normals @ placement.turn.T,
            uv=part.uv,
            faces=np.arange(len(part.corners)).reshape(-1, 3),
            material=Material(part.reflectance, part.roughness),
        )
        for part in model.parts
    ]


def model_scene(
    view: View, shapes: list[TriangleMesh], light: Literal["studio", "varied"], wall: bool, rng: np.random.Generator
) -> Scene:
    """Return a model under light, before a wall of a drawn pattern or before nothing, which is black."""
    behind = (_wall(view, rng),) if wall else ()
    lights = _studio(view) if light == "studio" else _varied(view, rng)
    return Scene((*behind, *shapes), lights, hide_lights=not wall)


def _check_as_is(path: Path, model: Model, unit_m: float, view: View, back: float) -> None:
    """Refuse what the image alone would not tell: nothing before the camera, or parts behind the wall."""
    z = np.concatenate([part.corners[:, 2] for part in model.parts]) * unit_m
    if z.max() <= 0:
        raise InputError(
            path,
            f"with pose: as_is it lies behind the camera ({z.min() * 100:.4g}..{z.max() * 100:.4g} cm deep); turn it round, "
            "or use pose: upright or random",
        )
    if z.max() > back:
        raise InputError(
            path,
            f"with pose: as_is it reaches {z.max() * 100:.4g} cm deep, behind the wall at {back * 100:.4g} cm; use "
            f"background: black, make length_of_unit_cm smaller, or widen scene.far_cm = {view.far_m * 100:.4g}",
        )


def _wall(view: View, rng: np.random.Generator) -> TriangleMesh:
    """Return a plane across the whole view and its margin, just inside the far end."""
    depth = _WALL_SHARE * far_end(view)
    image, whole = (1.05 * depth * np.array([v.tan_half_width, v.tan_half_height]) for v in (view, view.field))
    places = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * whole / image
    corners = np.column_stack([places * image, np.full(4, depth)])
    repeats = float(rng.uniform(1.0, 2.5))
    aspect = view.shape[0] / view.shape[1]
    colours = draw_ramp(rng, draw_theme(rng), saturation=(0.05, 0.5))
    return TriangleMesh(
        vertices_m=corners,
        normals=np.tile([0.0, 0, -1], (4, 1)),
        uv=repeats * (1 + places) / 2 * (1, aspect),
        faces=np.array([(0, 2, 1), (0, 3, 2)]),
        material=Material(0.9 * draw_reflectance(rng, colours, _WALL_TEXTURE)),
    )


def _studio(view: View) -> tuple[Light, ...]:
    """Return a key lamp from the upper left, a fill lamp from the right, and even light from all sides."""
    key = _lamp(view, np.array([-0.7, -0.9, -1.0]), 0.2, 0.5 * _STUDIO_EXPOSURE)
    fill = _lamp(view, np.array([0.9, -0.2, -1.0]), 0.3, 0.2 * _STUDIO_EXPOSURE)
    return key, fill, Environment(np.full(3, 0.3 * _STUDIO_EXPOSURE))


def _varied(view: View, rng: np.random.Generator) -> tuple[Light, ...]:
    """Draw one lamp behind the camera, and a room around all."""
    exposure, share, warmth = rng.uniform(1.2, 1.9), rng.uniform(0.4, 0.75), rng.uniform(-0.18, 0.18)
    direction = np.array([rng.uniform(-1.1, 1.1), rng.uniform(-1.2, -0.1), -1.0])
    lamp = _lamp(view, direction, rng.uniform(0.12, 0.3), exposure * share)
    coloured = SphereLight(lamp.centre_m, lamp.radius_m, lamp.radiance * tint(warmth))
    return coloured, draw_room(rng, exposure * (1 - share), -warmth / 2)


def _lamp(view: View, direction: Array, size: float, exposure: float) -> SphereLight:
    """Return a lamp of relative size radius / distance that gives a white surface facing the camera this radiance."""
    towards = direction / np.linalg.norm(direction)
    reach = far_end(view)
    # A lamp of radiance L seen under the half angle asin(r / D) gives pi L (r / D)^2 cos(angle) of irradiance.
    radiance = exposure / size**2 / -towards[2]
    return SphereLight(np.array([0, 0, reach / 2]) + 3 * reach * towards, 3 * reach * size, np.full(3, radiance))
