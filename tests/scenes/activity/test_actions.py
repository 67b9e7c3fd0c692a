"""What the ten actions do, measured on the course of the hand and the thing, without rendering."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import pytest

from scenes.activity import draw_parameters
from scenes.activity.actions import ACTIONS, Course, Moment, course
from scenes.activity.cast import Cast
from scenes.activity.grains import GRAINS
from scenes.activity.hand import PAD_M, HandLook, pose_bones
from scenes.activity.holds import GRAVITY_M_S2, HandState, Pose, bounce_height, keyed
from scenes.activity.things import KINDS, draw_thing, grains_mesh
from simulator.render import Material
from simulator.types import View

VIEW = View((128, 128), 19.2e-6, 1.9e-3, 0.036, 0.2)
SEEDS = (2, 3, 4)  # a right hand from above, with both hands; left hands from the side, alone
LOOK = HandLook(Material(np.full((4, 4, 3), 0.5, np.float32)))


def acted(action: str, seed: int, **manner: Any) -> tuple[Cast, Course, np.ndarray]:
    """Draw a cast, with a manner that differs from the one drawn as told, and let it act."""
    cast = draw_parameters(action, VIEW, np.random.default_rng(seed)).cast
    cast = dataclasses.replace(cast, manner=dataclasses.replace(cast.manner, **manner))
    return cast, course(action, cast), np.linspace(0, cast.duration_s, 61)


UPRIGHT = {"both_hands": False, "tipped": False, "offered": False}


def feet(at: Course, times: np.ndarray, half: int = 0) -> np.ndarray:
    return np.array([at(time).halves[half].place_m for time in times])


def tilt_deg(pose: Pose) -> float:
    return math.degrees(math.acos(float(np.clip(pose.turn[1, 1], -1, 1))))


def lowest(cast: Cast, moment: Moment) -> float:
    """Height above the table of the thing's lowest point, metres."""
    halves = zip(cast.thing.halves, moment.halves, strict=True)
    return -max(float((mesh.vertices @ pose.turn.T + pose.place_m)[:, 1].max()) for mesh, pose in halves)


def pads_m(cast: Cast, state: HandState) -> tuple[np.ndarray, np.ndarray]:
    bones = pose_bones(state.angles_rad)
    fingers = np.mean([bones.pad_m(finger) for finger in (1, 2, 3)], axis=0)
    thumb, fingers = (state.wrist_m + cast.main.size * state.frame @ pad for pad in (bones.pad_m(0), fingers))
    return thumb, fingers


@pytest.mark.parametrize("action", ACTIONS)
def test_nothing_goes_into_the_table_or_jumps(action: str) -> None:
    for seed in SEEDS:
        cast, at, times = acted(action, seed)
        moments = [at(time) for time in times]
        assert min(lowest(cast, moment) for moment in moments) > -1e-9, "a thing stands on the table, not in it"
        hand = moments[30].hand
        assert hand.mesh(LOOK).vertices_m[:, 1].max() < 0
        # Not only because skin is pressed flat on the table: hands that poke, tear or rest reach 4 cm into it at most.
        skin = hand.unpressed(LOOK).vertices_m
        assert skin[np.linalg.norm(skin - hand.wrist_m, axis=1) < 0.2, 1].max() < 0.04
        # 28 ms between moments: falling things reach 2 m/s, hands 2 m/s (a fast reach of 0.3 m in 0.3 s).
        for half in (0, 1):
            places = np.array([moment.halves[half].place_m for moment in moments])
            assert np.linalg.norm(np.diff(places, axis=0), axis=1).max() < 0.06
        for hands in ([moment.hand for moment in moments], [moment.second for moment in moments if moment.second]):
            wrists = np.array([hand.wrist_m for hand in hands]).reshape(-1, 3)
            assert np.linalg.norm(np.diff(wrists, axis=0), axis=1).max(initial=0) < 0.06


@pytest.mark.slow
@pytest.mark.parametrize("action", ["picking_up", "putting_down", "poking"])
def test_the_hand_does_not_jump_when_it_closes_or_touches(action: str) -> None:
    """In steps of 2 ms the speed changes steadily: a jump of x would show as a second difference of x.

    The quickest reach is 0.3 m in 0.34 of 0.9 s, and accelerates by at most 5.8 D / T^2 = 19 m/s^2 (minimum jerk); as the
    hand opens for the grip its wrist draws back by up to 0.1 m, 6 m/s^2, while it goes at up to 1.9 m/s, which its turning
    bends, by as much again; the tremor adds 1.8 mm * 0.25 * (2 pi 9.2 Hz)^2 = 1.5 m/s^2: 45.5 m/s^2 in all, 0.182 mm.
    """
    for seed in SEEDS:
        cast, at, _ = acted(action, seed)
        wrists = np.array([at(time).hand.wrist_m for time in np.arange(0, cast.duration_s, 2e-3)])
        assert np.abs(np.diff(wrists, 2, axis=0)).max() < 1.9e-4


def test_grains_are_poured_in_the_second_half_and_on_the_viewers_side_of_the_hand() -> None:
    for seed in range(6):
        cast, at, times = acted("pouring", seed, spilled=0.0)
        first = next(time for time in times if at(time).grains_m is not None)
        begin, end = cast.times(0, 1)
        assert 0.45 < (first - begin) / (end - begin) < 0.65
        moment = at(times[-1])
        assert moment.grains_m is not None
        thumb, fingers = pads_m(cast, moment.hand)
        grains = np.nanmean(moment.grains_m, axis=0)
        assert (grains - (thumb + fingers) / 2)[2] < 0, "nearer than the grip"


@pytest.mark.parametrize(("action", "sign"), [("moving_right_to_left", -1), ("moving_left_to_right", 1)])
def test_moving_crosses_the_picture_in_its_direction(action: str, sign: int) -> None:
    for seed in range(8):
        drawn = draw_parameters(action, VIEW, np.random.default_rng(seed))
        _, at, times = acted(action, seed)
        seen = drawn.viewpoint.to_world(feet(at, times))
        across = sign * seen[:, 0] / seen[:, 2] / VIEW.tan_half_width
        assert across[-1] - across[0] > 0.4, "a fifth of the picture's width at least"
        assert np.diff(across).min() > -0.01, "in one go"


@pytest.mark.slow
@pytest.mark.parametrize("both_hands", [False, True])
def test_dropped_things_fall_freely_and_come_to_rest(both_hands: bool) -> None:
    for seed in range(3):
        cast, at, _ = acted("dropping", seed, both_hands=both_hands)
        times = np.arange(0, cast.duration_s, 4e-3)
        heights = -feet(at, times)[:, 1]
        start = int(np.argmax(heights < heights[0] - 0.02))
        falling = heights[start : start + 8]  # 32 ms: from 2 cm, which take 64 ms, it falls by another 3 cm
        acceleration = np.polyfit(times[start : start + 8], falling, 2)[0] * 2
        assert acceleration == pytest.approx(-GRAVITY_M_S2, rel=1e-6)
        assert heights[: start - 20].min() > 0.045, "held before"
        assert heights[-1] == 0, "at rest on the table"
        np.testing.assert_allclose(feet(at, times, 0), feet(at, times, 1), atol=1e-12)
        aperture = [float(np.linalg.norm(np.subtract(*pads_m(cast, at(time).hand)))) for time in times[[0, -1]]]
        assert aperture[1] > aperture[0] + 0.01, "the hand is open"


@pytest.mark.slow
@pytest.mark.parametrize("joins", [False, True])
def test_both_hands_let_go_outwards_without_a_jerk(joins: bool) -> None:
    for seed in SEEDS:
        cast, at, _ = acted("dropping", seed, both_hands=True, joins=joins)
        times = np.arange(0, cast.duration_s, 2e-3)
        moments = [at(time) for time in times]
        second = [moment.second for moment in moments if moment.second is not None]
        assert len(second) == len(times)
        for side, hands in ((cast.main.side, [moment.hand for moment in moments]), (cast.second.side, second)):
            wrists = np.array([hand.wrist_m for hand in hands])
            # 0.2 m in 0.5 s accelerate by 4.6 m/s^2 (minimum jerk); as the hand opens the wrist draws back by some 2 cm in
            # 0.1 s, 12 m/s^2; the tremor adds 1.5 m/s^2: 0.072 mm.
            assert np.abs(np.diff(wrists, 2, axis=0)).max() < 7.2e-5
            moved = side * (wrists[-1] - wrists[0])[0]
            aperture = [float(np.linalg.norm(np.subtract(*pads_m(cast, hand)))) for hand in (hands[0], hands[-1])]
            if joins and side == cast.second.side:
                assert moved == pytest.approx(0, abs=4e-3), "who would join does not come"
                continue
            assert moved > 0.15
            assert aperture[1] > aperture[0] + 0.01


def test_bounces_lose_height() -> None:
    times = np.linspace(0, 2, 4001)
    heights = np.array([bounce_height(0.1, time, 0.4) for time in times])
    fall = math.sqrt(0.2 / GRAVITY_M_S2)
    assert heights[0] == 0.1
    assert heights[times > fall].max() == pytest.approx(0.1 * 0.4**2, rel=1e-3)
    assert heights.min() >= -1e-12
    assert heights[-1] == 0


def test_picking_up_starts_on_the_table_and_ends_aloft_in_the_hand() -> None:
    for seed in SEEDS:
        cast, at, times = acted("picking_up", seed)
        heights = -feet(at, times)[:, 1]
        assert np.all(heights[times < cast.times(0.44)[0]] == 0)
        assert heights[-1] > 0.04
        assert_gripped(cast, at, times[-1])
        came = at(times[0]).hand.wrist_m - at(cast.times(0.34)[0]).hand.wrist_m
        if cast.manner.from_above:
            assert came[1] < -0.05, "down onto it"
        else:
            assert np.linalg.norm(came[[0, 2]]) > 0.1, "from its side"


def test_putting_down_ends_at_rest_on_the_table() -> None:
    for seed in SEEDS:
        cast, at, times = acted("putting_down", seed)
        heights = -feet(at, times)[:, 1]
        assert heights[0] > 0.04
        assert_gripped(cast, at, times[0])
        (down,) = cast.times(0.56)
        assert np.all(heights[times > down] == 0)
        assert np.ptp(feet(at, times[times > down]), axis=0).max() == 0
        assert np.linalg.norm(at(times[-1]).hand.wrist_m - at(down).hand.wrist_m) > 0.05, "the hand leaves"


def test_putting_down_is_picking_up_backwards() -> None:
    """So no still tells one from the other: hand and thing are the same, but for the tremor."""
    cast, *_ = acted("picking_up", 0)
    cast = dataclasses.replace(cast, tremor_m=0.0)
    mirrored = dataclasses.replace(cast, margins=cast.margins[::-1])
    forwards, backwards = course("picking_up", cast), course("putting_down", mirrored)
    for share in np.linspace(0, 1, 41):
        one, other = forwards(cast.duration_s * share), backwards(cast.duration_s * (1 - share))
        np.testing.assert_allclose(one.hand.wrist_m, other.hand.wrist_m, atol=1e-9)
        np.testing.assert_allclose(one.hand.angles_rad, other.hand.angles_rad, atol=1e-9)
        np.testing.assert_allclose(one.halves[0].place_m, other.halves[0].place_m, atol=1e-9)


def assert_gripped(cast: Cast, at: Course, time_s: float) -> None:
    """The thing's axis runs between thumb and fingers, which are its width apart."""
    moment = at(time_s)
    thumb, fingers = pads_m(cast, moment.hand)
    pose = moment.halves[0]
    on_axis = pose.place_m - pose.turn @ (0, cast.grip_height_m, 0)
    # Grips are tabulated: half a millimetre.
    np.testing.assert_allclose((thumb + fingers) / 2, on_axis, atol=5e-4)
    assert np.linalg.norm(fingers - thumb) == pytest.approx(cast.width_m, abs=1e-3)


@pytest.mark.parametrize("tipped", [False, True])
@pytest.mark.parametrize("action", ["holding", "showing", "pouring", "moving_left_to_right"])
def test_held_things_stay_in_the_grip(action: str, tipped: bool) -> None:
    for seed in SEEDS:
        cast, at, times = acted(action, seed, both_hands=False, tipped=tipped, lifted=True)
        for time in times[::10]:
            assert_gripped(cast, at, time)


@pytest.mark.parametrize("action", ["holding", "showing", "moving_left_to_right"])
def test_what_is_done_with_both_hands_looks_like_tearing_but_the_halves_stay_as_far_apart(action: str) -> None:
    for seed in SEEDS:
        for apart in (0.0, 0.6):
            _, at, times = acted(action, seed, both_hands=True, apart=apart, joins=False, lifted=True)
            places = feet(at, times, 1) - feet(at, times, 0)
            # Tearing moves each half by 5 to 8.5 cm, and a tenth of that upwards and forwards.
            distance = np.linalg.norm(places, axis=1)
            np.testing.assert_allclose(distance, distance[0], atol=1e-9)
            assert (distance[0] > 0.02) == (apart > 0)
            hands = [at(times[0]).hand, at(times[0]).second]
            assert all(hand is not None for hand in hands)
            halves = sorted(float(at(times[0]).halves[half].place_m[0]) for half in (0, 1))
            wrists = sorted(hand.wrist_m[0] for hand in hands if hand is not None)
            assert wrists[0] < halves[0] <= halves[1] < wrists[1]


def test_a_tipped_thing_is_held_as_at_the_end_of_pouring() -> None:
    for seed in SEEDS:
        _, poured, times = acted("pouring", seed, both_hands=False, tipped=True)
        _, held, _ = acted("holding", seed, both_hands=False, tipped=True, offered=False)
        one, other = poured(times[-1]).halves[0], held(times[0]).halves[0]
        np.testing.assert_allclose(one.turn, other.turn, atol=1e-9)
        # The drift of holding and the tremor: 12 and 1.8 mm along an axis.
        np.testing.assert_allclose(one.place_m, other.place_m, atol=0.016)


def test_spilled_grains_lie_where_poured_ones_do() -> None:
    """In any action, from its beginning; pouring adds the others."""
    places = {}
    for action in ("holding", "pouring"):
        _, at, times = acted(action, 0, spilled=0.5)
        first, last = at(times[0]).grains_m, at(times[-1]).grains_m
        assert first is not None
        assert last is not None
        assert np.isfinite(first[:, 0]).sum() == GRAINS // 2
        np.testing.assert_array_equal(first[: GRAINS // 2], last[: GRAINS // 2])
        places[action] = first[: GRAINS // 2]
        if action == "pouring":
            poured = last[GRAINS // 2 :][np.isfinite(last[GRAINS // 2 :, 0])]
            middle = np.nanmean(poured, axis=0) - first[: GRAINS // 2].mean(axis=0)
            assert np.abs(middle[[0, 2]]).max() < 0.05
    np.testing.assert_array_equal(places["holding"], places["pouring"])


@pytest.mark.parametrize("idle", ["away", "rests", "enters"])
def test_an_idle_hand_keeps_to_its_side_and_touches_nothing(idle: str) -> None:
    for seed in SEEDS:
        cast, at, times = acted("picking_up", seed, idle=idle)
        states = [at(time).second for time in times]
        if idle == "away":
            assert states == [None] * len(times)
            continue
        wrists = np.array([state.wrist_m for state in states if state is not None])
        moved = np.linalg.norm(np.ptp(wrists, axis=0))
        assert moved > 0.2 if idle == "enters" else moved == 0
        for time, state in zip(times[::10], states[::10], strict=True):
            assert state is not None
            hand = state.mesh(LOOK).vertices_m
            assert cast.second.side * state.wrist_m[0] > 0
            things = [
                mesh.vertices @ pose.turn.T + pose.place_m
                for mesh, pose in zip(cast.thing.halves, at(time).halves, strict=True)
            ]
            gaps = np.linalg.norm(hand[:, None] - np.concatenate(things)[None, ::7], axis=2)
            assert gaps.min() > 0.005


def test_what_slides_stays_at_the_fingertip_on_the_table() -> None:
    for seed in SEEDS:
        manner = UPRIGHT | {"lifted": False, "slides": True}
        cast, at, times = acted("moving_left_to_right", seed, **manner)
        _, poked, _ = acted("poking", seed, **manner)
        moments = [at(time) for time in times]
        gaps = np.array([moment.halves[0].place_m - moment.hand.wrist_m for moment in moments])
        np.testing.assert_allclose(gaps, gaps[:1].repeat(len(gaps), axis=0), atol=1e-9)
        touching = poked(cast.times(0.56)[0])
        # As in a poke, but for the tremor: the arm follows.
        np.testing.assert_allclose(touching.halves[0].place_m - touching.hand.wrist_m, gaps[0], atol=1e-3)
        assert np.abs(feet(at, times)[:, 1]).max() == 0


@pytest.mark.parametrize("slides", [False, True])
@pytest.mark.parametrize("action", ["moving_right_to_left", "moving_left_to_right"])
def test_what_is_moved_along_the_table_is_upright_and_whole(action: str, slides: bool) -> None:
    """In one hand, or at a fingertip, however things are held in the air."""
    manner: dict[str, Any] = {"both_hands": True, "tipped": True, "apart": 0.6, "idle": "away"}
    for seed in SEEDS:
        _, at, times = acted(action, seed, lifted=False, slides=slides, **manner)
        assert all(at(time).second is None for time in times)
        assert np.abs(feet(at, times)[:, 1]).max() < 1e-9, "on the table"
        np.testing.assert_array_equal(feet(at, times, 0), feet(at, times, 1))
        assert max(tilt_deg(at(time).halves[0]) for time in times) < 1e-3


def test_a_poke_touches_then_pushes_a_little() -> None:
    for seed in SEEDS:
        cast, at, times = acted("poking", seed)
        along = (feet(at, times) - feet(at, times)[0]) @ cast.main.forwards
        assert 0.007 < along[-1] < 0.026
        assert np.diff(along).min() >= 0
        bones = pose_bones(at(times[0]).hand.angles_rad)
        gaps = []
        for time in times:
            moment = at(time)
            tip = moment.hand.wrist_m + cast.main.size * moment.hand.frame @ bones.tip_m(1)
            gaps.append(float((moment.halves[0].place_m - tip) @ cast.main.forwards))
        height = -(at(times[0]).hand.wrist_m[1])
        assert height > 0
        # From the fingertip's end to the thing's axis: half its depth and the fingertip's radius, at contact.
        surface = (
            cast.thing.depth_m
            / 2
            * np.array([cast.thing.share_at(h) for h in (0.5, 0.75) @ np.eye(2) * cast.thing.height_m])
        )
        nearest = min(gaps)
        assert surface.min() - 0.002 < nearest < surface.max() + PAD_M[1] * cast.main.size + 0.002
        moving = np.flatnonzero(np.diff(along) > 1e-4)
        assert np.array(gaps)[moving + 1].max() < nearest + 0.002, "pushed only while it is touched"
        assert gaps[0] > nearest + 0.1
        assert gaps[-1] > nearest + 0.05


def test_holding_is_almost_still() -> None:
    for seed in SEEDS:
        _, at, times = acted("holding", seed, **UPRIGHT)
        places = feet(at, times)
        assert 1e-4 < np.ptp(places, axis=0).max() < 0.025
        assert tilt_deg(at(times[30]).halves[0]) < 1e-3


def test_showing_brings_the_thing_to_the_viewer_and_turns_it() -> None:
    for seed in SEEDS:
        cast, at, times = acted("showing", seed, **UPRIGHT)
        towards = feet(at, times) @ cast.to_viewer
        assert towards[-15:].mean() - towards[0] > 0.01
        poses = [at(time).halves[0] for time in times]
        yaws = [math.degrees(math.acos(np.clip((np.trace(p.turn @ poses[0].turn.T) - 1) / 2, -1, 1))) for p in poses]
        assert max(yaws) > 24


def test_tearing_parts_the_halves_between_two_hands() -> None:
    for seed in SEEDS:
        cast, at, times = acted("tearing", seed)
        apart = feet(at, times, 1) - feet(at, times, 0)
        assert np.abs(apart[times < cast.times(0.7)[0]]).max() < 1e-9, "whole at first"
        ends = [at(times[-1]).halves[half] for half in (0, 1)]
        middles = [
            mesh.vertices.mean(axis=0) @ pose.turn.T + pose.place_m
            for mesh, pose in zip(cast.thing.halves, ends, strict=True)
        ]
        assert middles[1][0] - middles[0][0] > 0.09, "the right half goes to the right"
        last = at(times[-1])
        assert last.second is not None
        hands = sorted([last.hand.wrist_m[0], last.second.wrist_m[0]])
        assert hands[0] < middles[0][0] < middles[1][0] < hands[1]


@pytest.mark.parametrize("action", ["tearing", "holding", "showing", "moving_left_to_right"])
@pytest.mark.parametrize("apart", [0.0, 0.6])
def test_a_hand_that_joins_is_there_when_tearing_begins_and_to_what_is_torn_from_the_beginning(
    action: str, apart: float
) -> None:
    """Its wrist then keeps its place beside its half, turned as this is."""
    for seed in SEEDS:
        cast, at, times = acted(action, seed, both_hands=True, apart=apart, joins=True, lifted=True)
        waits = action == "tearing" or not apart
        own = int(cast.second.side > 0)
        gaps = []
        for time in times:
            moment = at(time)
            assert moment.second is not None
            half = moment.halves[own]
            gaps.append(half.turn.T @ (moment.second.wrist_m - half.place_m))
        moved = np.linalg.norm(np.array(gaps) - gaps[-1], axis=1)
        assert moved[times > cast.times(0.68)[0]].max() < 1e-9
        assert (moved[0] > 0.1) == waits


@pytest.mark.parametrize("action", [action for action in ACTIONS if action != "tearing"])
def test_one_hand_does_not_part_the_halves_and_only_pouring_lets_grains_out(action: str) -> None:
    _, at, times = acted(action, 0, both_hands=False, spilled=0.0)
    np.testing.assert_array_equal(feet(at, times, 0), feet(at, times, 1))
    assert (at(times[-1]).grains_m is not None) == (action == "pouring")


def test_pouring_tips_the_thing_over_and_grains_fall_on_the_table() -> None:
    for seed in range(3):
        cast, at, times = acted("pouring", seed, spilled=0.0)
        assert tilt_deg(at(0.0).halves[0]) < 1e-3
        assert max(tilt_deg(at(time).halves[0]) for time in times) > 100
        assert at(0.0).grains_m is None
        fine = np.arange(0, cast.duration_s, 0.01)
        tracks = [at(time).grains_m for time in fine]
        heights = np.array([np.full(GRAINS, np.nan) if track is None else -track[:, 1] for track in tracks])
        assert np.nanmin(heights) > cast.grain_m - 1e-9, "grains lie on the table"
        assert np.isfinite(heights[-1]).mean() > 0.9
        assert np.mean(heights[-1] < cast.grain_m + 1e-9) > 0.5
        falling = np.diff(heights, 2, axis=0) / 1e-4
        free = np.isfinite(falling) & (heights[2:] > cast.grain_m + 0.01)
        np.testing.assert_allclose(falling[free], -GRAVITY_M_S2, rtol=1e-4)


def test_courses_rest_at_their_keys() -> None:
    times = np.linspace(0, 3, 3001)
    values = np.array([float(keyed(time, [0.5, 1.5, 2.5], [0.0, 1.0, 0.25])) for time in times])
    assert values[0] == 0
    assert values[-1] == 0.25
    assert values[1500] == pytest.approx(1.0)
    # A minimum-jerk movement's top speed is 15/8 of the mean (Flash and Hogan, 1985).
    assert np.abs(np.gradient(values, times)).max() == pytest.approx(15 / 8, rel=1e-4)


def test_things_are_two_closed_fitting_shells_that_stand_on_the_table() -> None:
    rng = np.random.default_rng(0)
    things = [draw_thing(rng) for _ in range(40)]
    assert {thing.kind for thing in things} == set(KINDS)
    for thing in things:
        left, right = (half.vertices for half in thing.halves)
        together = np.concatenate([left, right])
        np.testing.assert_allclose(together[:, 1].max(), 0, atol=1e-12)
        assert together[:, 1].min() == pytest.approx(-thing.height_m)
        # Dented things differ by their lumps, which are at most 7 % of the width.
        assert np.ptp(together[:, 0]) == pytest.approx(thing.width_m, rel=0.08)
        assert left[:, 0].mean() < 0 < right[:, 0].mean()
        # The first and last columns of a half are the other's last and first: one seam.
        rows = len(KINDS[thing.kind].profile)
        a, b = (half.reshape(rows, -1, 3) for half in (left, right))
        np.testing.assert_allclose(a[:, 0], b[:, -1], atol=1e-9)
        np.testing.assert_allclose(a[:, -1], b[:, 0], atol=1e-9)
        assert np.ptp(a[1:-1, 0, 0]) > 0.001, "jagged"
        for half in thing.halves:
            assert np.isfinite(half.normals).all()
            outward = np.einsum("vi,vi->v", half.normals, half.vertices - (0, -thing.height_m / 2, 0))
            assert np.mean(outward > 0) > (0.55 if thing.kind == "cup" else 0.7)


def test_grains_are_as_large_and_where_they_are_asked_to_be() -> None:
    centres, radii = np.random.default_rng(0).standard_normal((5, 3)), np.arange(1.0, 6)
    mesh = grains_mesh(centres, radii)
    pieces = mesh.vertices.reshape(5, 6, 3)
    np.testing.assert_allclose(pieces.mean(axis=1), centres)
    np.testing.assert_allclose(
        np.linalg.norm(pieces - centres[:, np.newaxis], axis=2), radii[:, np.newaxis] * np.ones(6)
    )
    a, b, c = (mesh.vertices[mesh.faces[:, side]] for side in range(3))
    piece = mesh.faces[:, 0] // 6
    assert np.all(np.einsum("fi,fi->f", np.cross(b - a, c - a), a - centres[piece]) > 0), "seen from outside"
