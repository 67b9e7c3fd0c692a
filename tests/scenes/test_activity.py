"""The activity family: labels in balance and independent of all else, fixed slots, depths in range, the clip's contract."""

from __future__ import annotations

import dataclasses
import math
import pickle
from collections import Counter
from typing import get_args

import numpy as np
import pytest

from scenes.activity import Action, activity, clip_scenes, draw_parameters
from scenes.activity.actions import ACTIONS
from scenes.activity.tabletop import LIGHTS, draw_viewpoint
from scenes.activity.things import BACKGROUNDS, KINDS, SKINS, skin_tones
from simulator.errors import InputError
from simulator.render import Renderer, Scene, SphereLight, TriangleMesh
from simulator.types import View

DEFAULT = View((128, 128), 19.2e-6, 1.9e-3, 0.036, 0.2)
SMALL = View((24, 24), 102.4e-6, 1.9e-3, 0.036, 0.2)
VIEWS = {
    "default": DEFAULT,
    "wide": View((64, 128), 60e-6, 1.9e-3, 0.01, 0.2),
    "narrow": View((384, 320), 2.4e-6, 1.0e-2, 0.1, 0.5),
    "deep": View((128, 128), 19.2e-6, 1.9e-3, 0.036, 1.0),
    "infinite": View((128, 128), 19.2e-6, 1.9e-3, 0.036, math.inf),
}
SCALAR = Renderer("scalar_rgb")


def test_every_choice_occurs() -> None:
    drawn = [draw_parameters("poking", DEFAULT, np.random.default_rng((7, index))) for index in range(300)]
    assert {p.cast.thing.kind for p in drawn} == set(KINDS)
    assert {p.looks.background for p in drawn} == set(range(len(BACKGROUNDS)))
    assert {p.light for p in drawn} == set(LIGHTS)
    assert {p.looks.skin for p in drawn} == set(range(SKINS))
    assert {p.cast.main.left for p in drawn} == {p.looks.sleeved for p in drawn} == {False, True}
    manners = [p.cast.manner for p in drawn]
    for name in ("both_hands", "joins", "tipped", "lifted", "offered", "from_above", "finger", "slides"):
        assert {getattr(manner, name) for manner in manners} == {False, True}
    assert {manner.idle for manner in manners} == {"away", "rests", "enters"}
    for shares in ([m.apart for m in manners], [m.spilled for m in manners], [p.companion is None for p in drawn]):
        assert 0.2 < np.mean(np.array(shares) == 0) < 0.8


def test_an_action_begins_early_or_late_and_fills_half_of_the_clip_at_least() -> None:
    """And takes 0.9 s or more, in which a hand can do it."""
    casts = [draw_parameters("poking", DEFAULT, np.random.default_rng((1, index))).cast for index in range(300)]
    starts, ends = (np.array([cast.times(share)[0] / cast.duration_s for cast in casts]) for share in (0, 1))
    assert starts.min() < 0.02
    assert starts.max() > 0.35
    assert ends.max() > 0.98
    assert (ends - starts).min() >= 0.9 / (5 / 3) - 1e-9


def test_nothing_but_the_action_depends_on_the_label() -> None:
    """The same generator gives the same clip but for the action: labels are independent of all else."""
    first, *others = (draw_parameters(action, DEFAULT, np.random.default_rng(3)) for action in ACTIONS)
    for other in others:
        assert pickle.dumps(dataclasses.replace(other, action=first.action)) == pickle.dumps(first)
        assert other.action != first.action


def test_labels_are_balanced_in_every_run_of_ten() -> None:
    assert get_args(Action) == ACTIONS
    assert len(set(ACTIONS)) == 10
    source = activity(SMALL, frames=1, samples_per_pixel=1, renderer=SCALAR)
    labels = [source.clip(index, np.random.default_rng(1)).label for index in range(-2, 8)]
    assert Counter(labels) == Counter(ACTIONS)
    assert labels[2:] == list(ACTIONS[:8])
    some = activity(SMALL, frames=1, samples_per_pixel=1, actions=["poking", "holding"], renderer=SCALAR)
    assert some.clip(3, np.random.default_rng(0)).label == "holding"
    with pytest.raises(InputError, match=r"^actions: "):
        activity(SMALL, actions=["poking", "poking"], renderer=SCALAR)


def slots(scene: Scene) -> list[tuple]:
    kinds: list[tuple] = []
    for shape in scene.shapes:
        assert isinstance(shape, TriangleMesh)
        texture = shape.material.reflectance
        kinds.append((shape.material.roughness is None, texture.shape, texture.dtype))
    return kinds + [(type(light).__name__,) for light in scene.lights]


def test_slots_keep_their_kind_whatever_the_action() -> None:
    """Else Dr.Jit compiles new kernels for new scenes."""
    seen = set()
    for number, action in enumerate(ACTIONS):
        scenes = list(clip_scenes(draw_parameters(action, DEFAULT, np.random.default_rng(number)), DEFAULT, 3))
        seen |= {tuple(slots(scene)) for scene in scenes}
        counts = {tuple((len(s.vertices_m), len(s.faces)) for s in meshes(scene)) for scene in scenes}
        assert len(counts) == 1, "a mesh keeps its size within a clip"
        assert all(scene.shapes[0] is scenes[0].shapes[0] for scene in scenes), "the table is one object"
        assert all(
            a.uv is b.uv for scene in scenes for a, b in zip(meshes(scene)[2:7], meshes(scenes[0])[2:7], strict=True)
        )
    assert len(seen) == 1
    assert len(next(iter(seen))) == 8 + 3


def meshes(scene: Scene) -> list[TriangleMesh]:
    return [shape for shape in scene.shapes if isinstance(shape, TriangleMesh)]


def test_a_thing_at_rest_stays_the_same_object() -> None:
    scenes = list(clip_scenes(draw_parameters("picking_up", DEFAULT, np.random.default_rng(0)), DEFAULT, 20))
    assert scenes[0].shapes[5] is scenes[3].shapes[5]
    assert scenes[0].shapes[5] is not scenes[-1].shapes[5]


def test_the_background_alone_is_the_same_whatever_the_action() -> None:
    sources = [
        activity(SMALL, frames=2, samples_per_pixel=1, actions=[action], only_background=True, renderer=SCALAR)
        for action in ACTIONS[:3]
    ]
    clips = [source.clip(0, np.random.default_rng(3)) for source in sources]
    acted = activity(SMALL, frames=2, samples_per_pixel=1, actions=["holding"], renderer=SCALAR).clip(
        0, np.random.default_rng(3)
    )
    assert len({clip.label for clip in clips}) == 3
    assert len({clip.rgb.tobytes() for clip in clips}) == 1
    assert (clips[0].depth_m[0] == clips[0].depth_m[1]).all()
    hidden = acted.depth_m[0] < 0.99 * clips[0].depth_m[0]
    assert 0.02 < hidden.mean() < 0.6, "the hand and the thing are in front of it"
    assert not (acted.depth_m[0] > 1.01 * clips[0].depth_m[0]).any()


@pytest.mark.parametrize("name", VIEWS)
def test_what_is_seen_lies_in_the_depth_range(name: str) -> None:
    """All that is seen of hands and things, by their vertices and the middles of their edges; and the backdrop's planes."""
    view = VIEWS[name]
    limits = np.array([view.tan_half_width, view.tan_half_height])
    for number, action in enumerate(ACTIONS):
        drawn = draw_parameters(action, view, np.random.default_rng(number))
        in_view = []
        for scene in clip_scenes(drawn, view, 4):
            for mesh in meshes(scene)[2:]:
                a, b = mesh.vertices_m[mesh.faces], mesh.vertices_m[np.roll(mesh.faces, 1, axis=1)]
                points = np.concatenate([mesh.vertices_m, ((a + b) / 2).reshape(-1, 3)])
                points = points[points[:, 2] > 0]
                seen = points[(np.abs(points[:, :2] / points[:, 2:]) < limits).all(axis=1)]
                assert seen.size == 0 or (seen[:, 2].min() >= view.near_m and seen[:, 2].max() <= view.far_m)
            centre = np.concatenate([mesh.vertices_m for mesh in meshes(scene)[5:7]]).mean(axis=0)
            in_view.append(bool(np.all(np.abs(centre[:2] / centre[2]) < limits)))
            for light in scene.lights:
                if isinstance(light, SphereLight):
                    assert light.centre_m[2] < light.radius_m, "a lamp would be seen"
        assert np.mean(in_view) >= 0.75, "the thing is in the picture"


def test_table_and_wall_fill_the_picture_in_range() -> None:
    source = activity(SMALL, frames=1, samples_per_pixel=1, renderer=SCALAR)
    for index in range(10):
        clip = source.clip(index, np.random.default_rng(index))
        assert clip.valid.all()
        assert SMALL.near_m <= clip.depth_m.min() < clip.depth_m.max() <= SMALL.far_m


@pytest.mark.parametrize(
    ("near_m", "far_m", "smallest", "largest"),
    [
        (0.036, 1.0, 0.33, 1.0),
        (0.036, math.inf, 0.4, 1.0),
        (0.036, 0.2, 0.13, 0.35),
        # Only sets larger than life fit here: 0.3 m is 8.3 times 0.036 m, where the least is 0.13 to 0.204.
        (0.3, 3.0, 1.08, 1.71),
    ],
)
def test_the_set_is_never_tiny_in_a_deep_range_nor_larger_than_it_has_to_be(
    near_m: float, far_m: float, smallest: float, largest: float
) -> None:
    view = View((128, 128), 19.2e-6, 1.9e-3, near_m, far_m)
    scales = np.array([draw_viewpoint(view, np.random.default_rng(seed)).scale for seed in range(60)])
    assert smallest < scales.min()
    assert scales.max() <= largest
    assert 1.4 < scales.max() / scales.min() < 3


def test_hands_are_as_long_as_the_preset_says() -> None:
    """The view of `activity_64`: "Hands, 10 to 16 cm long"; an adult's of the set's real world has 19 cm."""
    view = View((64, 64), 38.4e-6, 1.9e-3, 0.15, 0.54)
    drawn = [draw_parameters("picking_up", view, np.random.default_rng(seed)) for seed in range(200)]
    lengths_cm = [19 * one.viewpoint.scale * one.looks.hand_size for one in drawn]
    assert 9.5 < min(lengths_cm) < 10.5
    assert 15.5 < max(lengths_cm) < 16.5


def test_short_clips_show_the_whole_action_faster() -> None:
    """In 20 frames at 2000 per second, a thing that is dropped still lands."""
    source = activity(DEFAULT, frames=20, frames_per_second=2000, renderer=SCALAR)
    seconds = max(source.frames / source.frames_per_second, 1.4)
    drawn = draw_parameters("dropping", DEFAULT, np.random.default_rng(0), duration_s=seconds)
    scenes = list(clip_scenes(drawn, DEFAULT, 20))
    assert scenes[-1].shapes[5] is scenes[-2].shapes[5], "at rest"
    assert scenes[-1].shapes[5] is not scenes[0].shapes[5]


def test_a_depth_range_too_thin_is_refused_with_the_one_that_is_needed() -> None:
    with pytest.raises(InputError, match=r"^scene: "):
        activity(View((24, 24), 102.4e-6, 1.9e-3, 0.036, 0.06), renderer=SCALAR)


def test_skin_tones_go_from_light_to_dark_and_are_reddish() -> None:
    tones = skin_tones()
    assert tones.shape == (SKINS, 3)
    brightness = tones @ (0.2126, 0.7152, 0.0722)
    assert brightness[0] < 0.75, "light skin reflects 0.45 to 0.7 of green light"
    assert brightness[-1] > 0.01
    assert np.all(np.diff(brightness[2:]) < 0)
    assert np.all(tones[:, 0] > tones[:, 2])
