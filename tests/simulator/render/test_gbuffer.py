"""What the pixels' centres see, and where it will be next, against surfaces and motions in closed form, for both variants."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.render import Renderer, activate
from simulator.render.gbuffer import centre_depth, centre_gbuffer
from simulator.render.mitsuba_scene import cuboid, load_scene
from simulator.types import View

Pictures = Mapping[str, NDArray[Any]]
BALL, BOX, SHEET, LAMP = range(4)
WALL = 3  # of the moving scene


@pytest.fixture(scope="module")
def truth(analytic: Any, geometry: Any) -> Any:
    """The crossings of every pixel's centre ray with the solids, and which pixels can be judged."""
    return analytic.trace(geometry.solids(), analytic.directions(geometry.VIEW))


@pytest.fixture(scope="module")
def clear(truth: Any) -> NDArray[np.bool_]:
    """Not within rounding of an outline: float32 cannot tell whether a ray that grazes a surface hits it."""
    return np.all((truth.grazing[:, :2] > 0.03) | (truth.shape[:, :2] < 0), axis=1)


def test_every_kind_of_surface_is_in_the_picture(truth: Any, clear: NDArray[np.bool_]) -> None:
    seen = truth.shape[clear, 0]
    assert all(np.count_nonzero(seen == number) > 20 for number in (BALL, BOX, SHEET, LAMP, -1))
    assert np.mean(clear) > 0.98


def test_shape_ids_and_depth_are_those_of_the_first_surface(
    pictures: Pictures, truth: Any, clear: NDArray[np.bool_]
) -> None:
    found = pictures["solids.shape_id"].ravel()
    different = (found != truth.shape[:, 0]) & clear
    assert different.sum() <= 2, "a ray that meets an edge of a box or sheet may go either way"
    same = clear & ~different & (found >= 0)
    # float32 rays and surfaces; where a ray meets a ball at 0.03 of its normal the error grows by 1 / 0.03.
    np.testing.assert_allclose(pictures["solids.depth_m"].ravel()[same], truth.z[same, 0], rtol=1e-5)
    np.testing.assert_array_equal(pictures["solids.valid"].ravel(), found >= 0)


def test_normals_are_the_surfaces_own_turned_towards_the_camera(
    pictures: Pictures, truth: Any, clear: NDArray[np.bool_]
) -> None:
    found = pictures["solids.normal"].reshape(-1, 3)
    seen = clear & (pictures["solids.shape_id"].ravel() == truth.shape[:, 0]) & (truth.shape[:, 0] >= 0)
    expected = truth.normal[:, 0] * np.where(truth.facing[:, :1], 1, -1)
    # A ball's normal is (p - c) / r: the 1e-5 r by which p is rounded where a ray grazes it.
    np.testing.assert_allclose(found[seen], expected[seen], atol=2e-5)
    assert not np.any(found[pictures["solids.shape_id"].ravel() < 0])


def test_the_back_of_a_sheet_looks_like_its_front(pictures: Pictures) -> None:
    seen = pictures["away.shape_id"] == 0
    assert seen.sum() > 100
    np.testing.assert_allclose(pictures["away.normal"][seen], np.tile((0, 0, -1), (seen.sum(), 1)), atol=1e-6)
    np.testing.assert_allclose(pictures["away.albedo"][seen], np.tile((0.6, 0.5, 0.4), (seen.sum(), 1)), rtol=1e-6)
    # Light of 1 from everywhere before and behind: its radiance is its reflectance, up to the noise of 4 paths a pixel.
    np.testing.assert_allclose(pictures["away.rgb"][seen].mean(axis=0), (0.6, 0.5, 0.4), rtol=0.05)


def bilinear(texture: NDArray[Any], uv: NDArray[Any]) -> NDArray[Any]:
    """Texels have their centres at half numbers; row 0 is v = 0; the texture repeats."""
    rows, columns = texture.shape[:2]
    x, y = uv[:, 0] * columns - 0.5, uv[:, 1] * rows - 0.5
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    right_share, lower_share = (x - left)[:, np.newaxis], (y - top)[:, np.newaxis]
    corner = [[texture[(top + dy) % rows, (left + dx) % columns] for dx in (0, 1)] for dy in (0, 1)]
    upper = (1 - right_share) * corner[0][0] + right_share * corner[0][1]
    lower = (1 - right_share) * corner[1][0] + right_share * corner[1][1]
    return (1 - lower_share) * upper + lower_share * lower


def test_albedo_is_the_textures_colour(pictures: Pictures, truth: Any, geometry: Any) -> None:
    ids, albedo = pictures["solids.shape_id"].ravel(), pictures["solids.albedo"].reshape(-1, 3)
    for number, colour in ((BALL, (0.7, 0.3, 0.1)), (BOX, (0.2, 0.5, 0.8)), (-1, (0, 0, 0))):
        np.testing.assert_allclose(albedo[ids == number], np.tile(colour, (np.sum(ids == number), 1)), rtol=1e-6)
    seen = (ids == SHEET) & (truth.shape[:, 0] == SHEET)
    mesh = geometry.solids().shapes[SHEET]
    second, third = truth.weights[seen, 0].T
    weights = np.stack([1 - second - third, second, third], axis=1)
    uv = np.einsum("nc,ncx->nx", weights, mesh.uv[mesh.faces[truth.triangle[seen, 0]]])
    # float32 coordinates are off by 1e-6 of the sheet; texels differ by 0.8 at most over a sixth of it. Dr.Jit's texture
    # units interpolate with full precision.
    np.testing.assert_allclose(albedo[seen], bilinear(geometry.TEXTURE, uv), atol=1e-5)


def test_barycentric_weights_lead_back_to_the_point(pictures: Pictures, geometry: Any, analytic: Any) -> None:
    ids = pictures["solids.shape_id"][0]
    z = pictures["hits.depth_m"]
    np.testing.assert_array_equal(np.isfinite(z), ids >= 0)
    point = analytic.directions(geometry.VIEW).reshape(*z.shape, 3) * np.where(ids >= 0, z, 0)[..., np.newaxis]
    # float32 rays: 5e-7 of 0.2 m, for points are found along the ray for the depth, on the triangle for themselves.
    np.testing.assert_allclose(pictures["hits.point_m"][ids >= 0], point[ids >= 0], atol=1e-7)
    shapes = geometry.solids().shapes
    for number, mesh in ((BOX, cuboid(shapes[BOX])), (SHEET, shapes[SHEET])):
        second, third = np.moveaxis(pictures["hits.barycentric"][ids == number].astype(float), -1, 0)
        weights = np.stack([1 - second - third, second, third], axis=1)
        assert weights.min() > -1e-6
        corners = mesh.vertices_m[mesh.faces[pictures["hits.triangle"][ids == number]]]
        # The sheet is 0.15 m wide: float32 weights and rays are off by some 1e-7 of it.
        np.testing.assert_allclose(np.einsum("nc,ncx->nx", weights, corners), point[ids == number], atol=2e-7)


def test_depth_does_not_depend_on_the_near_end(geometry: Any, analytic: Any) -> None:
    """Mitsuba's rays start at the near plane, which follows the view's near end; z must be the world's all the same."""
    activate("scalar_rgb")
    small = replace(geometry.VIEW, shape=(18, 24), pixel_pitch_m=51.2e-6)
    truth = analytic.trace(geometry.solids(), analytic.directions(small))
    clear = (truth.grazing[:, 0] > 0.1) & (truth.shape[:, 0] >= 0)
    for near_m in (0.0005, 0.01, 0.036, 0.11):  # the last is behind the box
        view = View(small.shape, small.pixel_pitch_m, small.distance_m, near_m, 0.2)
        depth = centre_depth(load_scene(geometry.solids(), view, 5)).ravel()
        np.testing.assert_allclose(depth[clear], truth.z[clear, 0], rtol=2e-6)


def test_depth_alone_is_that_of_the_whole_buffer(geometry: Any) -> None:
    activate("scalar_rgb")
    loaded = load_scene(geometry.solids(), replace(geometry.VIEW, shape=(18, 24), pixel_pitch_m=51.2e-6), 5)
    assert centre_depth(loaded).tobytes() == centre_gbuffer(loaded).depth_m.tobytes()


def test_only_what_was_asked_for_is_there(geometry: Any) -> None:
    view = View((4, 6), 200e-6, 1.9e-3, 0.036, 0.2)
    few = {"samples_per_pixel": 1, "seed": 0, "source": {}}
    assert Renderer("scalar_rgb").still(geometry.away(), view, **few).extras == {}
    clip = Renderer("scalar_rgb", ("albedo",)).still(geometry.away(), view, **few)
    assert clip.extras.keys() == {"albedo"}


MARGIN = 2e-3


@pytest.fixture(scope="module", params=(0, 1), ids=("from_first", "from_second"))
def step(request: pytest.FixtureRequest, analytic: Any, geometry: Any) -> dict[str, Any]:
    """For one pair of frames: what is seen, where its points come to be, and whether they are seen there."""
    number = request.param
    before, after = geometry.moves()[number : number + 2]
    rays = analytic.directions(geometry.VIEW)
    seen = analytic.trace(before, rays)
    assert np.all(seen.shape[:, 0] >= 0), "the wall fills the picture"
    points = rays * seen.z[:, :1]
    came_to = points.copy()
    for shape in (BALL, BOX):  # rigid: x -> c' + R' R^T (x - c)
        old, new = before.shapes[shape], after.shapes[shape]
        turn = new.rotation @ old.rotation.T
        here = seen.shape[:, 0] == shape
        came_to[here] = new.centre_m + (points[here] - old.centre_m) @ turn.T
    # The sheet is stretched along x and shifted: undo what this frame did to it, do what the next does.
    shift = np.array([0.01, -0.004, -0.002])
    here = seen.shape[:, 0] == SHEET
    rest = (points[here] - shift * number) / (1 + 0.1 * number, 1, 1)
    came_to[here] = rest * (1 + 0.1 * (number + 1), 1, 1) + shift * (number + 1)
    there = analytic.trace(after, came_to / came_to[:, 2:])
    rows, columns = geometry.VIEW.shape
    place = analytic.project(came_to, geometry.VIEW)
    outside = np.max(np.abs(place - ((columns - 1) / 2, (rows - 1) / 2)) - (columns / 2, rows / 2), axis=1)
    # How much nearer than the point something stands, as a share of its depth: 0 if it is the first there.
    blocked = 1 - there.z[:, 0] / came_to[:, 2]
    return {
        "number": number,
        "shape": seen.shape[:, 0],
        "clear": seen.grazing[:, 0] > 0.1,
        "motion": np.column_stack([place - analytic.project(points, geometry.VIEW), came_to[:, 2] - points[:, 2]]),
        "valid": (outside < 0) & (blocked < MARGIN),
        # Rims, edges, and points on the far side of their own body that are hardly covered, may go either way.
        "sure": (np.abs(outside) > 0.01) & ((blocked > MARGIN) | ((blocked < 1e-6) & (there.grazing[:, 0] > 0.1))),
    }


@pytest.mark.parametrize("shape", [BALL, BOX, SHEET, WALL], ids=["ball", "box", "sheet", "wall"])
def test_motion_is_the_projection_of_the_moved_points(pictures: Pictures, step: dict[str, Any], shape: int) -> None:
    number = step["number"]
    here = (step["shape"] == shape) & step["clear"] & (pictures["moves.shape_id"][number].ravel() == shape)
    assert here.sum() > 50
    found = pictures["moves.motion"][number].reshape(-1, 3)[here]
    expected = step["motion"][here]
    if shape != WALL:
        assert np.abs(expected[:, :2]).max() > 1, "it moves by pixels"
    np.testing.assert_allclose(found[:, :2], expected[:, :2], atol=1e-4)
    # Depth is off by float32's rounding of 0.2 m, a tenth of a micrometre.
    np.testing.assert_allclose(found[:, 2], expected[:, 2], atol=2e-7)


def test_points_that_leave_or_are_covered_are_not_valid(pictures: Pictures, step: dict[str, Any]) -> None:
    number = step["number"]
    sure = step["sure"] & step["clear"] & (pictures["moves.shape_id"][number].ravel() == step["shape"])
    found = pictures["moves.motion_valid"][number].ravel()
    np.testing.assert_array_equal(found[sure], step["valid"][sure])
    assert sure.mean() > 0.9
    assert np.sum(sure & ~step["valid"]) > 100, "the ball covers wall, the turning box its own sides"


def test_the_last_frame_goes_nowhere(pictures: Pictures) -> None:
    assert not pictures["moves.motion"][-1].any()
    assert not pictures["moves.motion_valid"][-1].any()
    assert pictures["moves.motion"].shape == (3, 48, 64, 3)


def test_a_still_has_no_motion(geometry: Any) -> None:
    with pytest.raises(InputError, match=r"^render\.outputs: "):
        Renderer("scalar_rgb", ("motion",)).still(
            geometry.away(), geometry.VIEW, samples_per_pixel=1, seed=0, source={}
        )
