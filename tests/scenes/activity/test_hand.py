"""The hand: bones keep their lengths, grips have the width that is asked for, the surface is closed and follows the bones."""

from __future__ import annotations

import math

import numpy as np
import pytest

from scenes.activity.hand import (
    OPEN,
    PAD_M,
    POINTING,
    RELAXED,
    HandLook,
    between,
    grip,
    hand_surface,
    pose_bones,
    posed_hand,
    surface_nets,
    widest_grip_m,
)
from scenes.layout import random_rotation
from scenes.meshes import unit
from simulator.render import Material

LOOK = HandLook(Material(np.full((4, 4, 3), 0.5, np.float32)))
POSES = {"open": OPEN, "relaxed": RELAXED, "pointing": POINTING, "pinch": grip(0.0).angles_rad}
POSES |= {"grip": grip(0.06).angles_rad}


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    a, b, c = (vertices[faces[:, side]] for side in range(3))
    return float(np.einsum("fi,fi->", a, np.cross(b, c))) / 6


@pytest.mark.parametrize("angles", POSES.values(), ids=POSES.keys())
def test_bones_keep_their_lengths_and_stay_joined(angles: np.ndarray) -> None:
    rest, posed = pose_bones(np.zeros((5, 4))), pose_bones(angles, unit(np.array([-1.0, 0.4, -0.6])))
    np.testing.assert_allclose(
        np.linalg.norm(posed.ends_m - posed.starts_m, axis=1), np.linalg.norm(rest.ends_m - rest.starts_m, axis=1)
    )
    for finger in range(5):
        first = 2 + 3 * finger
        np.testing.assert_allclose(posed.starts_m[first], rest.starts_m[first])
        np.testing.assert_allclose(posed.ends_m[first : first + 2], posed.starts_m[first + 1 : first + 3])
    turns = posed.turns
    np.testing.assert_allclose(turns @ turns.transpose(0, 2, 1), np.tile(np.eye(3), (17, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(turns), 1)


def test_hands_have_human_sizes() -> None:
    rest = pose_bones(np.zeros((5, 4)))
    # Wrist to middle fingertip 170 to 205 mm in adults; the index finger is shorter than the middle one.
    assert 0.17 < np.linalg.norm(rest.tip_m(2)) + PAD_M[2] < 0.205
    tips = [np.linalg.norm(rest.tip_m(finger)) for finger in range(5)]
    assert max(tips) == tips[2]
    assert min(tips) == tips[0]


def test_a_pointing_hand_stretches_only_its_index_finger() -> None:
    bones = pose_bones(POINTING)
    reach = [bones.tip_m(finger)[0] for finger in range(5)]
    assert reach[1] > 0.17
    assert all(reach[finger] < 0.13 for finger in (0, 2, 3, 4))


def test_flexed_fingers_go_to_the_palm_side() -> None:
    for finger in range(1, 5):
        assert pose_bones(RELAXED).tip_m(finger)[2] < pose_bones(OPEN).tip_m(finger)[2] - 0.01


@pytest.mark.parametrize("width_m", [0.02, 0.05, 0.08])
def test_a_grip_is_as_wide_as_what_it_holds(width_m: float) -> None:
    held = grip(width_m)
    bones = pose_bones(held.angles_rad)
    thumb, fingers = bones.pad_m(0), np.mean([bones.pad_m(finger) for finger in (1, 2, 3)], axis=0)
    # The widths are tabulated at 41 points: half a millimetre.
    assert np.linalg.norm(fingers - thumb) == pytest.approx(width_m, abs=5e-4)
    np.testing.assert_allclose(held.centre_m, (thumb + fingers) / 2)
    assert held.axis @ held.approach == pytest.approx(0, abs=1e-12)
    assert held.approach[0] > 0.2, "things are held before the palm: forwards"
    assert held.approach[2] < -0.2, "and on its side"
    assert widest_grip_m() > 0.1


def test_smallest_rotation_between_directions() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        start, end = unit(rng.standard_normal((2, 3)))
        turn = between(start, end)
        np.testing.assert_allclose(turn @ start, end, atol=1e-12)
        assert math.acos((np.trace(turn) - 1) / 2) == pytest.approx(math.acos(start @ end))
    np.testing.assert_allclose(
        between(np.array([0.0, 0, 1]), np.array([0.0, 0, -1])) @ [0, 0, 1], [0, 0, -1], atol=1e-9
    )


def test_surface_nets_of_a_ball_have_its_volume() -> None:
    axis = np.linspace(-1.2, 1.2, 33)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    vertices, faces = surface_nets((axis, axis, axis), np.linalg.norm(grid, axis=1) - 1)
    # The mesh lies within the ball by about step^2 / 8: 0.7 % of the radius at each chord, so some 2 % of the volume.
    assert volume(vertices, faces) == pytest.approx(4 / 3 * math.pi, rel=0.02)
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    assert np.all(np.unique(edges, axis=0, return_counts=True)[1] == 2), "closed"


def test_the_rest_surface_is_closed_and_near_the_bones() -> None:
    surface = hand_surface()
    faces = surface.mesh.faces
    assert len(faces) < 3500
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    assert np.all(np.unique(edges, axis=0, return_counts=True)[1] % 2 == 0)
    np.testing.assert_allclose(surface.weights.sum(axis=1), 1)
    np.testing.assert_allclose(np.linalg.norm(surface.mesh.normals, axis=1), 1)
    # A hand displaces 300 to 450 ml; with the forearm's 0.55 m of 35 to 45 mm radius it is some 2 to 3 litres.
    assert 1.5e-3 < volume(surface.mesh.vertices, faces) < 3.5e-3
    rest = pose_bones(np.zeros((5, 4)))
    for finger in range(5):
        gap = np.linalg.norm(surface.mesh.vertices - rest.tip_m(finger), axis=1).min()
        assert gap < 2 * PAD_M[finger]


@pytest.mark.parametrize("angles", POSES.values(), ids=POSES.keys())
def test_the_skin_follows_the_bones(angles: np.ndarray) -> None:
    bones = pose_bones(angles, unit(np.array([-1.0, 0.2, -0.3])))
    mesh = posed_hand(LOOK, bones, np.eye(3), np.zeros(3))
    for finger in range(5):
        gap = np.linalg.norm(mesh.vertices_m - bones.tip_m(finger), axis=1).min()
        assert gap < 2 * PAD_M[finger]
    # Blended rotations thin out joints a little.
    rest = hand_surface().mesh
    assert volume(mesh.vertices_m, mesh.faces) == pytest.approx(volume(rest.vertices, rest.faces), rel=0.06)


def test_hands_are_placed_scaled_and_mirrored() -> None:
    bones = pose_bones(RELAXED)
    frame, wrist = random_rotation(np.random.default_rng(1)), np.array([0.1, -0.2, 0.3])
    right = posed_hand(LOOK, bones, np.eye(3), np.zeros(3))
    big = posed_hand(HandLook(LOOK.material, size=1.1), bones, frame, wrist)
    np.testing.assert_allclose((big.vertices_m - wrist) @ frame / 1.1, right.vertices_m, atol=1e-12)
    left = posed_hand(HandLook(LOOK.material, left=True), bones, np.diag([1.0, -1, 1]), np.zeros(3))
    np.testing.assert_allclose(left.vertices_m * (1, -1, 1), right.vertices_m)
    assert volume(left.vertices_m, left.faces) == pytest.approx(volume(right.vertices_m, right.faces))
    sleeved = posed_hand(HandLook(LOOK.material, sleeve_m=0.005), bones, np.eye(3), np.zeros(3))
    moved = np.linalg.norm(sleeved.vertices_m - right.vertices_m, axis=1)
    assert moved[right.vertices_m[:, 0] < -0.06].min() == pytest.approx(0.005)
    assert moved[right.vertices_m[:, 0] > -0.04].max() == 0
