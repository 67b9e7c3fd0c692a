"""What a stage replaces from frame to frame, against scenes that are loaded anew."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from simulator.render import Box, Environment, Material, Renderer, Scene, Shape, Sphere, SphereLight, TriangleMesh
from simulator.types import View

VIEW = View((9, 12), 120e-6, 1.9e-3, 0.036, 0.2)
EYE = np.eye(3)
TEXTURE = np.random.default_rng(0).uniform(0.1, 0.9, (4, 4, 3)).astype(np.float32)
LAMP = SphereLight(np.array([0.1, -0.15, 0.0]), 0.03, np.array([6.0, 8.0, 10.0]))
BALL = Sphere(np.array([0.0, 0.0, 0.1]), 0.025, Material(TEXTURE, roughness=0.1), EYE)
BOX = Box(np.array([0.0, 0.0, 0.1]), np.array([0.02, 0.015, 0.01]), Material(TEXTURE), EYE)
# Five corners of a bent sheet; the first two faces leave its lower right corner free, others fill it.
SHEET = TriangleMesh(
    vertices_m=np.array(
        [(-0.03, -0.03, 0.1), (0.03, -0.03, 0.1), (0.03, 0.03, 0.09), (-0.03, 0.03, 0.1), (0, 0, 0.12)]
    ),
    normals=np.tile([0.0, 0.0, -1.0], (5, 1)),
    uv=np.array([(0.0, 0.0), (1, 0), (1, 1), (0, 1), (0.5, 0.5)]),
    faces=np.array([(0, 4, 1), (0, 3, 4)]),
    material=Material(TEXTURE),
)
TURN = np.array([(0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)])


def with_shape(shape: Shape, **changes: Any) -> tuple[Scene, Scene]:
    return Scene((shape,), (LAMP,)), Scene((replace(shape, **changes),), (LAMP,))


def with_lamp(**changes: Any) -> tuple[Scene, Scene]:
    return Scene((BALL,), (LAMP,)), Scene((BALL,), (replace(LAMP, **changes),))


CHANGES: dict[str, Callable[[], tuple[Scene, Scene]]] = {
    "roughness": lambda: with_shape(BALL, material=Material(BALL.material.reflectance, roughness=0.8)),
    "colours of a coated ball": lambda: with_shape(BALL, material=Material(TEXTURE[::-1], roughness=0.1)),
    "place of a ball": lambda: with_shape(BALL, centre_m=np.array([0.01, 0.005, 0.09])),
    "size of a ball": lambda: with_shape(BALL, radius_m=0.02),
    "turn of a ball": lambda: with_shape(BALL, rotation=TURN),
    "place of a box": lambda: with_shape(BOX, centre_m=np.array([0.01, 0.005, 0.09])),
    "size of a box": lambda: with_shape(BOX, half_size_m=np.array([0.01, 0.02, 0.01])),
    "turn of a box": lambda: with_shape(BOX, rotation=TURN),
    "vertices": lambda: with_shape(SHEET, vertices_m=SHEET.vertices_m * (0.9, 1.1, 1.0)),
    "normals": lambda: with_shape(SHEET, normals=np.tile([0.0, -0.6, -0.8], (5, 1))),
    "texture coordinates": lambda: with_shape(SHEET, uv=SHEET.uv[:, ::-1] * 0.5 + 0.1),
    "faces": lambda: with_shape(SHEET, faces=np.array([(1, 4, 2), (2, 4, 3)])),
    "place of a lamp": lambda: with_lamp(centre_m=np.array([-0.12, 0.1, 0.02])),
    "radius of a lamp": lambda: with_lamp(radius_m=0.05),
    "radiance of a lamp": lambda: with_lamp(radiance=np.array([9.0, 3.0, 1.0])),
    "radiance of the surroundings": lambda: (
        Scene((BALL,), (Environment(np.ones(3)),)),
        Scene((BALL,), (Environment(np.array([0.5, 1.0, 2.0])),)),
    ),
}


@pytest.mark.parametrize("change", CHANGES)
def test_each_thing_that_changes_is_replaced(change: str) -> None:
    """Frame by frame the still of its scene; the third returns to the first's scene, with objects that were shown before."""
    first, second = CHANGES[change]()
    renderer = Renderer("scalar_rgb", ("normal", "albedo"))
    moving = renderer.clip([first, second, first], VIEW, frames_per_second=30, samples_per_pixel=4, seed=5, source={})

    def still(scene: Scene, number: int) -> Any:
        seed = 5 if number == 0 else int(np.random.SeedSequence(5, spawn_key=(number,)).generate_state(1)[0])
        return renderer.still(scene, VIEW, samples_per_pixel=4, seed=seed, source={})

    for number, scene, other in ((1, second, first), (2, first, second)):
        expected, old = still(scene, number), still(other, number)
        brightest = float(expected.rgb.max())
        assert brightest > 0.05
        # The same noise: what differs is the change. A hundred times what is tolerated below, and more.
        assert np.abs(expected.rgb - old.rgb).max() > 1e-3 * brightest
        # float32's rounding in where light from everywhere begins.
        np.testing.assert_allclose(moving.rgb[number], expected.rgb[0], rtol=1e-6, atol=1e-6 * brightest)
        np.testing.assert_allclose(moving.depth_m[number], expected.depth_m[0], rtol=1e-6)
        np.testing.assert_array_equal(moving.valid[number], expected.valid[0])
        for name in ("normal", "albedo"):
            np.testing.assert_allclose(moving.extras[name][number], expected.extras[name][0], atol=1e-6)
