"""Clips: slots, frame edges, and that updating a scene gives what loading it would."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.render import Environment, EnvironmentMap, Material, Renderer, Scene, Sphere, SphereLight
from simulator.types import View

Pictures = Mapping[str, NDArray[Any]]
VIEW = View((8, 10), 120e-6, 1.9e-3, 0.036, 0.2)
EYE = np.eye(3)


def clip(frames: list[Scene], frames_per_second: float = 30.0, seed: int = 5) -> Any:
    return Renderer("scalar_rgb").clip(
        frames, VIEW, frames_per_second=frames_per_second, samples_per_pixel=1, seed=seed, source={}
    )


@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_frame_is_the_still_of_its_scene(pictures: Pictures, number: int) -> None:
    """Although the clip replaced what stood on the stage and the still loaded all anew.

    Byte for byte in the first frame. In the others up to float32's rounding: Mitsuba's light from everywhere sits on a ball
    about the scene that was loaded first.
    """
    moving, still = (
        [pictures[f"{clip}.{name}"][frame] for name in ("rgb", "depth_m", "valid")]
        for clip, frame in (("moves", number), (f"alone{number}", 0))
    )
    if number == 0:
        assert [one.tobytes() for one in moving] == [one.tobytes() for one in still]
        return
    np.testing.assert_allclose(moving[0], still[0], rtol=1e-6)
    np.testing.assert_allclose(moving[1], still[1], rtol=1e-6)
    np.testing.assert_array_equal(moving[2], still[2])
    assert moving[0].tobytes() != pictures["moves.rgb"][0].tobytes()


def test_frame_edges_are_exact(geometry: Any, pictures: Pictures) -> None:
    np.testing.assert_array_equal(pictures["moves.edges_s"], [0, 1 / 3000, 2 / 3000, 3 / 3000])
    still = Scene((), (Environment(np.ones(3)),))
    # Sums of 1 / 29.97 would be off in the last digits.
    expected = [number / 29.97 for number in range(8)]
    np.testing.assert_array_equal(clip([still] * 7, 29.97).frame_edges_s, expected)


def test_frames_have_noise_of_their_own_and_the_first_is_a_stills() -> None:
    lamp = SphereLight(np.array([0.3, -0.2, 0.0]), 0.1, np.full(3, 5.0))
    ball = Sphere(np.array([0.0, 0.0, 0.1]), 0.04, plain(0.5), EYE)
    scene = Scene((ball,), (lamp, Environment(np.ones(3))))
    moving = clip([scene, scene], seed=7)
    still = Renderer("scalar_rgb").still(scene, VIEW, samples_per_pixel=1, seed=7, source={})
    assert moving.rgb[0].tobytes() == still.rgb[0].tobytes()
    assert moving.rgb[1].tobytes() != still.rgb[0].tobytes()
    assert moving.depth_m[1].tobytes() == still.depth_m[0].tobytes()


def plain(value: float, texels: int = 2, roughness: float | None = None) -> Material:
    return Material(np.full((texels, texels, 3), value, np.float32), roughness)


def test_slots_must_stay(geometry: Any) -> None:
    ball = Sphere(np.array([0.0, 0.0, 0.1]), 0.02, plain(0.5), EYE)
    sheet = geometry.upright(-0.01, -0.01, 0.01, 0.01, 0.1, plain(0.5))
    around = EnvironmentMap(np.ones((4, 8, 3), np.float32))
    lamp = SphereLight(np.array([0.3, 0.0, 0.0]), 0.1, np.ones(3))
    light = Environment(np.ones(3))
    one = Scene((ball, sheet), (light, lamp))
    longer = replace(
        sheet,
        vertices_m=np.vstack([sheet.vertices_m, sheet.vertices_m[:1]]),
        normals=np.vstack([sheet.normals, sheet.normals[:1]]),
        uv=np.vstack([sheet.uv, sheet.uv[:1]]),
    )
    for other, words in (
        (Scene((ball,), (light, lamp)), "2 shapes and 2 lights, the next 1 and 2"),
        (Scene((ball, sheet), (light,)), "2 shapes and 2 lights, the next 2 and 1"),
        (Scene((sheet, sheet), (light, lamp)), "shape 0 changes from Sphere"),
        (Scene((ball, longer), (light, lamp)), "shape 1 changes from TriangleMesh of 4 vertices and 2 faces"),
        (Scene((replace(ball, material=plain(0.5, 3)), sheet), (light, lamp)), "texture of 2 x 2 to .* 3 x 3"),
        (Scene((replace(ball, material=plain(0.5, 2, 0.3)), sheet), (light, lamp)), "matt.* to .*coated"),
        (Scene((ball, sheet), (lamp, light)), "light 0 changes from Environment to SphereLight"),
    ):
        with pytest.raises(InputError, match=f"frames: .*{words}"):
            clip([one, other])
    with pytest.raises(InputError, match="light 0 is an EnvironmentMap, which cannot change"):
        clip([Scene((ball,), (around,)), Scene((ball,), (EnvironmentMap(np.ones((4, 8, 3), np.float32)),))])
    with pytest.raises(InputError, match="frames: got none"):
        clip([])


def test_lights_and_materials_are_replaced(geometry: Any) -> None:
    """In light of 1 from everywhere, a wall around the view has the radiance of its reflectance."""
    wall = geometry.upright(-0.3, -0.3, 0.3, 0.3, 0.1, plain(0.5))
    first = Scene((wall,), (Environment(np.array([1.0, 1, 1])),))
    second = Scene((replace(wall, material=plain(0.25)),), (Environment(np.array([1.0, 2, 4])),))
    means = (
        Renderer("scalar_rgb")
        .clip([first, second, first], VIEW, frames_per_second=30, samples_per_pixel=64, seed=1, source={})
        .rgb.mean(axis=(1, 2))
    )
    # 80 pixels x 64 paths, each with a deviation below its value.
    np.testing.assert_allclose(means, [(0.5, 0.5, 0.5), (0.25, 0.5, 1), (0.5, 0.5, 0.5)], rtol=0.03)


def test_a_map_of_the_surroundings_stands_upright() -> None:
    """Its radiance in a direction (x, y, z), y down: column by the angle from straight ahead to the right, row from above."""
    rows, columns = 64, 128
    row, column = np.mgrid[:rows, :columns] + 0.5
    radiance = np.stack([row / rows, column / columns, np.full(row.shape, 0.5)], axis=-1).astype(np.float32)
    seen = Renderer("scalar_rgb").still(
        Scene((), (EnvironmentMap(radiance),)), VIEW, samples_per_pixel=64, seed=0, source={}
    )
    assert not seen.valid.any()
    tangent = VIEW.pixel_pitch_m / VIEW.distance_m
    x, y = np.meshgrid((np.arange(10) - 4.5) * tangent, (np.arange(8) - 3.5) * tangent)
    from_above = np.arccos(-y / np.sqrt(x**2 + y**2 + 1)) / np.pi
    to_the_right = 0.5 + np.arctan2(x, 1) / (2 * np.pi)
    # A pixel is 0.06 wide: its mean is within 1e-3 of its centre's value, the noise of 64 strata within 1e-3.
    np.testing.assert_allclose(seen.rgb[0, ..., 0], from_above, atol=2e-3)
    np.testing.assert_allclose(seen.rgb[0, ..., 1], to_the_right, atol=2e-3)
    np.testing.assert_allclose(seen.rgb[0, ..., 2], 0.5, rtol=1e-5)
