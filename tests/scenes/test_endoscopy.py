"""Endoscopy: depths in range, lamps that follow the stated formula, clips that keep the contract, a real colon."""

from __future__ import annotations

import dataclasses
import json
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from scenes.endoscopy import Endoscopy, check_view, draw_scenes, draw_shot, endoscopy
from scenes.endoscopy.endoscope import CLEARANCE_M, direct_light, draw_lamps, draw_poses, pressed
from scenes.endoscopy.organs import ORGANS
from scenes.endoscopy.segmented import course_of, find_shot, read_segment
from simulator.errors import InputError
from simulator.render import Renderer, TriangleMesh
from simulator.types import View

SMALL = View((24, 24), 102.4e-6, 1.9e-3, 0.005, 0.10)
VIEWS = {
    "default": SMALL,
    "wide": View((24, 32), 200e-6, 1.9e-3, 0.002, 0.10),
    "narrow": View((32, 24), 40e-6, 4e-3, 0.01, 0.08),
    "shallow": View((24, 24), 102.4e-6, 1.9e-3, 0.005, 0.07),
}
STILL = np.zeros(1)
SCALAR = Renderer("scalar_rgb")


def quick(scene: Any, view: View, renderer: Renderer = SCALAR, samples: int = 1) -> Any:
    return renderer.still(scene, view, samples_per_pixel=samples, seed=1, source={})


@pytest.mark.parametrize("view", VIEWS.values(), ids=VIEWS.keys())
@pytest.mark.parametrize("organ", ORGANS)
def test_all_that_is_seen_lies_within_the_depth_range(view: View, organ: str) -> None:
    for seed in range(2):
        rng = np.random.default_rng(seed)
        wall, poses = draw_shot(view, organ, STILL, STILL, rng)
        clip = quick(draw_scenes(view, organ, wall, poses, rng)[0], view)
        assert clip.valid.all(), "a wall in every direction"
        assert clip.depth_m.min() >= view.near_m
        assert clip.depth_m.max() <= view.far_m


@pytest.mark.parametrize("organ", ORGANS)
def test_the_wall_keeps_clear_of_camera_and_lamps(organ: str) -> None:
    for seed in range(12):
        wall, poses = draw_shot(SMALL, organ, STILL, STILL, np.random.default_rng(seed))
        away = np.linalg.norm(poses[0].seen(wall.vertices_m), axis=1)
        assert away.min() >= CLEARANCE_M
        np.testing.assert_allclose(poses[0].axes @ poses[0].axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(poses[0].axes) == pytest.approx(1)
        lamps = draw_lamps(np.random.default_rng(seed))
        for lamp in lamps:
            assert lamp.centre_m[2] + lamp.radius_m <= 1e-12, "never in view, however wide"
            assert np.linalg.norm(lamp.centre_m) + lamp.radius_m < CLEARANCE_M
        assert sum(float(lamp.radiance.mean()) * lamp.radius_m**2 for lamp in lamps) == pytest.approx(1)


def test_lamp_light_falls_with_the_square_of_the_distance() -> None:
    lamps = draw_lamps(np.random.default_rng(0))
    facing = np.array([(0.0, 0, -1)])
    near, far = (float(direct_light(lamps, np.array([(0.0, 0, z)]), facing)[0]) for z in (0.1, 0.2))
    assert near * 0.1**2 == pytest.approx(1, rel=0.02)  # lamps 4 mm aside and 1 mm behind
    assert near / far == pytest.approx(4, rel=0.02)


def test_direct_light_is_what_mitsuba_finds_on_a_matt_wall() -> None:
    """The exposure that is promised: with one bounce and no gloss, the rendered mean is the drawn one."""
    ratios = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        wall, poses = draw_shot(SMALL, "colon", STILL, STILL, rng)
        scene = draw_scenes(SMALL, "colon", wall, poses, rng)[0]
        mesh = scene.shapes[0]
        assert isinstance(mesh, TriangleMesh)
        matt = dataclasses.replace(
            scene, shapes=(dataclasses.replace(mesh, material=dataclasses.replace(mesh.material, roughness=None)),)
        )
        rendered = quick(matt, SMALL, Renderer("scalar_rgb", max_depth=2), samples=4).rgb.mean()
        assert 0.5 * 0.12 < rendered < 1.5 * 0.26
        ratios.append(rendered)
    # 81 rays for a whole picture, no shadows, a mean albedo for the wall's own: 20 % each, 10 % on average.
    assert 0.9 * 0.12 < np.mean(ratios) < 1.1 * 0.26


def test_the_lumen_is_dark_and_the_wall_bright() -> None:
    darker = 0
    for seed in range(4):
        rng = np.random.default_rng(seed)
        clip = quick(
            draw_scenes(SMALL, "small_intestine", *draw_shot(SMALL, "small_intestine", STILL, STILL, rng), rng)[0],
            SMALL,
            samples=16,
        )
        grey, depth = clip.rgb[0].mean(axis=-1), clip.depth_m[0]
        near, far = depth < np.percentile(depth, 20), depth > np.percentile(depth, 90)
        darker += int(np.median(grey[far]) < 0.4 * np.median(grey[near]))
    assert darker >= 3


def test_mixed_organs_take_turns() -> None:
    source = endoscopy(SMALL, samples_per_pixel=1, renderer=SCALAR)
    clips = [source.clip(index, np.random.default_rng(index)) for index in range(3)]
    assert [clip.label for clip in clips] == ["colon", "small_intestine", "stomach"]
    for clip in clips:
        assert 0.08 < clip.rgb.mean() < 0.8, "well exposed"
        assert clip.source["organ"] == clip.label
    assert endoscopy(SMALL, organ="stomach", renderer=SCALAR).clip(0, np.random.default_rng(0)).label == "stomach"


@pytest.mark.parametrize("speed", [40.0, -40.0])
def test_a_moving_camera_sees_a_rigid_organ(speed: float) -> None:
    seconds = np.arange(5) / 20
    rng = np.random.default_rng(2)
    wall, poses = draw_shot(SMALL, "colon", 1e-3 * speed * seconds, seconds, rng)
    scenes = draw_scenes(SMALL, "colon", wall, poses, rng)
    path = np.array([pose.position_m for pose in poses])
    # Along a bent centreline, beside its middle: a little more or less than the speed along it.
    np.testing.assert_allclose(np.linalg.norm(np.diff(path, axis=0), axis=1), 2e-3, rtol=0.35)
    towards = np.sign(((path[1] - path[0]) * poses[0].axes[2]).sum())
    assert towards == np.sign(speed)
    meshes = [scene.shapes[0] for scene in scenes]
    first = meshes[0]
    assert isinstance(first, TriangleMesh)
    some = np.random.default_rng(0).integers(0, len(first.vertices_m), (200, 2))
    apart = np.linalg.norm(first.vertices_m[some[:, 0]] - first.vertices_m[some[:, 1]], axis=1)
    for mesh in meshes[1:]:
        assert isinstance(mesh, TriangleMesh)
        assert mesh.material is first.material
        assert mesh.faces is first.faces
        np.testing.assert_allclose(
            np.linalg.norm(mesh.vertices_m[some[:, 0]] - mesh.vertices_m[some[:, 1]], axis=1), apart, atol=1e-12
        )
        assert mesh.vertices_m[:, 2].max() <= SMALL.far_m
    assert scenes[1].lights is scenes[0].lights


def test_views_that_cannot_hold_an_organ_are_refused_with_the_key_to_change() -> None:
    with pytest.raises(InputError, match=r"^scene\.near_cm: "):
        endoscopy(dataclasses.replace(SMALL, near_m=0.036), renderer=SCALAR)
    with pytest.raises(InputError, match=r"^scene\.far_cm: "):
        endoscopy(dataclasses.replace(SMALL, far_m=0.04), renderer=SCALAR)
    for view in VIEWS.values():
        check_view(view, tuple(ORGANS))
    check_view(dataclasses.replace(SMALL, far_m=np.inf), tuple(ORGANS))


def test_contradictory_parameters_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"^advance_mm_per_s: "):
        endoscopy(SMALL, frames=100, frames_per_second=30, renderer=SCALAR)
    with pytest.raises(InputError, match=r"^surface and path: "):
        endoscopy(SMALL, organ="colon", surface=tmp_path / "a.vtk", renderer=SCALAR)
    with pytest.raises(InputError, match=r"^organ: "):
        endoscopy(SMALL, surface=tmp_path / "a.vtk", path=tmp_path / "p.json", renderer=SCALAR)
    with pytest.raises(InputError, match=r"^surface: "):
        endoscopy(SMALL, organ="colon", surface=tmp_path / "a.vtk", path=tmp_path / "p.json", renderer=SCALAR)


def tube(folder: Path, length: float = 200.0, radius: float = 15.0) -> tuple[Path, Path]:
    """A straight tube along x in millimetres, with its outside turned out, and its axis."""
    mesh = trimesh.creation.cylinder(radius, length, sections=64).subdivide().subdivide().subdivide()
    mesh.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0]))
    mesh.export(folder / "tube.ply")
    line = np.column_stack([np.linspace(-length / 2, length / 2, 101), np.zeros((101, 2))])
    (folder / "line.json").write_text(json.dumps({"n": 101, "points": line.tolist()}))
    return folder / "tube.ply", folder / "line.json"


def test_a_segmented_tube_is_seen_from_its_axis(tmp_path: Path) -> None:
    surface, path = tube(tmp_path)
    source = endoscopy(SMALL, organ="colon", surface=surface, path=path, samples_per_pixel=1, renderer=SCALAR)
    assert source.inputs == (surface, path)
    segment = source.segment()
    assert segment is not None
    assert segment is pickle.loads(pickle.dumps(source)).segment()
    np.testing.assert_allclose(np.linalg.norm(segment.wall.vertices_m[:, 1:], axis=1).max(), 0.015, rtol=1e-6)
    side = np.abs(segment.wall.vertices_m[:, 0]) < 0.09
    inwards = -segment.wall.vertices_m[side, 1:] / np.linalg.norm(
        segment.wall.vertices_m[side, 1:], axis=1, keepdims=True
    )
    assert np.min((segment.wall.normals[side, 1:] * inwards).sum(axis=1)) > 0.95
    clip = source.clip(0, np.random.default_rng(0))
    assert clip.label == "colon"
    assert clip.depth_m[clip.valid].max() <= SMALL.far_m
    assert source.clip(0, np.random.default_rng(0)).rgb.tobytes() == clip.rgb.tobytes()


def test_a_path_elsewhere_or_broken_is_refused(tmp_path: Path) -> None:
    surface, path = tube(tmp_path)
    far_away = tmp_path / "away.json"
    far_away.write_text(json.dumps({"points": [[0, 900, 0], [100, 900, 0]]}))
    with pytest.raises(InputError, match=r"^path: "):
        endoscopy(SMALL, organ="colon", surface=surface, path=far_away, renderer=SCALAR)
    for text in ("{", '{"line": []}', "[1]"):
        far_away.write_text(text)
        with pytest.raises(InputError, match=r"^path: "):
            endoscopy(SMALL, organ="colon", surface=surface, path=far_away, renderer=SCALAR)
    far_away.write_text('{"points": [[1, 2], [3, 4]]}')
    with pytest.raises(InputError, match=r"^path: "):
        endoscopy(SMALL, organ="colon", surface=surface, path=far_away, renderer=SCALAR)
    open_tube = trimesh.load(surface, force="mesh", process=False)
    assert isinstance(open_tube, trimesh.Trimesh)
    open_tube.update_faces(np.abs(open_tube.face_normals[:, 0]) < 0.5)
    open_tube.export(surface)
    source = endoscopy(SMALL, organ="colon", surface=surface, path=path, renderer=SCALAR)
    with pytest.raises(InputError, match=r"^surface: "):
        source.clip(0, np.random.default_rng(0))


def test_a_path_becomes_an_evenly_stepped_course_without_twist() -> None:
    angle = np.linspace(0, 2, 300)
    course = course_of(0.08 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1))
    inner = course.points_m[15:-15]
    np.testing.assert_allclose(np.linalg.norm(inner, axis=1), 0.08, rtol=3e-3)  # smoothing cuts corners
    ups = np.abs(course.frames @ np.array([0.0, 0, 1]))
    np.testing.assert_allclose(ups.max(axis=1), 1, atol=1e-3)  # one vector across stays upright in a plane curve


def test_what_is_beyond_far_is_pulled_to_it_along_the_line_of_sight() -> None:
    points = np.array([(0.01, 0.02, 0.05), (0.1, 0.0, 0.2), (0.0, 0.0, -0.1)])
    moved = pressed(SMALL, points)
    np.testing.assert_array_equal(moved[[0, 2]], points[[0, 2]])
    np.testing.assert_allclose(moved[1], np.array((0.5, 0, 1)) * 0.099)


def test_poses_without_freedom_look_along_the_centreline_from_its_middle() -> None:
    course = course_of(np.array([(0.0, 0, 0), (0, 0, 0.1)]))
    pose = draw_poses(course, np.array([0.02]), STILL, 0.005, 0.3, 0.0, np.random.default_rng(0))[0]
    np.testing.assert_allclose(pose.axes[2], (0, 0, 1), atol=1e-9)
    np.testing.assert_allclose(pose.position_m[:2], 0, atol=1e-9)


@pytest.mark.shared
def test_the_real_colon_renders_at_the_depths_of_an_independent_ray_caster(
    shared_data: Path, cast_rays: Callable[..., Any]
) -> None:
    folder = shared_data / "colon_mesh/EdinGCA_3D_00020"
    files = folder / "SegmentedSurfaces/large-intestine-A-DSJ.vtk", folder / "Paths/large_intestine_path.jsn"
    voxel = (0.808594, 0.808594, 0.7)
    view = View((7, 7), 350e-6, 1.9e-3, 0.005, 0.12)
    source = endoscopy(
        view, organ="colon", surface=files[0], path=files[1], voxel_size_mm=voxel, samples_per_pixel=1, renderer=SCALAR
    )
    assert isinstance(source, Endoscopy)
    segment = read_segment(*files, voxel)
    wall, poses = find_shot(view, segment, STILL, STILL, np.random.default_rng(5))
    clip = source.clip(0, np.random.default_rng(5))
    x, y = np.meshgrid(*[(np.arange(7) - 3) * 350e-6 / 1.9e-3] * 2)
    # The whole surface, not what was cut out for rendering.
    whole = segment.wall
    depth, _ = cast_rays(
        poses[0].seen(whole.vertices_m), whole.faces, np.column_stack([x.ravel(), y.ravel(), np.ones(49)])
    )
    assert np.isfinite(depth).all()
    assert len(wall.faces) < len(whole.faces)
    np.testing.assert_allclose(clip.depth_m.ravel(), depth, rtol=1e-4)
