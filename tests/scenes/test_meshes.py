"""The mesh library against trimesh, which judges closed surfaces independently."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from scenes.high_speed.bodies import body_library, round_bodies
from scenes.layout import random_rotation
from scenes.meshes import UnitMesh, face_cross, mesh_library, placed
from simulator.render import Material

BODIES = [mesh for mesh in body_library() if not any(mesh is other for other in mesh_library())]


@pytest.mark.parametrize("mesh", [*mesh_library(), *BODIES], ids=lambda mesh: f"{len(mesh.faces)} faces")
def test_a_mesh_is_closed_turned_outwards_and_fills_the_unit_ball(mesh: UnitMesh) -> None:
    surface = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert surface.faces.max() < len(mesh.vertices)
    surface.merge_vertices(merge_tex=True, merge_norm=True)
    assert surface.is_watertight
    assert surface.is_winding_consistent
    assert surface.volume > 0.1
    assert np.linalg.norm(mesh.vertices, axis=1).max() == pytest.approx(1, abs=1e-12)
    np.testing.assert_allclose(mesh.vertices.min(axis=0), -mesh.vertices.max(axis=0), atol=1e-12)
    assert mesh.uv.min() >= 0
    assert mesh.uv.max() <= 1


@pytest.mark.parametrize("mesh", mesh_library(), ids=lambda mesh: f"{len(mesh.faces)} faces")
def test_normals_are_unit_and_point_out_of_their_faces(mesh: UnitMesh) -> None:
    used = np.unique(mesh.faces)
    np.testing.assert_allclose(np.linalg.norm(mesh.normals[used], axis=1), 1, atol=1e-9)
    a, b, c = (mesh.vertices[mesh.faces[:, side]] for side in range(3))
    flat = np.cross(b - a, c - a)
    area = np.linalg.norm(flat, axis=1)
    cosine = np.einsum("fvi,fi->fv", mesh.normals[mesh.faces], flat) / area[:, np.newaxis]
    # Smoothed normals lean away from their faces where a shape is sharply rounded, on a small part of the area.
    leaning = area[np.any(cosine < 0.5, axis=1)].sum() / area.sum()
    assert leaning < 0.08
    # Faces up to 45 degrees apart (around the octagonal tubes) share a normal, which leans by up to 23 degrees from each.
    assert np.average(cosine.mean(axis=1), weights=area) > 0.84


def test_the_library_is_varied_and_cheap() -> None:
    library = mesh_library()
    assert len(library) >= 25
    assert max(len(mesh.faces) for mesh in library) < 1100, "loading a scene takes time by the triangle"
    assert np.mean([len(mesh.faces) for mesh in library]) < 600
    assert mesh_library() is library
    assert max(len(mesh.faces) for mesh in body_library()) <= 700
    for ball in round_bodies():
        assert np.linalg.norm(ball.vertices, axis=1).min() > 0.9 - 1e-6


def test_a_stretched_mesh_has_the_normals_of_its_surface() -> None:
    ball = body_library()[0]
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
