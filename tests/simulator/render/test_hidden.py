"""Layers behind the picture, against all crossings of the pixels' rays in closed form, for both variants."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from simulator.render.hidden import is_open
from simulator.render.mesh import cuboid

Pictures = Mapping[str, NDArray[Any]]
STACKS = ("ball", "box", "paper", "back", "nested", "bare")


def expected_layers(
    scene: Any, crossings: Any, count: int
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.bool_]]:
    """The rule, ray by ray: the next surface of another shape whose outside faces the camera, or that is open.

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
            if layer < 0 or (shape != shapes[layer, ray] and (facing or shape in open_shapes)):
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
