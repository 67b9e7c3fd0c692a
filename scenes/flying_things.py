"""Scene family "flying things": textured solids floating before a wall, spread evenly in disparity over the depth range.

In the spirit of FlyingThings3D (Mayer et al., CVPR 2016): nothing to recognise, everything to locate.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from scenes.layout import Ball, far_end, place_balls, place_balls_beside, random_rotation
from scenes.lights import draw_room, lamp
from scenes.meshes import backdrop, mesh_library
from scenes.textures import draw_ramp, draw_reflectance, draw_theme, tiled
from simulator.render import Box, Light, Material, Renderer, Scene, Sphere, TriangleMesh
from simulator.render.scene import Shape
from simulator.types import Clip, View

_TEXTURE_SIZE, _WALL_TEXTURE_SIZE = 64, 128
# Kind and coat of each slot, repeated: fixed, so that no kernel is compiled after the first scene (see render.Scene).
_KINDS = ("mesh", "sphere", "mesh", "box", "mesh", "mesh")
_COATED = (False, True, False, False, True)


def flying_things(
    view: View,
    *,
    samples_per_pixel: Annotated[int, Field(ge=1, le=4096)] = 16,
    objects: Annotated[int, Field(ge=1, le=200)] = 30,
    renderer: Renderer,
) -> FlyingThings:
    """Return the family for a view: each clip is one image of ``objects`` random solids before a textured wall.

    Args:
        view: image shape, pinhole geometry and depth range; ``far_m`` must be at least 1.1 ``near_m``.
        samples_per_pixel: light paths per pixel; noise falls with the square root.
        objects: how many solids; their size adapts, so that they cover about the same share of the image.
        renderer: how to render.

    Raises:
        InputError: when the depth range is too thin to hold solids.
    """
    far_end(view)  # refuses a view that cannot be filled, before any work is done
    return FlyingThings(view, samples_per_pixel, objects, renderer)


@dataclass(frozen=True)
class FlyingThings:
    """A `simulator.types.SceneSource`; cheap to pickle, all contents come from the generator that ``clip`` is given."""

    view: View
    samples_per_pixel: int
    objects: int
    renderer: Renderer
    inputs: tuple[Path, ...] = field(default=(), init=False)

    def clip(self, index: int, rng: np.random.Generator) -> Clip:
        """Draw a scene from ``rng`` and render it; ``index`` is only noted."""
        scene = draw_scene(self.view, self.objects, rng)
        return self.renderer.still(
            scene,
            self.view,
            samples_per_pixel=self.samples_per_pixel,
            seed=int(rng.integers(2**32)),
            source={"family": "flying_things", "index": index, "objects": self.objects},
        )


def draw_scene(view: View, objects: int, rng: np.random.Generator) -> Scene:
    """Draw the wall, the solids and the lights; for a view with a margin, more of them that fill it."""
    theme = draw_theme(rng)
    balls = place_balls(view, objects, rng)
    solids = [_solid(slot, ball, theme, rng) for slot, ball in enumerate(balls)]
    shapes, lights = [_wall(view, theme, rng), *solids], _lights(view, rng)
    if view.margin != (0, 0):  # drawn last, so that the image shows the same things with and without
        beside = place_balls_beside(view, objects, balls, rng)
        shapes += [_solid(slot, ball, theme, rng) for slot, ball in enumerate(beside)]
        shapes.append(backdrop(view, 0.99 * far_end(view), _wall_material(theme, rng), float(rng.uniform(1.0, 2.5))))
    return Scene(tuple(shapes), lights)


def _solid(slot: int, ball: Ball, theme: np.ndarray, rng: np.random.Generator) -> Shape:
    """Fill a ball with the kind of solid that belongs to its slot."""
    reflectance = draw_reflectance(rng, draw_ramp(rng, theme), _TEXTURE_SIZE)
    roughness = float(rng.uniform(0.15, 0.5)) if _COATED[slot % len(_COATED)] else None
    rotation = random_rotation(rng)
    kind = _KINDS[slot % len(_KINDS)]
    down, across = (int(2**power) for power in rng.integers(0, 2, 2))
    if kind == "sphere":  # its texture spans twice as much around as from pole to pole
        ball_material = Material(tiled(reflectance, down, 2 * across), roughness)
        return Sphere(ball.centre_m, ball.radius_m, ball_material, rotation)
    if kind == "box":
        proportions = rng.uniform(0.45, 1.0, 3)
        half_size = ball.radius_m * proportions / np.linalg.norm(proportions)
        return Box(ball.centre_m, half_size, Material(tiled(reflectance, down, across), roughness), rotation)
    library = mesh_library()
    mesh = library[rng.integers(len(library))]
    return TriangleMesh(
        vertices_m=ball.centre_m + ball.radius_m * mesh.vertices @ rotation.T,
        normals=mesh.normals @ rotation.T,
        uv=mesh.uv * (across, down),
        faces=mesh.faces,
        material=Material(reflectance, roughness),
    )


def _wall(view: View, theme: np.ndarray, rng: np.random.Generator) -> TriangleMesh:
    """Return a slanted plane that fills the image and stays just inside the far end.

    A plane's disparity is linear over the image, ``1 / z = a + b x + c y`` for a direction (x, y, 1).
    """
    nearest, farthest = 1 / view.near_m, 1 / (0.98 * far_end(view))
    slant = rng.uniform(-1, 1, 2) * 0.12 * (nearest - farthest) / 2
    # The diagonal between the two triangles must not pass through pixel centres, where rays may slip between them: so the
    # wall is not a centred rectangle, and its edges lie at odd places beyond the image's.
    places = np.array([(-1.05, -1.05), (1.3137, -1.05), (1.3137, 1.1741), (-1.05, 1.1741)])
    directions = places * (view.tan_half_width, view.tan_half_height)
    disparity = farthest - np.min(places @ slant) + places @ slant
    corners = np.column_stack([directions, np.ones(4)]) / disparity[:, np.newaxis]
    normal = np.cross(corners[3] - corners[0], corners[1] - corners[0])
    material = _wall_material(theme, rng)
    repeats = float(rng.uniform(1.0, 2.5))
    aspect = view.shape[0] / view.shape[1]
    return TriangleMesh(
        vertices_m=corners,
        normals=np.tile(normal / np.linalg.norm(normal), (4, 1)),
        uv=repeats * np.array([(0.0, 0), (1, 0), (1, aspect), (0, aspect)]),
        faces=np.array([(0, 2, 1), (0, 3, 2)]),
        material=material,
    )


def _wall_material(theme: np.ndarray, rng: np.random.Generator) -> Material:
    return Material(0.9 * draw_reflectance(rng, draw_ramp(rng, theme, saturation=(0.05, 0.5)), _WALL_TEXTURE_SIZE))


def _lights(view: View, rng: np.random.Generator) -> tuple[Light, ...]:
    """Return a key and a fill lamp behind the camera and a room around all, with white balanced only roughly.

    Together they give a white surface that faces the camera a radiance of ``exposure``, so that images come out alike.
    """
    reach = far_end(view)
    exposure = rng.uniform(1.2, 1.9)
    shares = np.array([rng.uniform(0.45, 0.7), rng.uniform(0.1, 0.25)])
    warmth = rng.uniform(-0.18, 0.18)
    side = rng.choice([-1.0, 1.0])
    lamps: list[Light] = []
    for share, colour, towards in ((shares[0], warmth, side), (shares[1], -warmth, -side)):
        direction = np.array([towards * rng.uniform(0.3, 1.1), rng.uniform(-1.2, -0.1), -1.0])
        direction /= np.linalg.norm(direction)
        distance = reach * rng.uniform(2.5, 4.0)
        radius = distance * rng.uniform(0.12, 0.3)
        lamps.append(lamp(np.array([0, 0, reach / 2]), direction, distance, radius, exposure * share, colour))
    return (*lamps, draw_room(rng, exposure * (1 - shares.sum()), -warmth / 2))
