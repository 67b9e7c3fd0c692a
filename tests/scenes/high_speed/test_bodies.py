"""Soft bodies: what each map must keep, and normals that belong to the bent form."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from scenes.high_speed.bodies import (
    Bend,
    Soft,
    body_library,
    bowing,
    flapping,
    jelly,
    pulsing,
    rippling,
    round_bodies,
    sheet,
    twisting,
)
from scenes.meshes import UnitMesh, face_cross
from simulator.render import Material

PHASES = np.linspace(0, 2 * np.pi, 17)
BENDS = {
    "pulsing": pulsing(0.5),
    "jelly": jelly(np.eye(3)[:2], 0.3),
    "twisting": twisting(1.2),
    "bowing": bowing(1.5),
    "flapping": flapping(0.3, 1.2, 0.4),
    "rippling": rippling(0.3, 0.8, 0.4),
}
WHITE = Material(np.ones((2, 2, 3), np.float32))


def volume(points: np.ndarray, mesh: UnitMesh) -> float:
    return float(np.einsum("fi,fi->", points[mesh.faces[:, 0]], face_cross(points, mesh.faces)) / 6)


def test_pulsing_keeps_the_volume_and_twisting_the_distance_from_the_axis() -> None:
    ball = round_bodies()[0]
    for phase in PHASES:
        assert volume(pulsing(0.5)(ball.vertices, phase), ball) == pytest.approx(volume(ball.vertices, ball))
        wrung = twisting(1.2)(ball.vertices, phase)
        radius = np.hypot(wrung[:, 0], wrung[:, 2])
        np.testing.assert_allclose(radius, np.hypot(ball.vertices[:, 0], ball.vertices[:, 2]), atol=1e-12)


def test_bowing_turns_the_axis_into_an_arc_of_its_own_length() -> None:
    axis = np.stack([np.zeros(2001), np.linspace(-1, 1, 2001), np.zeros(2001)], axis=1)
    bent = bowing(1.5)(axis, np.pi / 2)
    steps = np.diff(bent, axis=0)
    assert np.linalg.norm(steps, axis=1).sum() == pytest.approx(2, abs=1e-6)
    ends = steps[[0, -1]] / np.linalg.norm(steps[[0, -1]], axis=1, keepdims=True)
    assert np.arccos(ends[0] @ ends[1]) == pytest.approx(1.5, abs=2e-3)


def test_a_flag_stays_on_its_pole_and_flaps_most_at_its_free_edge() -> None:
    cloth = sheet(5, 9, 0.6)
    moves = np.stack([flapping(0.3, 1.2, 0.4)(cloth.vertices, phase) for phase in PHASES])
    swing = np.ptp(moves[..., 2], axis=0).reshape(5, 9)
    np.testing.assert_allclose(moves[:, cloth.vertices[:, 0] == -1], np.broadcast_to(cloth.vertices[::9], (17, 5, 3)))
    assert np.all(np.diff(swing, axis=1) > 0)


@pytest.mark.parametrize("bend", BENDS.values(), ids=BENDS.keys())
def test_motion_is_smooth_and_periodic_and_the_reach_holds(bend: Bend) -> None:
    mesh = body_library()[5]
    there = [bend(mesh.vertices, phase) for phase in np.linspace(0, 2 * np.pi, 257)]
    np.testing.assert_allclose(there[0], there[-1], atol=1e-9)
    steps = [np.linalg.norm(after - before, axis=1).max() for before, after in pairwise(there)]
    assert max(steps) < 3 * 2 * np.pi / 256, "no vertex moves faster than three radii per radian of phase"
    assert max(np.linalg.norm(points, axis=1).max() for points in there) <= Soft(mesh, bend).reach()


def test_normals_belong_to_the_bent_form_and_sharp_edges_stay_sharp() -> None:
    for mesh in (round_bodies()[0], next(mesh for mesh in body_library() if len(mesh.vertices) == 3 * len(mesh.faces))):
        bent = Soft(mesh, bowing(1.5)).placed(1.0, WHITE, np.zeros(3), 1.0, np.eye(3))
        flat = face_cross(bent.vertices_m, bent.faces)
        flat /= np.linalg.norm(flat, axis=1, keepdims=True)
        np.testing.assert_allclose(np.linalg.norm(bent.normals, axis=1), 1, atol=1e-12)
        agreement = np.einsum("fi,fci->fc", flat, bent.normals[bent.faces])
        assert agreement.min() > (0.9 if len(mesh.vertices) != 3 * len(mesh.faces) else 1 - 1e-9)
