"""Stills against geometry and radiometry, for both variants; clips: slots, frame edges, updates like loading anew."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from simulator.errors import InputError
from simulator.render import Environment, EnvironmentMap, Material, Renderer, Scene, Sphere, SphereLight
from simulator.types import View

Pictures = Mapping[str, NDArray[Any]]
VIEW = View((48, 64), 19.2e-6, 1.9e-3, 0.036, 0.2)  # as in worker.py
MANY_PATHS = ("plane", "ball", "box", "edge", "lamp", "margin", "alone", "field")  # 64 and more per pixel


def test_the_picture_is_upright_and_on_the_right_half_pixel(pictures: Pictures) -> None:
    # A black wall, right of x = 3.25 pixels and below y = -5.375 pixels, before a white environment.
    red = np.asarray(pictures["edge.rgb"])[..., 0]
    columns, rows = np.arange(64) - 32.0, np.arange(48) - 24.0  # the pixels' left and upper edges from the centre
    share_right = np.clip(columns + 1 - 3.25, 0, 1)
    share_below = np.clip(rows + 1 + 5.375, 0, 1)
    expected = 1 - share_below[:, np.newaxis] * share_right
    assert (expected[18, 40], expected[30, 35]) == (0.625, 0.25)
    # 8 x 8 strata in a pixel make shares of eighths exact, but for a sample that rounds across the edge.
    np.testing.assert_allclose(red, expected, atol=1.01 / 64)
    seen = (rows + 0.5 > -5.375)[:, np.newaxis] & (columns + 0.5 > 3.25)
    np.testing.assert_array_equal(pictures["edge.valid"], seen)


def test_depth_never_mixes_two_surfaces(pictures: Pictures) -> None:
    depth = pictures["edge.depth"]
    assert np.all(np.isclose(depth, 0.07, rtol=1e-6) | (depth == np.float32(0.2)))


def test_a_lamp_gives_the_irradiance_of_its_solid_angle(pictures: Pictures) -> None:
    rgb = np.asarray(pictures["lamp.rgb"])
    centre = rgb[22:26, 30:34].mean(axis=(0, 1))
    # Radiance = reflectance L (r / D)^2 for a ball of radius 0.1 m at D = 0.55 m straight before the wall.
    expected = 0.8 * (0.1 / 0.55) ** 2 * np.array([10.0, 20.0, 30.0])
    np.testing.assert_allclose(centre, expected, rtol=0.01)  # 16 pixels x 64 paths; off-axis by at most 0.3 degrees


def test_a_margin_is_what_a_wider_picture_shows_there_and_leaves_the_image_as_it_is(pictures: Pictures) -> None:
    for part in ("rgb", "depth", "valid"):
        np.testing.assert_array_equal(pictures[f"margin.{part}"], pictures[f"alone.{part}"])
    fine, coarse = (np.asarray(pictures[name], np.float64) for name in ("field.rgb", "margin.around"))
    rows, columns = coarse.shape[:2]
    more = [(4 * size - have) // 2 for size, have in zip((rows, columns), fine.shape, strict=False)]
    inside = tuple(slice(1 if beyond else 0, -1 if beyond else None) for beyond in more)  # whole coarse pixels
    padded = np.pad(fine, [(more[0],) * 2, (more[1],) * 2, (0, 0)])
    means = padded.reshape(rows, 4, columns, 4, 3).mean(axis=(1, 3))
    error = np.linalg.norm((coarse - means)[inside]) / np.linalg.norm(means[inside])
    assert error < 0.1  # the noise of 128 paths for each coarse pixel is 0.07
    assert coarse[inside].mean() == pytest.approx(means[inside].mean(), rel=0.02)
    # A coarse pixel's centre lies between four fine ones.
    depth = np.pad(np.asarray(pictures["field.depth"], np.float64), [(size, size) for size in more])
    near, far = (
        pick([depth[1 + down :: 4, 1 + right :: 4] for down in (0, 1) for right in (0, 1)], axis=0)
        for pick in (np.min, np.max)
    )
    found = np.asarray(pictures["margin.around_depth"])
    between = (found > near * (1 - 1e-3)) & (found < far * (1 + 1e-3))
    assert between[inside].mean() > 0.95  # but for what is smaller than a pixel


@pytest.mark.slow
def test_threads_and_order_change_no_byte_or_last_digits_of_many_paths_only(
    pictures: Pictures, rendered: Callable[..., Pictures], request: pytest.FixtureRequest
) -> None:
    variant = request.node.callspec.params["pictures"]
    other = rendered("simulator/render/worker.py", "stills", variant, "2")
    assert pictures.keys() == other.keys()
    for name, picture in pictures.items():
        scene, _, part = name.partition(".")
        if variant == "llvm_ad_rgb" and part in ("rgb", "around") and scene in MANY_PATHS:
            np.testing.assert_allclose(picture, other[name], rtol=1e-5)  # float32's sum of 512 in another order
        else:
            assert picture.tobytes() == other[name].tobytes(), name
    assert not np.array_equal(pictures["things0.rgb"], pictures["things1.rgb"])
    assert not np.array_equal(pictures["noisy"][0], pictures["noisy"][1])


@pytest.mark.usefixtures("needs_llvm")
def test_both_variants_agree(rendered: Callable[..., Pictures]) -> None:
    scalar, llvm = (
        rendered("simulator/render/worker.py", "stills", variant, "1") for variant in ("scalar_rgb", "llvm_ad_rgb")
    )
    for name in ("plane", "ball", "box", "edge", "things0", "things1", "things2"):
        np.testing.assert_array_equal(scalar[f"{name}.valid"], llvm[f"{name}.valid"])
        different = ~np.isclose(scalar[f"{name}.depth"], llvm[f"{name}.depth"], rtol=1e-5)
        # Two tracers may disagree where a ray meets an edge between triangles or a ball's rim: one pixel in 500.
        assert different.mean() <= 0.002, name
    first, second = (np.asarray(images["noisy"], dtype=np.float64) for images in (scalar, llvm))
    runs = len(first)
    scatter = np.sqrt((first.var(axis=0, ddof=1) + second.var(axis=0, ddof=1)) / runs)
    score = (first.mean(axis=0) - second.mean(axis=0)) / np.maximum(scatter, 1e-6)
    # Welch's t with about 2 (runs - 1) degrees of freedom; Sidak: all values pass together with probability 0.99.
    freedom = 2 * (runs - 1)
    limit = stats.t.ppf(1 - (1 - 0.99 ** (1 / score.size)) / 2, freedom)
    assert np.abs(score).max() < limit
    # The scores must scatter as t does (variance 30/28), neither wider (a difference) nor narrower (a blunt test).
    assert np.mean(score**2) == pytest.approx(freedom / (freedom - 2), rel=0.2)
    assert first.mean() == pytest.approx(second.mean(), rel=0.01)


@pytest.mark.parametrize(
    ("samples", "seed", "named"), [(0, 0, "^samples_per_pixel: "), (1, -1, "^seed: "), (1, 2**32, "^seed: ")]
)
def test_bad_numbers_are_refused(samples: int, seed: int, named: str) -> None:
    scene = Scene((), (Environment(np.ones(3)),))
    with pytest.raises(InputError, match=named):
        Renderer("scalar_rgb").still(scene, VIEW, samples_per_pixel=samples, seed=seed, source={})


def test_an_empty_scene_is_all_misses_with_a_finite_depth_even_if_far_is_infinite() -> None:
    scene = Scene((), (Environment(np.array([0.25, 0.5, 1.0])),))
    view = View((4, 6), 19.2e-6, 1.9e-3, 0.036, float("inf"))
    clip = Renderer("scalar_rgb").still(scene, view, samples_per_pixel=7, seed=0, source={"family": "none"})
    assert not clip.valid.any()
    assert np.all(clip.depth_m == 1e6)
    np.testing.assert_allclose(clip.rgb, np.broadcast_to([0.25, 0.5, 1.0], (1, 4, 6, 3)), rtol=1e-6)
    np.testing.assert_array_equal(clip.frame_edges_s, [0, 1])
    expected = {
        "family": "none",
        "samples_per_pixel": 8,
        "render_seed": 0,
        "variant": "scalar_rgb",
        "repaired_pixels": 0,
    }
    assert clip.source == expected


FEW = View((8, 10), 120e-6, 1.9e-3, 0.036, 0.2)
EYE = np.eye(3)


def clip(frames: list[Scene], frames_per_second: float = 30.0, seed: int = 5) -> Any:
    return Renderer("scalar_rgb").clip(
        frames, FEW, frames_per_second=frames_per_second, samples_per_pixel=1, seed=seed, source={}
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
    still = Renderer("scalar_rgb").still(scene, FEW, samples_per_pixel=1, seed=7, source={})
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
    for other in (
        Scene((ball,), (light, lamp)),
        Scene((ball, sheet), (light,)),
        Scene((sheet, sheet), (light, lamp)),
        Scene((ball, longer), (light, lamp)),
        Scene((replace(ball, material=plain(0.5, 3)), sheet), (light, lamp)),
        Scene((replace(ball, material=plain(0.5, 2, 0.3)), sheet), (light, lamp)),
        Scene((ball, sheet), (lamp, light)),
    ):
        with pytest.raises(InputError, match=r"^frames: "):
            clip([one, other])
    with pytest.raises(InputError, match=r"^frames: "):
        clip([Scene((ball,), (around,)), Scene((ball,), (EnvironmentMap(np.ones((4, 8, 3), np.float32)),))])
    with pytest.raises(InputError, match=r"^frames: "):
        clip([])


def test_a_map_of_the_surroundings_stands_upright() -> None:
    """Its radiance in a direction (x, y, z), y down: column by the angle from straight ahead to the right, row from above."""
    rows, columns = 64, 128
    row, column = np.mgrid[:rows, :columns] + 0.5
    radiance = np.stack([row / rows, column / columns, np.full(row.shape, 0.5)], axis=-1).astype(np.float32)
    seen = Renderer("scalar_rgb").still(
        Scene((), (EnvironmentMap(radiance),)), FEW, samples_per_pixel=64, seed=0, source={}
    )
    assert not seen.valid.any()
    tangent = FEW.pixel_pitch_m / FEW.distance_m
    x, y = np.meshgrid((np.arange(10) - 4.5) * tangent, (np.arange(8) - 3.5) * tangent)
    from_above = np.arccos(-y / np.sqrt(x**2 + y**2 + 1)) / np.pi
    to_the_right = 0.5 + np.arctan2(x, 1) / (2 * np.pi)
    # A pixel is 0.06 wide: its mean is within 1e-3 of its centre's value, the noise of 64 strata within 1e-3.
    np.testing.assert_allclose(seen.rgb[0, ..., 0], from_above, atol=2e-3)
    np.testing.assert_allclose(seen.rgb[0, ..., 1], to_the_right, atol=2e-3)
    np.testing.assert_allclose(seen.rgb[0, ..., 2], 0.5, rtol=1e-5)
