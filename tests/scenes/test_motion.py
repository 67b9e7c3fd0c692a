"""Rotations, courses in time, and meshes put into place, against an independent implementation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from scenes.fast.bodies import bodies
from scenes.motion import minimum_jerk, placed, random_rotation, rotation
from scenes.surfaces import face_cross
from simulator.render import Material


def test_rotations_agree_with_scipy() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        axis, angle = rng.standard_normal(3), rng.uniform(-7, 7)
        expected = Rotation.from_rotvec(angle * axis / np.linalg.norm(axis)).as_matrix()
        np.testing.assert_allclose(rotation(axis, angle), expected, atol=1e-12)


def test_random_rotations_are_rotations_and_uniform() -> None:
    rng = np.random.default_rng(1)
    turns = np.stack([random_rotation(rng) for _ in range(4000)])
    np.testing.assert_allclose(turns @ turns.transpose(0, 2, 1), np.broadcast_to(np.eye(3), turns.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(turns), 1)
    # A uniform direction has components of mean 0 and variance 1 / 3; 5 standard errors of 4000 draws.
    np.testing.assert_allclose(turns.mean(axis=0), 0, atol=5 * np.sqrt(1 / 3 / 4000))
    np.testing.assert_allclose(turns.var(axis=0), 1 / 3, atol=5 * 0.3 / np.sqrt(4000))
    # The angle of a uniform rotation has the density (1 - cos a) / pi, whose mean is pi / 2 + 2 / pi.
    angles = np.arccos(np.clip((np.trace(turns, axis1=1, axis2=2) - 1) / 2, -1, 1))
    assert angles.mean() == pytest.approx(np.pi / 2 + 2 / np.pi, abs=5 * 0.65 / np.sqrt(4000))


def test_a_reach_starts_and_ends_at_rest_with_the_least_jerk() -> None:
    share = np.linspace(0, 1, 2001)
    way = minimum_jerk(share)
    speed = np.gradient(way, share)
    assert (way[0], way[-1]) == (0, 1)
    assert speed.max() == pytest.approx(1.875, abs=1e-4), "Flash and Hogan: the peak is 1.875 times the mean speed"
    np.testing.assert_allclose(speed[[0, -1]], 0, atol=1e-5)
    np.testing.assert_allclose(way + way[::-1], 1, atol=1e-12)
    np.testing.assert_array_equal(minimum_jerk([-0.5, 1.5]), [0, 1])


def test_a_stretched_mesh_has_the_normals_of_its_surface() -> None:
    ball = bodies()[0]
    turn = random_rotation(np.random.default_rng(2))
    size = np.array([0.01, 0.03, 0.02])
    thing = placed(ball, Material(np.ones((2, 2, 3), np.float32)), (0.1, 0.2, 0.3), size, turn)
    own = (thing.vertices_m - (0.1, 0.2, 0.3)) @ turn / size
    np.testing.assert_allclose(own, ball.vertices, atol=1e-12)
    # The gradient of (x / a)^2 + (y / b)^2 + (z / c)^2.
    gradient = own / size @ turn.T
    gradient /= np.linalg.norm(gradient, axis=1, keepdims=True)
    # Normals of the coarse ball itself lean by up to 4 degrees where its triangles are uneven, near the poles.
    assert np.einsum("vi,vi->v", gradient, thing.normals).min() > np.cos(np.radians(12))
    flat = face_cross(thing.vertices_m, thing.faces)
    assert np.einsum("fi,fi->f", flat, thing.normals[thing.faces].mean(axis=1)).min() > 0
