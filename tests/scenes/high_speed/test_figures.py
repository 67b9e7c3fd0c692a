"""Figures of links: rigid bars, inside the unit ball, on joints that stay together."""

from __future__ import annotations

import numpy as np
import pytest

from scenes.high_speed.figures import FIGURES, draw_figure
from scenes.meshes import face_cross
from simulator.render import Material

PHASES = np.linspace(0, 2 * np.pi, 25)
WHITE = Material(np.ones((2, 2, 3), np.float32))


@pytest.mark.parametrize("kind", FIGURES)
def test_links_are_rigid_and_move_smoothly_inside_the_unit_ball(kind: str) -> None:
    for seed in range(3):
        figure = draw_figure(kind, np.random.default_rng(seed))
        joints = np.stack([figure.joints(phase) for phase in PHASES])
        lengths = np.linalg.norm(joints[:, :, 1] - joints[:, :, 0], axis=-1)
        np.testing.assert_allclose(lengths, np.broadcast_to(lengths[0], lengths.shape), rtol=1e-9)
        assert np.ptp(joints, axis=0).max() > 0.1, "it moves"
        meshes = [figure.placed(phase, WHITE, np.zeros(3), 1.0, np.eye(3)) for phase in PHASES]
        points = np.stack([mesh.vertices_m for mesh in meshes])
        assert np.linalg.norm(points, axis=-1).max() <= 1
        assert points[..., 1].max() <= figure.lowest + 0.03
        # Two radii of a link per radian of phase, at 24 steps a turn.
        assert np.linalg.norm(np.diff(points, axis=0), axis=-1).max() < 2 * 2 * np.pi / 24
        assert len(meshes[0].faces) <= 800


@pytest.mark.parametrize("kind", FIGURES)
def test_every_link_is_a_rigid_piece_of_the_mesh_with_outward_normals(kind: str) -> None:
    figure = draw_figure(kind, np.random.default_rng(3))
    first, second = (figure.placed(phase, WHITE, (0, 0, 1.0), 0.5, np.eye(3)) for phase in (0.2, 1.9))
    links = len(figure.joints(0.0))
    for before, after in zip(np.split(first.vertices_m, links), np.split(second.vertices_m, links), strict=True):
        spans = [np.linalg.norm(points[:, np.newaxis] - points, axis=-1) for points in (before, after)]
        np.testing.assert_allclose(*spans, atol=1e-9)
    flat = face_cross(second.vertices_m, second.faces)
    agreement = np.einsum("fi,fi->f", flat, second.normals[second.faces].mean(axis=1))
    assert np.all(agreement > 0)
