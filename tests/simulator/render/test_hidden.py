"""Layers behind the picture, against all crossings of the pixels' rays in closed form, for both variants."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from scenes.meshes import grid_faces
from simulator.render import Environment, Material, Renderer, Scene, TriangleMesh
from simulator.render.hidden import is_open
from simulator.render.mitsuba_scene import cuboid
from simulator.types import View

Pictures = Mapping[str, NDArray[Any]]
STACKS = ("ball", "box", "paper", "back", "nested", "bare")


def expected_layers(
    scene: Any, crossings: Any, count: int
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_]]:
    """The rule, ray by ray: the next surface whose outside faces the camera, or another shape's that is open.

    Returns:
        Shapes and depths ``(1 + count, N)`` from the first surface on, -1 and inf where there is none, and which rays are
        clear of outlines.
    """
    open_shapes = {number for number, shape in enumerate(scene.shapes) if hasattr(shape, "faces")}
    shapes = np.full((1 + count, len(crossings.z)), -1)
    depths = np.full(shapes.shape, np.inf)
    for ray in range(len(crossings.z)):
        layer = -1
        for shape, z, facing in zip(crossings.shape[ray], crossings.z[ray], crossings.facing[ray], strict=True):
            if shape < 0 or layer == count:
                break
            if layer < 0 or (facing or (shape != shapes[layer, ray] and shape in open_shapes)):
                layer += 1
                shapes[layer, ray], depths[layer, ray] = shape, z
    clear = np.all((crossings.grazing > 0.03) | (crossings.shape < 0), axis=1)
    return shapes, depths, clear


@pytest.mark.parametrize("name", STACKS)
def test_depth_of_what_is_behind(pictures: Pictures, geometry: Any, analytic: Any, name: str) -> None:
    scene = geometry.stacks()[name]
    crossings = analytic.trace(scene, analytic.directions(geometry.VIEW))
    shapes, depths, clear = expected_layers(scene, crossings, geometry.LAYERS)
    assert clear.mean() > 0.97
    clear &= pictures[f"stack.{name}.shape_id"].ravel() == shapes[0]
    for layer in range(1, geometry.LAYERS + 1):
        valid = pictures[f"stack.{name}.hidden{layer}_valid"].ravel()
        different = clear & (valid != (shapes[layer] >= 0))
        assert different.sum() <= 2, "a ray that meets an edge may go either way"
        there = clear & ~different & valid
        found = pictures[f"stack.{name}.hidden{layer}_depth_m"].ravel()
        off = ~np.isclose(found[there], depths[layer, there], rtol=1e-5)
        assert off.sum() <= 2, found[there][off]
        np.testing.assert_array_equal(found[~valid], np.float32(geometry.VIEW.far_m))
    most = {"ball": 1, "box": 1, "paper": 2, "back": 1, "nested": 2, "bare": 0}[name]
    counts = [np.sum(clear & (layer >= 0)) for layer in shapes[1:]]
    assert all(count > 50 for count in counts[:most]), "the scene shows what the test is about"
    if name != "back":  # it stands behind the ball, and the wall behind both
        assert not any(counts[most:])


@pytest.mark.parametrize("name", STACKS)
def test_what_is_behind_has_the_colour_it_would_have_alone(
    pictures: Pictures, geometry: Any, analytic: Any, name: str
) -> None:
    """Black things before a wall and a lamp far to the side: radiance = reflectance L (r / D)^2 cos at the wall's point."""
    scene, lamp = geometry.stacks()[name], geometry.LAMP
    crossings = analytic.trace(scene, analytic.directions(geometry.VIEW))
    shapes, depths, clear = expected_layers(scene, crossings, geometry.LAYERS)
    wall = next(number for number, shape in enumerate(scene.shapes) if shape.material.reflectance.any())
    for layer in range(1, geometry.LAYERS + 1):
        rgb = pictures[f"stack.{name}.hidden{layer}_rgb"].reshape(-1, 3)
        valid = pictures[f"stack.{name}.hidden{layer}_valid"].ravel()
        assert not rgb[~valid].any()
        black = clear & valid & (shapes[layer] >= 0) & (shapes[layer] != wall)
        assert not rgb[black].any()
        seen = clear & valid & (shapes[layer] == wall)
        if not seen.any():
            continue
        points = analytic.directions(geometry.VIEW)[seen] * depths[layer, seen][:, np.newaxis]
        towards = lamp.centre_m - points
        distance = np.linalg.norm(towards, axis=1, keepdims=True)
        light = lamp.radiance * (lamp.radius_m / distance) ** 2 * (-towards[:, 2:] / distance)
        expected = light * (0.8, 0.6, 0.4)
        # The lamp is 0.02 rad wide as seen from the wall: the cosine over it, and the chance that a path finds it by itself,
        # scatter the light of 4 paths by less than 3 %, its mean over 50 pixels or more by less than 0.5 %.
        np.testing.assert_allclose(rgb[seen], expected, rtol=0.1)
        np.testing.assert_allclose(rgb[seen].mean(axis=0), expected.mean(axis=0), rtol=0.005)


def test_what_is_behind_continues_the_wall_beside_it(pictures: Pictures, geometry: Any) -> None:
    """The same wall rendered alone has the same colours, though its paths start over the whole pixel."""
    behind, alone = pictures["stack.ball.hidden1_rgb"][0], pictures["stack.bare.rgb"][0]
    seen = pictures["stack.ball.hidden1_valid"][0]
    assert seen.sum() > 100
    np.testing.assert_allclose(behind[seen], alone[seen], rtol=0.1)
    np.testing.assert_allclose(behind[seen].mean(axis=0), alone[seen].mean(axis=0), rtol=0.005)


def test_which_shapes_are_open(geometry: Any) -> None:
    ball, wall = geometry.stacks()["ball"].shapes
    assert is_open(wall)
    assert not is_open(ball)
    box = geometry.solids().shapes[1]
    assert not is_open(box)
    assert not is_open(cuboid(box)), "its sides meet, though no two share a vertex"


@pytest.fixture(params=[pytest.param("scalar_rgb", marks=pytest.mark.slow), "llvm_ad_rgb"])
def light(request: pytest.FixtureRequest, rendered: Callable[..., Pictures]) -> Pictures:
    """The hidden layers of worker.py, once for each variant."""
    if request.param == "llvm_ad_rgb":
        request.getfixturevalue("needs_llvm")
    return rendered("simulator/render/worker.py", "hidden", request.param)


@pytest.mark.parametrize("layer", [1, 2])
def test_sixteen_paths_have_a_sixteenth_of_the_variance_of_one(light: Pictures, layer: int) -> None:
    valid = light[f"noisy.valid{layer}"]
    assert valid.sum() > 50
    one, sixteen = (light[f"noisy{samples}.rgb{layer}"][:, valid][..., ::2] for samples in (1, 16))
    # Each path shows one of two lamps: most of the light is noise.
    assert one.std(axis=0).mean() > 0.5 * one.mean()
    np.testing.assert_allclose(one.mean(), sixteen.mean(), rtol=0.1)
    # Estimated from 50 pixels or more and 12 seeds or more: the ratio's own standard deviation is 5 %.
    ratio = one.var(axis=0, ddof=1).mean() / sixteen.var(axis=0, ddof=1).mean()
    assert ratio == pytest.approx(16, rel=0.25)


def test_layers_have_noise_of_their_own(light: Pictures) -> None:
    """The same numbers for both would choose the same lamp for both, and errors would add up instead of averaging out."""
    both = light["noisy.valid1"] & light["noisy.valid2"]
    assert both.sum() > 50
    noise = []
    for layer in (1, 2):
        rgb = light[f"noisy1.rgb{layer}"][:, both]
        red_or_blue = rgb[..., 0] - rgb[..., 2]
        noise.append((red_or_blue - red_or_blue.mean(axis=0)).ravel())
    # Of 1200 pairs or more, independent ones have a correlation of less than 0.03.
    assert abs(np.corrcoef(noise[0], noise[1])[0, 1]) < 0.15


@pytest.mark.parametrize("max_depth", [2, 5])
def test_light_in_a_round_room_takes_as_many_bounces_as_are_asked_for(
    light: Pictures, analytic: Any, geometry: Any, max_depth: int
) -> None:
    """An integrating sphere: whatever a lamp's place, each bounce lights all of its wall alike, rho times as bright.

    A lamp of radiance L and radius r at distance d gives the irradiance ``pi L (r / d)^2 cos``, and its flux
    ``4 pi r^2 pi L`` the mean ``pi L (r / R)^2``, rho times which is what the first bounce adds.
    """
    valid = light["room.valid"]
    assert valid.sum() > 30
    points = (
        analytic.directions(geometry.ROOM_VIEW).reshape(*valid.shape, 3) * light["room.depth_m"][..., np.newaxis]
    )[valid]
    inwards = (geometry.ROOM_CENTRE_M - points) / geometry.ROOM_RADIUS_M
    np.testing.assert_allclose(np.linalg.norm(inwards, axis=1), 1, atol=2e-3)  # the chords of 96 sides
    towards = geometry.ROOM_LAMP.centre_m - points
    distance = np.linalg.norm(towards, axis=1)
    cosine = np.sum(inwards * towards, axis=1) / distance
    rho, radius = geometry.ROOM_REFLECTANCE, geometry.ROOM_LAMP.radius_m
    direct = (radius / distance) ** 2 * cosine
    bounced = (radius / geometry.ROOM_RADIUS_M) ** 2 * sum(rho**bounce for bounce in range(1, max_depth - 1))
    expected = rho * np.outer(direct + bounced, geometry.ROOM_LAMP.radiance).mean(axis=0)
    # 700 paths scatter by 0.7 %, and the ball's dim back is 1.4 % of what the wall behind it sees. One bounce more or less
    # would be 10 % of all.
    np.testing.assert_allclose(light[f"room.rgb{max_depth}"][valid].mean(axis=0), expected, rtol=0.03)


def test_a_lamp_behind_something_shines_unless_lights_are_hidden(light: Pictures, geometry: Any) -> None:
    seen = light["shown.valid"]
    assert seen.sum() > 10
    np.testing.assert_allclose(light["shown.rgb"][seen], np.tile(geometry.GLOW, (seen.sum(), 1)), rtol=1e-5)
    assert not light["unseen.rgb"].any()


def test_the_far_side_of_a_ring_is_behind_its_near_side() -> None:
    """One mesh hides itself; the backs between the two sides are no layers."""
    ring_m, tube_m, away_m = 0.02, 0.006, 0.1
    around, across = np.meshgrid(*(np.linspace(0, 2 * np.pi, 97) for _ in range(2)), indexing="ij")
    outwards = np.stack([np.cos(around), 0 * around, np.sin(around)], axis=-1)
    up = np.array([0.0, 1.0, 0.0])
    normals = (np.cos(across)[..., np.newaxis] * outwards + np.sin(across)[..., np.newaxis] * up).reshape(-1, 3)
    vertices = ring_m * outwards.reshape(-1, 3) + tube_m * normals + (0, 0, away_m)
    faces = grid_faces(97, 97)
    a, b, c = (vertices[faces[:, side]] for side in range(3))
    if np.sum(np.cross(b - a, c - a) * normals[faces[:, 0]]) < 0:
        faces = faces[:, ::-1]
    ring = TriangleMesh(
        vertices, normals, np.zeros((len(vertices), 2)), faces, Material(np.full((1, 1, 3), 0.5, np.float32))
    )
    view = View((1, 1), 19.2e-6, 1.9e-3, 0.036, 0.2)
    scene = Scene((ring,), (Environment(np.ones(3)),))
    clip = Renderer("scalar_rgb", ("hidden",), 2).still(scene, view, samples_per_pixel=4, seed=0, source={})
    # Chords of 96 sides lie below their circles by r (1 - cos(pi / 96)): 14 um of the ring, 3 um of the tube.
    assert clip.depth_m[0, 0, 0] == pytest.approx(away_m - ring_m - tube_m, abs=2e-5)
    assert clip.extras["hidden1_depth_m"][0, 0, 0] == pytest.approx(away_m + ring_m - tube_m, abs=2e-5)
    assert not clip.extras["hidden2_valid"].any()
