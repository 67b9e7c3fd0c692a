"""Renders the cases of the render tests with one variant and stores the arrays: ``worker.py VARIANT THREADS OUT.npz``.

A process keeps to one Mitsuba variant, so that the tests of both run this script instead of rendering themselves.
"""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from geometry_cases import EYE, UNIFORM, VIEW, plain, sheet
from geometry_cases import arrays as geometry_arrays
from numpy.typing import NDArray

from scenes.flying_things import draw_scene, flying_things
from simulator.render import Box, Material, Renderer, Scene, Sphere, SphereLight, TriangleMesh, activate
from simulator.types import Clip, View

SMALL = View((20, 26), 80e-6, 1.9e-3, 0.036, 0.2)
# x = 3.25 pixels right of the image's centre, y = 5.375 pixels above it: inside pixels 35 (of 64) and 18 (of 48).
EDGE_X, EDGE_Y = 3.25, -5.375
SEEDS = 16


def grey(value: float) -> Material:
    return plain(value, value, value)


def wall(left: float, top: float, right: float, bottom: float, z_m: float, material: Material) -> TriangleMesh:
    """A plane at depth z, its edges in pixels from the image's centre."""
    corners = np.array([(left, top), (right, top), (right, bottom), (left, bottom)])
    across = corners * VIEW.pixel_pitch_m / VIEW.distance_m * z_m
    return sheet(np.column_stack([across, np.full(4, z_m)]), material)


def slanted(half_tangent: float, material: Material) -> TriangleMesh:
    """The plane 1/z = 8 + 2 x/z - 3 y/z (metres) seen under tangents up to ``half_tangent``."""
    tangents = half_tangent * np.array([(-1.0, -1), (1, -1), (1, 1), (-1, 1)])
    disparity = 8 + tangents @ (2, -3)
    return sheet(np.column_stack([tangents, np.ones(4)]) / disparity[:, np.newaxis], material)


def cases() -> dict[str, Scene]:
    """Scenes with a known picture or depth; the tests say what is expected."""
    lamp = SphereLight(np.array([0.0, 0.0, -0.5]), 0.1, np.array([10.0, 20.0, 30.0]))
    return {
        "plane": Scene((slanted(0.2, grey(0.5)),), (UNIFORM,)),
        "ball": Scene((Sphere(np.array([0.012, -0.006, 0.1]), 0.02, grey(0.5), EYE),), (UNIFORM,)),
        "far_ball": Scene((Sphere(np.array([1.2, -0.6, 10.0]), 2.0, grey(0.5), EYE),), (UNIFORM,)),
        "box": Scene((Box(np.array([0.01, 0.0, 0.1]), np.array([0.01, 0.02, 0.005]), grey(0.5), EYE),), (UNIFORM,)),
        "edge": Scene((wall(EDGE_X, EDGE_Y, 200, 200, 0.07, grey(0.0)),), (UNIFORM,)),
        "grey": Scene((wall(-200, -200, 200, 200, 0.07, grey(0.5)),), (UNIFORM,)),
        "lamp": Scene((wall(-40, -30, 40, 30, 0.05, grey(0.8)),), (lamp,)),
    }


def as_arrays(name: str, clip: Clip) -> dict[str, NDArray[Any]]:
    return {f"{name}.rgb": clip.rgb[0], f"{name}.depth": clip.depth_m[0], f"{name}.valid": clip.valid[0]}


def run(variant: str, threads: int) -> dict[str, NDArray[Any]]:
    activate(variant, threads)
    renderer = Renderer(variant)
    arrays: dict[str, NDArray[Any]] = {}
    for name, scene in cases().items():
        clip = renderer.still(scene, VIEW, samples_per_pixel=64, seed=3, source={})
        arrays |= as_arrays(name, clip)
    # The order differs with the threads: neither may matter.
    source = flying_things(SMALL, samples_per_pixel=4, objects=12, renderer=renderer)
    for index in (0, 1, 2) if threads == 1 else (2, 0, 1):
        arrays |= as_arrays(f"things{index}", source.clip(index, np.random.default_rng(index)))
    scene = draw_scene(SMALL, 12, np.random.default_rng(5))
    noisy = [renderer.still(scene, SMALL, samples_per_pixel=16, seed=s, source={}) for s in range(SEEDS)]
    arrays["noisy"] = np.stack([clip.rgb[0] for clip in noisy])
    return arrays | geometry_arrays(partial(Renderer, variant))


if __name__ == "__main__":
    np.savez(Path(sys.argv[3]), allow_pickle=False, **run(sys.argv[1], int(sys.argv[2])))
