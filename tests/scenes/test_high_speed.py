"""The high-speed clips: continuous motion inside the depth range, exact motion vectors, black where nothing is."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from scenes.high_speed import Play, draw_play, event_of, high_speed, is_black
from scenes.high_speed.events import EVENTS, MOST_ACTORS, Event
from scenes.layout import far_end
from simulator.render import Renderer, Scene, TriangleMesh
from simulator.types import Clip, View

DEFAULT = View((128, 128), 19.2e-6, 1.9e-3, 0.036, 0.2)
SMALL = View((24, 24), 102.4e-6, 1.9e-3, 0.036, 0.2)
DURATION_S = 0.01


def play(event: Event, seed: int, *, view: View = DEFAULT, black: bool = True) -> Play:
    return draw_play(view, event, black, DURATION_S, np.random.default_rng(seed))


def acting(drawn: Play, frames: int) -> list[np.ndarray]:
    """Return the vertices ``(T, V, 3)`` of everything that is an actor, in frames evenly over the clip."""
    scenes = list(drawn.scenes((np.arange(frames) + 0.5) * DURATION_S / frames))
    slots = [slot for slot, (_, actor) in enumerate(drawn.slots) if actor is not None]
    return [np.stack([mesh(scene, slot + 2).vertices_m for scene in scenes]) for slot in slots]


def mesh(scene: Scene, slot: int) -> TriangleMesh:
    shape = scene.shapes[slot]
    assert isinstance(shape, TriangleMesh)
    return shape


def in_pixels(points: np.ndarray, view: View) -> np.ndarray:
    return points[..., :2] / points[..., 2:] * view.distance_m / view.pixel_pitch_m


@pytest.mark.parametrize("event", EVENTS)
def test_everything_stays_in_the_depth_range_above_the_floor_and_mostly_in_view(event: Event, view: View) -> None:
    for seed in range(2):
        drawn = play(event, seed, view=view, black=seed == 0)
        assert 1 <= len(drawn.actors) <= MOST_ACTORS
        for points in acting(drawn, 8):
            assert view.near_m < points[..., 2].min() < points[..., 2].max() < far_end(view)
            # Figures run on the floor with round soles, which a mesh of 16 checked phases fits to 3 % of its size.
            size = np.ptp(points[0], axis=0).max()
            assert points[..., 1].max() < drawn.room.floor_m + 0.03 * size
            half = np.array(view.shape[::-1]) / 2
            seen = np.all(np.abs(in_pixels(points.mean(axis=1), view)) < 1.15 * half, axis=-1)
            assert seen.mean() >= 0.5


@pytest.mark.parametrize("event", EVENTS)
def test_motion_is_fast_and_nothing_pops(event: Event) -> None:
    """With four times the frames the largest step is close to a quarter; where a thing jumped it would stay."""
    for seed in range(2):
        coarse, fine = (acting(play(event, seed), frames) for frames in (20, 80))
        steps = [
            max(np.linalg.norm(np.diff(in_pixels(points, DEFAULT), axis=0), axis=-1).max() for points in frames)
            for frames in (coarse, fine)
        ]
        # A hit or the beginning of a contact can fall between the coarse frames and make their step smaller.
        assert steps[1] < 0.42 * steps[0]
        assert 1.5 < steps[0] < 0.25 * 128, "pixels per frame of the fastest vertex, of 128"


def test_a_flight_crosses_the_picture_as_far_as_its_speed_says() -> None:
    for seed in range(6):
        drawn = play("translation", seed)
        actor = drawn.actors[0]
        way = actor.centre(DURATION_S) - actor.centre(0.0)
        assert actor.facts["speed_m_s"] == pytest.approx(np.linalg.norm(way) / DURATION_S)
        ends = in_pixels(np.stack([actor.centre(0.0), actor.centre(DURATION_S)]), DEFAULT)
        # The drawn share is 0.45 to 1 of the width; the ends' depths differ by a few percent.
        assert 0.4 * 128 < np.linalg.norm(ends[1] - ends[0]) < 1.1 * 128


def test_balls_fall_with_the_gravity_that_is_told() -> None:
    told = set()
    for seed in range(3):
        for actor in play("bouncing", seed).actors:
            told.add((seed, actor.facts["gravity_m_s2"]))
            times = np.linspace(0, DURATION_S, 200)
            height = np.array([actor.centre(time)[1] for time in times])
            pull = np.diff(height, 2) / (times[1] - times[0]) ** 2
            # Free flight is most of the time, and there the second difference is the acceleration.
            assert np.median(pull) == pytest.approx(actor.facts["gravity_m_s2"], rel=1e-6)
    assert len(told) == 3, "one gravity for all balls of a clip"


def test_a_squashed_ball_touches_the_floor() -> None:
    touched = 0
    for seed in range(4):
        drawn = play("bouncing", seed)
        for points in acting(drawn, 60):
            below = points[..., 1].max(axis=1)
            height = np.ptp(points[..., 1], axis=1)
            squashed = height < 0.8 * height.max()
            # The mesh of a round body lies up to 13 % inside its ball.
            assert below.max() < drawn.room.floor_m + 1e-12
            assert np.all(below[squashed] > drawn.room.floor_m - 0.13 * height.max() / 2)
            touched += squashed.any()
    assert touched >= 3


def test_balls_hit_without_touching_before_and_keep_their_momentum() -> None:
    for seed in range(5):
        actors = play("collision", seed).actors
        radii = np.array([actor.radius_m for actor in actors])
        times = np.linspace(0, DURATION_S, 300)
        places = np.array([[actor.centre(time) for actor in actors] for time in times])
        offsets = np.linalg.norm(places[:, :, np.newaxis] - places[:, np.newaxis], axis=-1)
        pairs = np.triu_indices(len(actors), 1)
        gaps = (offsets - radii - radii[:, np.newaxis])[:, *pairs]
        assert gaps.min() > -1e-12
        assert gaps.min() < 0.03 * radii.max()
        velocities = np.diff(places, axis=0) / (times[1] - times[0])
        momentum = radii**3 @ velocities
        # Nothing pulls sideways: the floor can only push up, and steps that hold an impact mix two velocities evenly.
        for axis in (0, 2):
            np.testing.assert_allclose(momentum[:, axis], momentum[0, axis], atol=1e-9 * np.abs(velocities).max())


def test_the_nearer_thing_hides_the_farther_at_some_time() -> None:
    crossed = 0
    for seed in range(5):
        things = acting(play("occlusion", seed), 10)
        for one, first in enumerate(things):
            for second in things[:one]:
                middle = in_pixels(np.stack([first.mean(axis=1), second.mean(axis=1)]), DEFAULT)
                size = np.ptp(in_pixels(first, DEFAULT), axis=1).max() / 2
                if np.linalg.norm(middle[0] - middle[1], axis=-1).min() < size:
                    crossed += 1
                    break
    assert crossed >= 5


def test_slots_are_the_same_for_every_event_and_background() -> None:
    """Else Dr.Jit compiles new kernels for new clips."""

    def slots(scene: Scene) -> list[object]:
        shapes = [
            (type(shape), shape.material.roughness is None, shape.material.reflectance.shape) for shape in scene.shapes
        ]
        return [*shapes, *map(type, scene.lights), scene.hide_lights]

    found = [
        slots(next(play(event, seed, black=black).scenes(np.array([0.001]))))
        for event in EVENTS
        for seed, black in ((0, True), (1, False))
    ]
    assert all(one == found[0] for one in found)


def test_what_rests_is_the_same_object_in_every_frame() -> None:
    scenes = list(play("bouncing", 2, black=False).scenes(np.array([0.001, 0.002])))
    drawn = play("bouncing", 2, black=False)
    for number, (before, after) in enumerate(zip(scenes[0].shapes, scenes[1].shapes, strict=True)):
        actor = drawn.slots[number - 2][1] if number >= 2 else None
        assert (before is after) == (actor is None or actor.still)
    assert scenes[0].lights is scenes[1].lights


def test_events_and_backgrounds_are_balanced_by_index() -> None:
    drawn = [(event_of("mixed", index), is_black("mixed", index)) for index in range(-28, 28)]
    assert set(Counter(drawn).values()) == {4}
    assert event_of("collision", 3) == "collision"
    assert is_black("black", 9)
    assert not is_black("room", 9)


def clip(event: Event, background: str, *, view: View = SMALL, outputs: tuple[str, ...] = (), frames: int = 3) -> Clip:
    source = high_speed(
        view,
        frames=frames,
        samples_per_pixel=1,
        event=event,
        background=background,
        renderer=Renderer("scalar_rgb", outputs=outputs),
    )
    return source.clip(0, np.random.default_rng(11))


def test_black_is_exactly_black_and_a_room_fills_the_picture() -> None:
    empty = clip("rotation", "black", outputs=("shape_id",))
    missed = ~empty.valid
    assert 0.2 < missed.mean() < 1
    assert np.all(empty.extras["shape_id"][missed] == -1)
    assert np.all(empty.depth_m[missed] == np.float32(SMALL.far_m))
    # A pixel whose centre misses may hold the rim of a thing, but none that is two pixels away from all that is hit.
    away = ~binary_dilation(empty.valid, np.ones((1, 5, 5)))
    assert away.mean() > 0.2
    assert np.all(empty.rgb[away] == 0)
    slots = draw_play(SMALL, "rotation", True, 3 / 2000, np.random.default_rng(11)).slots
    used = {slot + 2 for slot, (_, actor) in enumerate(slots) if actor is not None}
    assert set(np.unique(empty.extras["shape_id"]).tolist()) <= {-1} | used, "what is parked is out of view"
    assert empty.rgb[empty.valid].mean() > 0.05
    full = clip("rotation", "room", outputs=("shape_id",))
    assert full.valid.all()
    assert {0, 1} < set(np.unique(full.extras["shape_id"]).tolist()), "wall, floor and things"
    assert full.depth_m.min() >= SMALL.near_m
    assert full.depth_m.max() <= SMALL.far_m
    assert full.rgb.mean() > 0.1
