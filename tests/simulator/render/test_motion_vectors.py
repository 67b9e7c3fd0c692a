"""Motion vectors against bodies moved in closed form and projected, for both variants."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.render import Renderer

Pictures = Mapping[str, NDArray[Any]]
BALL, BOX, SHEET, WALL = range(4)
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
    with pytest.raises(InputError, match=r"render\.outputs: motion needs clips"):
        Renderer("scalar_rgb", ("motion",)).still(
            geometry.away(), geometry.VIEW, samples_per_pixel=1, seed=0, source={}
        )
