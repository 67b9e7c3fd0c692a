"""Scenes whose G-buffer, motion and hidden layers geometry knows; worker.py renders them, tests get them as ``geometry``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.render import Box, Environment, Material, Renderer, Scene, Sphere, SphereLight, TriangleMesh
from simulator.render.gbuffer import centre_gbuffer
from simulator.render.mitsuba_scene import load_scene
from simulator.types import View

VIEW = View((48, 64), 19.2e-6, 1.9e-3, 0.036, 0.2)
EYE = np.eye(3)
UNIFORM = Environment(np.ones(3))
LAMP = SphereLight(np.array([0.4, -0.1, 0.0]), 0.01, np.array([1000.0, 2000.0, 3000.0]))
TEXTURE = np.random.default_rng(0).uniform(0.1, 0.9, (4, 6, 3)).astype(np.float32)
LAYERS = 3


def turned(axis: tuple[float, float, float], angle: float) -> NDArray[np.float64]:
    """Rotation matrix by Rodrigues' formula."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.array([(0, -z, y), (z, 0, -x), (-y, x, 0)])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def plain(red: float, green: float, blue: float) -> Material:
    """A matt surface of one colour."""
    return Material(np.full((2, 2, 3), (red, green, blue), dtype=np.float32))


def sheet(corners: NDArray[np.float64], material: Material) -> TriangleMesh:
    """A plane through four corners, clockwise from the upper left as the camera sees its front."""
    normal = np.cross(corners[3] - corners[0], corners[1] - corners[0])
    return TriangleMesh(
        corners,
        np.tile(normal / np.linalg.norm(normal), (4, 1)),
        np.array([(0.0, 0), (1, 0), (1, 1), (0, 1)]),
        np.array([(0, 2, 1), (0, 3, 2)]),
        material,
    )


def upright(left: float, top: float, right: float, bottom: float, z: float, material: Material) -> TriangleMesh:
    """A plane at depth z, edges in metres."""
    return sheet(np.array([(left, top, z), (right, top, z), (right, bottom, z), (left, bottom, z)]), material)


def solids() -> Scene:
    """A ball, a turned box, a slanted sheet with a texture, and a lamp in the picture."""
    ball = Sphere(np.array([0.012, -0.006, 0.1]), 0.012, plain(0.7, 0.3, 0.1), turned((1, 2, 3), 1.0))
    half = np.array([0.007, 0.004, 0.006])
    box = Box(np.array([-0.014, 0.002, 0.08]), half, plain(0.2, 0.5, 0.8), turned((3, -1, 2), 0.7))
    corners = np.array([(-0.04, -0.025, 0.14), (0.025, -0.03, 0.19), (0.03, 0.035, 0.17), (-0.035, 0.04, 0.12)])
    lamp = SphereLight(np.array([0.024, 0.013, 0.1]), 0.006, np.array([2.0, 3.0, 4.0]))
    return Scene((ball, box, sheet(corners, Material(TEXTURE))), (lamp, UNIFORM))


def away() -> Scene:
    """A sheet that turns its back to the camera."""
    front = upright(-0.02, -0.02, 0.02, 0.02, 0.1, plain(0.6, 0.5, 0.4))
    return Scene(
        (TriangleMesh(front.vertices_m, -front.normals, front.uv, front.faces[:, ::-1], front.material),), (UNIFORM,)
    )


def moves() -> list[Scene]:
    """A ball that travels and turns, a box that comes nearer and turns, a sheet that is stretched, a wall that stays."""
    wall = upright(-0.3, -0.31, 0.32, 0.3, 0.19, plain(0.5, 0.5, 0.5))
    red, green = plain(0.8, 0.2, 0.2), plain(0.2, 0.8, 0.2)
    corners = np.array([(0.0, 0.01, 0.13), (0.05, 0.01, 0.14), (0.05, 0.05, 0.14), (0.0, 0.05, 0.13)])
    frames = []
    for step in range(3):
        ball = Sphere(np.array([-0.03 + 0.012 * step, -0.01, 0.09]), 0.012, red, turned((1, 1, 0), 0.3 * step))
        box = Box(
            np.array([0.014, -0.014, 0.1 - 0.006 * step]),
            np.array([0.006, 0.01, 0.006]),
            green,
            turned((0, 1, 1), 0.5 + 0.2 * step),
        )
        stretched = corners * (1 + 0.1 * step, 1, 1) + np.array([0.01, -0.004, -0.002]) * step
        frames.append(Scene((ball, box, sheet(stretched, red), wall), (UNIFORM,)))
    return frames


def stacks() -> dict[str, Scene]:
    """One thing behind another. What stands in front is black and the lamp far beside, so that no light is lost behind it."""
    black = plain(0.0, 0.0, 0.0)
    wall = upright(-0.3, -0.31, 0.32, 0.3, 0.15, plain(0.8, 0.6, 0.4))
    ball = Sphere(np.array([0.0, 0.0, 0.08]), 0.02, black, EYE)
    small = Sphere(np.array([0.002, 0.0, 0.08]), 0.009, black, EYE)
    box = Box(np.array([0.0, 0.005, 0.08]), np.array([0.015, 0.01, 0.01]), black, turned((1, 1, 1), 0.4))
    paper = upright(-0.015, -0.012, 0.02, 0.006, 0.05, black)
    further = paper.vertices_m + np.array([0, 0, 0.06])
    back = TriangleMesh(further, -paper.normals, paper.uv, paper.faces[:, ::-1], black)
    return {
        "ball": Scene((ball, wall), (LAMP,)),
        "box": Scene((wall, box), (LAMP,)),
        "paper": Scene((paper, ball, wall), (LAMP,)),
        "back": Scene((back, wall, ball), (LAMP,)),
        "nested": Scene((ball, small, wall), (LAMP,)),
        "bare": Scene((wall,), (LAMP,)),
    }


def arrays(renderer_of: Callable[..., Renderer]) -> dict[str, NDArray[Any]]:
    """Render all with ``renderer_of(outputs=...)`` of the active variant."""
    result: dict[str, NDArray[Any]] = {}

    def keep(name: str, clip: Any) -> None:
        result.update({f"{name}.{key}": values for key, values in clip.extras.items()})
        result.update({f"{name}.rgb": clip.rgb, f"{name}.depth_m": clip.depth_m, f"{name}.valid": clip.valid})
        result[f"{name}.edges_s"] = clip.frame_edges_s

    few: dict[str, Any] = {"samples_per_pixel": 4, "seed": 5, "source": {}}
    surfaces = renderer_of(outputs=("shape_id", "normal", "albedo"))
    for name, scene in {"solids": solids(), "away": away()}.items():
        keep(name, surfaces.still(scene, VIEW, **few))
    hits = centre_gbuffer(load_scene(solids(), VIEW, 5))
    result |= {f"hits.{name}": getattr(hits, name) for name in ("point_m", "triangle", "barycentric", "depth_m")}
    moving = renderer_of(outputs=("shape_id", "motion"))
    keep("moves", moving.clip(moves(), VIEW, frames_per_second=3000, **few))
    for number, scene in enumerate(moves()):
        seed = few["seed"] if number == 0 else np.random.SeedSequence(5, spawn_key=(number,)).generate_state(1)[0]
        keep(f"alone{number}", renderer_of().still(scene, VIEW, samples_per_pixel=4, seed=int(seed), source={}))
    peeling = renderer_of(outputs=("shape_id", "hidden"), hidden=LAYERS)
    for name, scene in stacks().items():
        keep(f"stack.{name}", peeling.still(scene, VIEW, **few))
    return result
