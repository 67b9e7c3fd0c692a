"""Renders the light of hidden layers for test_hidden.py with one variant: ``hidden_worker.py VARIANT OUT.npz``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from geometry_cases import EYE, plain, upright
from numpy.typing import NDArray

from simulator.render import Renderer, Scene, Sphere, SphereLight, TriangleMesh
from simulator.types import View

VIEW = View((9, 12), 120e-6, 1.9e-3, 0.036, 0.2)
SEEDS = 12
# A round room with the camera in it, a small lamp behind the camera, and a small ball before it, as white
# as the wall: a black one would take more of its light.
ROOM_CENTRE_M, ROOM_RADIUS_M, ROOM_REFLECTANCE = np.array([0.0, 0.0, -0.03]), 0.18, 0.8
ROOM_LAMP = SphereLight(np.array([0.07, 0.0, -0.05]), 0.006, np.array([100.0, 200.0, 300.0]))
DEPTHS = (2, 5)
GLOW = np.array([2.0, 3.0, 4.0])


def room() -> TriangleMesh:
    """A ball of triangles that faces its inside."""
    rows, columns = 48, 96
    polar, around = np.meshgrid(np.linspace(0, np.pi, rows + 1), np.linspace(0, 2 * np.pi, columns + 1), indexing="ij")
    out = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1)
    first = (np.arange(rows)[:, np.newaxis] * (columns + 1) + np.arange(columns)).ravel()
    below = first + columns + 1
    # Counter-clockwise seen from inside.
    faces = np.concatenate([np.stack([first, first + 1, below], 1), np.stack([below, first + 1, below + 1], 1)])
    out = out.reshape(-1, 3)
    uv = np.zeros((len(out), 2))
    paint = plain(ROOM_REFLECTANCE, ROOM_REFLECTANCE, ROOM_REFLECTANCE)
    return TriangleMesh(ROOM_CENTRE_M + ROOM_RADIUS_M * out, -out, uv, faces, paint)


def noisy() -> Scene:
    """Two sheets behind a third in the light of two lamps, a red and a blue one: each path chooses one of them."""
    white = plain(0.8, 0.8, 0.8)
    lamps = [
        SphereLight(np.array([side * 0.4, 0.0, 0.0]), 0.1, np.array(colour))
        for side, colour in ((-1, (9.0, 0.0, 0.0)), (1, (0.0, 0.0, 9.0)))
    ]
    near = upright(-0.02, -0.02, 0.02, 0.02, 0.06, plain(0.0, 0.0, 0.0))
    middle = upright(-0.03, -0.03, 0.03, 0.03, 0.1, white)
    return Scene((near, middle, upright(-0.2, -0.2, 0.21, 0.2, 0.15, white)), tuple(lamps))


def run(variant: str) -> dict[str, NDArray[Any]]:
    result: dict[str, NDArray[Any]] = {}

    def render(scene: Scene, layers: int, samples: int, seed: int, max_depth: int = 2) -> dict[str, NDArray[Any]]:
        renderer = Renderer(variant, ("hidden",), layers, max_depth)
        return renderer.still(scene, VIEW, samples_per_pixel=samples, seed=seed, source={}).extras

    # Few and many paths, each with seeds that are far apart.
    for samples in (1, 16):
        taken = [render(noisy(), 2, samples, 1000 * seed) for seed in range(SEEDS if samples > 1 else 2 * SEEDS)]
        for layer in (1, 2):
            result[f"noisy{samples}.rgb{layer}"] = np.stack([extras[f"hidden{layer}_rgb"][0] for extras in taken])
            result[f"noisy.valid{layer}"] = taken[0][f"hidden{layer}_valid"][0]
    ball = Sphere(np.array([0.0, 0.0, 0.05]), 0.012, plain(0.0, 0.0, 0.0), EYE)
    white = Sphere(ball.centre_m, ball.radius_m, room().material, EYE)
    for depth in DEPTHS:
        extras = render(Scene((white, room()), (ROOM_LAMP,)), 1, 16, 3, depth)
        result[f"room.rgb{depth}"] = extras["hidden1_rgb"][0]
        result["room.valid"], result["room.depth_m"] = extras["hidden1_valid"][0], extras["hidden1_depth_m"][0]
    lamp = SphereLight(np.array([0.0, 0.0, 0.12]), 0.02, GLOW)
    for name, hide in (("shown", False), ("unseen", True)):
        extras = render(Scene((ball,), (lamp,), hide_lights=hide), 1, 16, 1)
        result[f"{name}.rgb"], result[f"{name}.valid"] = extras["hidden1_rgb"][0], extras["hidden1_valid"][0]
    return result


if __name__ == "__main__":
    np.savez(Path(sys.argv[2]), allow_pickle=False, **run(sys.argv[1]))
