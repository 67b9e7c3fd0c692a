"""A first_hits at a surface agrees with trimesh's own ray casting."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from scenes.endoscopy.endoscope import draw_poses, first_hits
from scenes.endoscopy.organs import ORGANS
from simulator.types import View

VIEW = View((96, 128), 19.2e-6, 1.9e-3, 0.005, 0.1)


def test_points_and_faces_are_those_of_an_independent_ray_caster(cast_rays: Callable[..., Any]) -> None:
    wall = ORGANS["small_intestine"].draw(0.05, 1.0, np.random.default_rng(3))
    pose = draw_poses(wall.course, np.zeros(1), np.zeros(1), 0.003, 0.3, 1.0, np.random.default_rng(4))[0]
    points = pose.seen(wall.vertices_m)
    seen = first_hits(VIEW, points, wall.faces)
    assert seen.missed == 0
    assert len(seen.points_m) == len(seen.face) == 81
    slopes = seen.points_m[:, :2] / seen.points_m[:, 2:]
    np.testing.assert_allclose(np.abs(slopes).max(axis=0), (VIEW.tan_half_width, VIEW.tan_half_height))
    depth, face = cast_rays(points, wall.faces, np.column_stack([slopes, np.ones(81)]))
    np.testing.assert_allclose(seen.points_m[:, 2], depth, rtol=1e-9)
    assert np.mean(face == seen.face) > 0.95  # a ray along an edge may meet either neighbour


def test_rays_past_the_surface_are_counted_and_backs_are_not_seen() -> None:
    # A triangle that covers the left half of the picture and faces the camera.
    left = np.array([(0.0, -1, 1), (0, 1, 1), (-2, 0, 1)]) - (1e-6, 0, 0)
    faces = np.array([(0, 1, 2)])
    normal = np.cross(left[1] - left[0], left[2] - left[0])
    seen = first_hits(VIEW, left, faces if normal[2] < 0 else faces[:, ::-1])
    assert seen.missed == 5 * 9
    np.testing.assert_allclose(seen.points_m[:, 2], 1)
    assert first_hits(VIEW, left, faces[:, ::-1] if normal[2] < 0 else faces).missed == 81
    assert first_hits(VIEW, left * (1, 1, -1), faces).missed == 81
