"""The flying things: geometry inside the depth range, clips that keep the contract of a SceneSource."""

from __future__ import annotations

import math

import numpy as np
import pytest

from scenes.flying_things import draw_scene, flying_things
from scenes.layout import far_end, place_balls
from simulator.errors import InputError
from simulator.render import EnvironmentMap, Renderer, Scene, Sphere, SphereLight, TriangleMesh
from simulator.types import View

DEFAULT = View((128, 128), 19.2e-6, 1.9e-3, 0.036, 0.2)
SMALL = View((24, 24), 102.4e-6, 1.9e-3, 0.036, 0.2)


@pytest.mark.parametrize("count", [1, 30, 200])
def test_balls_lie_between_near_and_far_with_centres_about_in_view(view: View, count: int) -> None:
    balls = place_balls(view, count, np.random.default_rng(count))
    assert len(balls) == count
    for ball in balls:
        x, y, z = ball.centre_m
        assert view.near_m < z - ball.radius_m
        assert z + ball.radius_m < far_end(view) <= view.far_m
        assert abs(x / z) <= 1.05 * view.tan_half_width
        assert abs(y / z) <= 1.05 * view.tan_half_height


def test_nearest_points_are_even_in_disparity() -> None:
    fronts = [
        1 / (ball.centre_m[2] - ball.radius_m)
        for seed in range(100)
        for ball in place_balls(DEFAULT, 30, np.random.default_rng(seed))
    ]
    # Between the near depth and where the largest ball (relative size 0.27) still fits before the far one.
    counts, _ = np.histogram(fronts, np.linspace(9, 27.7, 6))
    # 3000 balls: about 530 in each bin, so a deviation of 4 %, of which three are allowed.
    assert np.abs(counts / counts.mean() - 1).max() < 0.13


def test_every_vertex_of_a_scene_is_in_the_depth_range_and_the_wall_fills_the_view(view: View) -> None:
    for seed in range(5):
        scene = draw_scene(view, 30, np.random.default_rng(seed))
        for shape in scene.shapes:
            if isinstance(shape, TriangleMesh):
                near, far = shape.vertices_m[:, 2].min(), shape.vertices_m[:, 2].max()
            else:
                reach = shape.radius_m if isinstance(shape, Sphere) else np.linalg.norm(shape.half_size_m)
                near, far = shape.centre_m[2] - reach, shape.centre_m[2] + reach
            assert view.near_m < near < far < far_end(view)
        wall = scene.shapes[0]
        assert isinstance(wall, TriangleMesh)
        seen = wall.vertices_m[:, :2] / wall.vertices_m[:, 2:]
        assert np.all(np.abs(seen) > (view.tan_half_width, view.tan_half_height))
        assert np.all(wall.normals[:, 2] < 0)


def test_slots_keep_their_kind_and_coat_whatever_the_seed() -> None:
    """Else Dr.Jit compiles new kernels for new scenes."""

    def kinds(scene: Scene) -> list[tuple[str, bool, tuple[int, ...]]]:
        materials = [shape.material for shape in scene.shapes]
        return [
            (type(shape).__name__, material.roughness is None, material.reflectance.shape)
            for shape, material in zip(scene.shapes, materials, strict=True)
        ]

    first, second = (kinds(draw_scene(DEFAULT, 40, np.random.default_rng(seed))) for seed in (0, 1))
    assert first == second
    assert {name for name, _, _ in first} == {"Sphere", "Box", "TriangleMesh"}
    assert {matt for _, matt, _ in first} == {True, False}


def facing_radiance(room: EnvironmentMap) -> np.ndarray:
    """Radiance of a white matt surface that looks along -z: the mean over the hemisphere, weighted by the cosine."""
    rows, columns = room.radiance.shape[:2]
    down = np.pi * (np.arange(rows) + 0.5) / rows
    around = 2 * np.pi * (np.arange(columns) + 0.5) / columns - np.pi  # 0 is +z
    cosine = np.clip(np.outer(np.sin(down), -np.cos(around)), 0, None)
    solid_angle = np.sin(down)[:, np.newaxis] * (np.pi / rows) * (2 * np.pi / columns)
    return np.einsum("rc,rcx->x", cosine * solid_angle, room.radiance.astype(float)) / np.pi


def test_light_on_a_white_wall_is_the_drawn_exposure() -> None:
    for seed in range(20):
        scene = draw_scene(DEFAULT, 1, np.random.default_rng(seed))
        target = np.array([0, 0, far_end(DEFAULT) / 2])
        radiance = np.zeros(3)
        for light in scene.lights:
            if isinstance(light, EnvironmentMap):
                radiance += facing_radiance(light)
                continue
            assert isinstance(light, SphereLight)
            towards = light.centre_m - target
            distance = np.linalg.norm(towards)
            assert light.centre_m[2] + light.radius_m < 0, "a lamp in view would be a thing of its own"
            radiance += light.radiance * (light.radius_m / distance) ** 2 * -towards[2] / distance
        assert 1.1 < radiance.mean() < 1.9
        assert np.abs(radiance / radiance.mean() - 1).max() < 0.2


@pytest.mark.parametrize("far_m", [0.036, 0.039])
def test_a_depth_range_too_thin_for_solids_is_refused(far_m: float) -> None:
    view = View((24, 24), 102.4e-6, 1.9e-3, 0.036, far_m)
    with pytest.raises(InputError, match=r"^scene: "):
        flying_things(view, renderer=Renderer("scalar_rgb"))


def test_an_infinite_far_depth_is_filled_to_the_last_disparities() -> None:
    assert far_end(View((128, 128), 19.2e-6, 1.9e-3, 0.036, math.inf)) == pytest.approx(1.8)
