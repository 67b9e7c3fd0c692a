"""Rotations against SciPy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from scenes.layout import random_rotation, rotation


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
