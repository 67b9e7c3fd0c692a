"""The organs have anatomical sizes, the folds that they are known by, and a closed wall in every direction ahead."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.signal import find_peaks

from scenes.anatomy.lumen import Wall
from scenes.anatomy.organs import ORGANS

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
