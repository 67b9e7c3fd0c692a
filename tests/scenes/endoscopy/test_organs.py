"""Organs as swept walls: analytic tubes, anatomical sizes, their own folds, and a closed wall in every direction ahead."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.signal import find_peaks

from scenes.endoscopy.organs import ORGANS, Course, Wall, closing, draw_course, fold_rows, relief, sweep


def test_courses_start_at_the_camera_along_z_and_never_bend_tighter_than_asked() -> None:
    for seed in range(20):
        course = draw_course(-0.002, 0.1, 0.03, 1.0, np.random.default_rng(seed))
        point, frame = course.at(np.zeros(()))
        np.testing.assert_allclose(point, 0, atol=1e-12)
        np.testing.assert_allclose(frame, np.eye(3), atol=1e-12)
        assert course.end_m == pytest.approx(0.1)
        squares = course.frames @ course.frames.transpose(0, 2, 1)
        np.testing.assert_allclose(squares, np.broadcast_to(np.eye(3), squares.shape), atol=1e-9)
        assert np.all(np.linalg.det(course.frames) > 0)
        turns = np.arccos(np.clip((course.frames[1:, 2] * course.frames[:-1, 2]).sum(axis=1), -1, 1))
        assert turns.max() / course.step_m <= 1 / 0.03 * 1.001
        steps = np.linalg.norm(np.diff(course.points_m, axis=0), axis=1)
        np.testing.assert_allclose(steps, course.step_m, rtol=1e-9)
        # Without twist: a frame turns about no axis but one across, so its vectors do not move along one another.
        twist = ((course.frames[1:, 0] - course.frames[:-1, 0]) * course.frames[:-1, 1]).sum(axis=1)
        assert np.abs(twist).max() < 2e-3


def test_a_plain_tube_has_the_area_normals_and_texture_of_its_prism() -> None:
    rows, columns, radius, length = 11, 24, 0.02, 0.05
    course = draw_course(0.0, length, 0.03, 0.0, np.random.default_rng(0))
    arc = np.repeat(np.linspace(0, length, rows)[:, np.newaxis], columns, axis=1)
    wall = sweep(course, arc, np.full(arc.shape, radius), tile_m=0.025, tiles_around=3)
    mesh = trimesh.Trimesh(wall.vertices_m, wall.faces, process=False)
    edge = 2 * radius * math.sin(math.pi / columns)
    assert mesh.area == pytest.approx(columns * edge * length, rel=1e-9)
    inwards = -wall.vertices_m * (1, 1, 0) / radius
    np.testing.assert_allclose(wall.normals, inwards, atol=1e-9)
    assert np.all((mesh.face_normals * -mesh.triangles_center * (1, 1, 0)).sum(axis=1) > 0), "faces look inwards"
    assert np.ptp(wall.uv[:, 0]) == pytest.approx(3)
    assert np.ptp(wall.uv[:, 1]) == pytest.approx(length / 0.025)


def test_a_tube_around_a_circle_is_a_torus() -> None:
    """An independent centreline: points and frames of a circle, not integrated by us."""
    bend, radius = 0.06, 0.015
    angle = np.linspace(0, 1.5, 400)
    zero, cos, sin = np.zeros_like(angle), np.cos(angle), np.sin(angle)
    points = bend * np.stack([1 - cos, zero, sin], axis=1)
    frames = np.stack(
        [np.stack([cos, zero, -sin], 1), np.stack([zero, zero + 1, zero], 1), np.stack([sin, zero, cos], 1)], 1
    )
    course = Course(0.0, bend * angle[1], points, frames)
    arc = np.repeat(np.linspace(0, course.end_m, 90)[:, np.newaxis], 64, axis=1)
    wall = sweep(course, arc, np.full(arc.shape, radius), tile_m=0.02, tiles_around=1)
    around = np.hypot(wall.vertices_m[:, 0] - bend, wall.vertices_m[:, 2]) - bend
    # Straight pieces between nodes 0.23 mm apart leave the circle by step^2 / (8 bend) = 0.1 um.
    np.testing.assert_allclose(np.hypot(around, wall.vertices_m[:, 1]), radius, atol=3e-7)
    area = trimesh.Trimesh(wall.vertices_m, wall.faces, process=False).area
    assert area == pytest.approx(2 * math.pi * radius * course.end_m, rel=2e-3)  # Pappus; 64 corners lose 0.04 %


def test_rows_crowd_around_folds_and_follow_their_crests() -> None:
    folds = np.array([0.01, 0.02, 0.035])
    fold, arc, follows = fold_rows(folds, 8)
    assert np.all(np.diff(arc) > 0)
    assert arc.shape == fold.shape == follows.shape == (24,)
    # Cells reach halfway to the next fold; the outermost rows lie half a row inside.
    assert 0.005 < arc[0] < 0.0065
    assert 0.0405 < arc[-1] < 0.0425
    for number, crest in enumerate(folds):
        own = arc[fold == number]
        assert np.abs(own - crest).min() < 3e-4
        assert follows[fold == number][np.abs(own - crest).argmin()] > 0.95
    assert follows.min() >= 0


def test_a_closing_end_is_an_ellipsoid_and_leaves_the_rest_alone() -> None:
    arc = np.array([-0.01, 0.03, 0.06, 0.08, 0.1, 0.12])
    np.testing.assert_allclose(closing(arc, 0.1, 0.04), [1, 1, 1, math.sqrt(0.75), 0, 0], atol=1e-9)


def test_relief_repeats_along_and_around_and_is_bounded() -> None:
    arc = np.repeat(np.linspace(0, 0.1, 41)[:, np.newaxis], 32, axis=1)
    bumps = relief(arc, 0.05, np.random.default_rng(3))
    np.testing.assert_allclose(bumps[:20], bumps[20:40], atol=1e-9)
    assert np.abs(bumps).max() <= 0.5
    assert np.ptp(bumps) > 0.4
    # Around, the last column joins the first: no larger step than anywhere else.
    assert np.abs(bumps[:, 0] - bumps[:, -1]).max() < 1.5 * np.abs(np.diff(bumps, axis=1)).max()


# Widths of the distended organs, metres: colon 3 to 6 cm, small intestine 2 to 3 cm, stomach up to 10 cm.
WIDTHS = {"colon": (0.03, 0.06), "small_intestine": (0.02, 0.032), "stomach": (0.045, 0.10)}


def straight(organ: str, seed: int, reach: float = 0.09) -> tuple[Wall, np.ndarray, np.ndarray]:
    """A straight one, with the distance from the axis and the angle of its vertices."""
    wall = ORGANS[organ].draw(reach, 0.0, np.random.default_rng(seed))
    x, y, _ = wall.vertices_m.T
    return wall, np.hypot(x, y), np.arctan2(y, x)


@pytest.mark.parametrize("organ", ORGANS)
def test_straight_organs_keep_their_promises_to_the_camera(organ: str) -> None:
    reach = 0.09
    for seed in range(20):
        wall, radius, _ = straight(organ, seed, reach)
        z = wall.vertices_m[:, 2]
        assert z.max() == pytest.approx(reach)
        assert z.min() > -0.006
        open_part = z < 0.4 * reach
        assert radius[open_part].min() >= ORGANS[organ].narrowest_m
        least, greatest = WIDTHS[organ]
        assert least <= 2 * radius[open_part].max() <= greatest
        assert radius[z == z.max()].max() < 1e-9, "closed at its end"


@pytest.mark.parametrize("organ", ORGANS)
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_every_ray_ahead_meets_a_wall_that_faces_the_camera(
    organ: str, seed: int, cast_rays: Callable[..., Any]
) -> None:
    wall = ORGANS[organ].draw(0.08, 1.0, np.random.default_rng(seed))
    mesh = trimesh.Trimesh(wall.vertices_m, wall.faces, process=False)
    slopes = np.random.default_rng(9).uniform(-1, 1, (15, 2))
    rays = np.column_stack([slopes, np.ones(15)])
    depth, face = cast_rays(wall.vertices_m, wall.faces, rays)
    assert np.isfinite(depth).all()
    assert np.all((mesh.face_normals[face] * rays).sum(axis=1) < 0)
    # Shading normals agree with the faces they belong to, but for a few on sharp folds; at the tip faces have no area.
    ahead = (mesh.area_faces > 1e-9) & (mesh.triangles_center[:, 2] > 0.003)
    agree = (mesh.face_normals[ahead, np.newaxis] * wall.normals[wall.faces[ahead]]).sum(axis=-1)
    assert np.mean(agree > 0) > 0.99
    np.testing.assert_allclose(np.linalg.norm(wall.normals, axis=1), 1, atol=1e-9)


def test_plicae_are_five_to_eight_millimetres_apart() -> None:
    for seed in range(10):
        wall, radius, _ = straight("small_intestine", seed, 0.1)
        z = wall.vertices_m[:, 2]
        bins = np.arange(0, 0.07, 0.0004)
        place = np.digitize(z, bins)
        # How far inwards the wall comes on average: highest at the folds' crests.
        mean = np.array(
            [radius[place == number].mean() if (place == number).any() else np.nan for number in range(1, len(bins))]
        )
        mean = np.interp(bins[:-1], bins[:-1][np.isfinite(mean)], mean[np.isfinite(mean)])
        mean = np.convolve(mean, np.ones(5) / 5, "same")
        peaks, _ = find_peaks(-mean[5:-5], prominence=1.5e-4, distance=7)
        spacing = 0.0004 * np.diff(peaks)
        assert 0.0045 < np.median(spacing) < 0.009


def test_the_openings_of_colonic_folds_are_triangles() -> None:
    """Between the three taeniae the folds reach in: the third harmonic of the opening's outline is the strongest."""
    wins = 0
    for seed in range(12):
        wall, radius, angle = straight("colon", seed, 0.1)
        ahead = (wall.vertices_m[:, 2] > 0.005) & (wall.vertices_m[:, 2] < 0.055)
        sector = ((angle + math.pi) / (2 * math.pi) * 36).astype(int) % 36
        opening = np.array([radius[ahead & (sector == number)].min() for number in range(36)])
        harmonics = np.abs(np.fft.rfft(opening))[1:7]
        wins += int(harmonics.argmax() == 2)
        assert opening.min() < 0.85 * opening.max()
    assert wins >= 10


def test_rugae_run_along_the_stomach() -> None:
    """Its wall varies faster around than along."""
    for seed in range(6):
        _, radius, _ = straight("stomach", seed)
        grid = radius.reshape(-1, 133)[5:25]  # 132 columns and the first again
        around = np.abs(np.diff(grid, axis=1)).mean()
        along = np.abs(np.diff(grid, axis=0)).mean()
        assert around > 1.2 * along
        waves = np.abs(np.fft.rfft(grid[:, :-1], axis=1)).mean(axis=0)
        assert 9 < 6 + waves[6:40].argmax() < 32, "folds around it"
