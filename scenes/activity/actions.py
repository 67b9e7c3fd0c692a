"""The ten coarse actions of Something-Something as courses in time: who is where at a moment.

Every action uses the same cast, and is done in its manner where that is left open: things are held by one or both hands,
whole or already torn, upright or tipped over, and hands come in that do nothing. Simplifications are: any thing can be torn
(its two shells part along a jagged seam) and poured from (grains come out of its top), things fall and stand upright, and
what is poked slides.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from scenes.activity.cast import Cast
from scenes.activity.grains import Grains
from scenes.activity.hand import OPEN, POINTING
from scenes.activity.holds import Actor, HandState, Pose, between_states, bounce_height, keyed, minimum_jerk
from scenes.layout import rotation

Array = NDArray[np.float64]
Action = Literal[
    "dropping",
    "moving_right_to_left",
    "moving_left_to_right",
    "picking_up",
    "putting_down",
    "poking",
    "tearing",
    "pouring",
    "holding",
    "showing",
]
ACTIONS: tuple[Action, ...] = get_args(Action)


@dataclass(frozen=True)
class Moment:
    """What is where at one time.

    Attributes:
        hand: the acting hand.
        second: the other hand; None where it is out of the image.
        halves: poses of the thing's left and right half.
        grains_m: ``(GRAINS, 3)`` centres; None where none is out yet. Those still inside are NaN.
    """

    hand: HandState
    second: HandState | None
    halves: tuple[Pose, Pose]
    grains_m: Array | None = None


Course = Callable[[float], Moment]
Motion = Callable[[float], tuple[Array, Array]]
"""Where the gripping point of a thing is at a time, and by how much the thing is turned, ``(3, 3)``."""


def course(action: str, cast: Cast) -> Course:
    """Return an action's course: what is where at a time in seconds, 0 to the cast's duration."""
    return _COURSES[action](cast)


def _idle(cast: Cast) -> Callable[[float], HandState | None]:
    """Return what the other hand does while it takes no part."""
    actor, luck = cast.second, cast.luck
    if cast.manner.idle == "away":
        return lambda _: None
    if cast.manner.idle == "rests":
        lying = actor.resting(np.array([actor.side * (0.22 + 0.05 * luck[1]), -0.03, -0.16 + 0.05 * luck[2]]))
        return lambda _: lying
    # It hovers before the thing, on its own side, and leaves again or stays.
    over = np.array([actor.side * (0.03 + 0.09 * luck[30]), -0.02 - 0.06 * luck[31], -0.15 + 0.03 * luck[32]])
    over += (cast.spot_m[0], 0, cast.spot_m[1])
    outside = over + 0.3 * np.array([actor.side, -0.3, -0.4])
    enters, leaves = 0.3 * luck[33], 0.62 + 0.3 * luck[34]
    times = [share * cast.duration_s for share in (enters, enters + 0.25, leaves, leaves + 0.25)]
    stops = [outside, over, over + 0.04 * (2 * luck[35:38] - 1) * (1, 0.5, 1), outside]
    shoulder = actor.shoulder(over)
    angles = POINTING if luck[38] < 0.5 else OPEN
    elevation = math.radians(5 + 20 * luck[39])

    def enter(time_s: float) -> HandState:
        return actor.pointing(keyed(time_s, times, stops) + cast.shake_m(time_s), shoulder, elevation, angles)

    return enter


def _one_hand(cast: Cast, act: Callable[[float], tuple[HandState, Pose]], grains: Grains | None = None) -> Course:
    second, grains = _idle(cast), grains or Grains(cast)

    def moment(time_s: float) -> Moment:
        hand, pose = act(time_s)
        return Moment(hand, second(time_s), (pose, pose), grains.at(time_s))

    return moment


def _aloft(cast: Cast) -> tuple[Array, Array]:
    """Return gripping point and turn of a thing that is held above the table, upright or tipped over."""
    if cast.tips:
        return cast.tipped_m, rotation(cast.main.forwards, cast.tip_rad)
    return cast.in_air_m, np.eye(3)


def _steadied(cast: Cast, point_m: Array, time_s: float) -> Array:
    """Add tremor to a gripping point, the less the nearer the thing is to the table, on which it stands still."""
    lifted = -point_m[1] - cast.grip_height_m
    return point_m + min(1.0, max(0.0, lifted / 0.03)) * cast.shake_m(time_s)


def _carried(cast: Cast, motion: Motion, shoulder_of: Callable[[Actor, Array], Array]) -> Course:
    """Return the course of a thing that one hand holds all the time; ``shoulder_of`` actor and gripping point."""

    def act(time_s: float) -> tuple[HandState, Pose]:
        point, turn = motion(time_s)
        return cast.main.gripping(point, cast.width_m, shoulder_of(cast.main, point), turn), cast.carried(point, turn)

    return _one_hand(cast, act)


def _in_both_hands(
    cast: Cast,
    motion: Motion,
    shoulder_of: Callable[[Actor, Array], Array],
    *,
    apart: Callable[[float], float] = lambda _: 0.0,
    joins: bool = False,
    let_go_s: float = math.inf,
) -> Course:
    """Return the course of a thing whose lower edges both hands pinch, thumbs towards the viewer.

    Its halves are ``apart`` as a share of what tearing does. A second hand that ``joins`` has pinched it when tearing begins;
    it does not come to what will be let go.
    """
    thing, side = cast.thing, cast.main.side
    yaw = rotation([0, 1, 0], math.radians(16 * (cast.luck[40] - 0.5)))
    height = (0.25 + 0.2 * cast.luck[13]) * thing.height_m
    # From the sides and from below.
    actors = {s: Actor(a.size, a.left, math.radians(76), math.radians(-22), a.elbow_m) for s, a in _sides(cast).items()}
    edge = 0.43 * thing.width_m * thing.share_at(height)
    pinch = 0.6 * thing.depth_m * thing.share_at(height)
    start, arrive, pinched = cast.times(0.16, 0.58, 0.68)
    reach = 0.05 + 0.035 * cast.luck[11]
    bend = math.radians(18 + 22 * cast.luck[12])
    lower = cast.grip_height_m - height

    def half(s: float, time_s: float) -> tuple[Array, Array, Pose]:
        """Return a hand's point and turn, and its half's pose, as long as it is held."""
        part = apart(time_s)
        point, turn = motion(time_s)
        point = point + turn @ (yaw @ (s * edge, 0, 0) + (0, lower, 0) + part * np.array([s * reach, 0.01, -0.01]))
        turn = turn @ rotation([0, 0, 1], s * bend * part)
        return point, turn, Pose(turn @ yaw, point + turn @ yaw @ (-s * edge, height, 0))

    def hand(s: float, time_s: float, width_m: float) -> HandState:
        point, turn, _ = half(s, time_s)
        since = time_s - let_go_s
        width_m += float(keyed(since, [-0.06, 0.04], [0, 0.04]))
        back = keyed(since, [0, 0.5], [np.zeros(3), 0.2 * np.array([s, 0, 0])])
        return actors[s].gripping(point + back, width_m, shoulder_of(actors[s], point), turn)

    # Who joins waits out of the image, aside of wherever the thing is until then.
    outermost = max((motion(time)[0] for time in (0.0, pinched)), key=lambda point: -side * point[0])
    aside = outermost + 0.28 * np.array([-side, 0, -0.6])

    def second(time_s: float) -> HandState:
        if not joins:
            return hand(-side, time_s, pinch)
        actor = actors[-side]
        waiting = actor.gripping(aside + cast.shake_m(time_s), pinch + 0.04, shoulder_of(actor, aside))
        if let_go_s < math.inf:
            return waiting
        there = hand(-side, time_s, float(keyed(time_s, [arrive, pinched], [pinch + 0.03, pinch])))
        return between_states(waiting, there, float(keyed(time_s, [start, arrive], [0, 1])))

    grains = Grains(cast)

    def moment(time_s: float) -> Moment:
        first, other = (_fallen(cast, half(s, min(time_s, let_go_s))[2], time_s - let_go_s) for s in (-1.0, 1.0))
        return Moment(hand(side, time_s, pinch), second(time_s), (first, other), grains.at(time_s))

    return moment


def _sides(cast: Cast) -> dict[float, Actor]:
    return {cast.main.side: cast.main, cast.second.side: cast.second}


def _fallen(cast: Cast, held: Pose, since_s: float) -> Pose:
    """Return a thing's pose ``since_s`` seconds after it was let go; while that is negative, the one in which it is held."""
    if since_s < 0:
        return held
    x, y, z = held.place_m
    return Pose(held.turn, np.array([x, -bounce_height(-y, since_s, 0.1 + 0.25 * cast.luck[4]), z]))


def _dropping(cast: Cast) -> Course:
    (release,) = cast.times(0.55 + 0.25 * cast.luck[3])
    high = cast.in_air_m
    shoulder = cast.main.shoulder(high)
    if cast.manner.both_hands:

        def motion(time_s: float) -> tuple[Array, Array]:
            return _steadied(cast, high, time_s), np.eye(3)

        def shoulder_of(actor: Actor, _: Array) -> Array:
            return actor.shoulder(high)

        return _in_both_hands(cast, motion, shoulder_of, joins=cast.manner.joins, let_go_s=release)
    held = cast.carried(_steadied(cast, high, release))
    leaving = np.array([0, -0.02, 0]) - (0.03 if cast.manner.from_above else 0.25) * cast.main.forwards

    def act(time_s: float) -> tuple[HandState, Pose]:
        since = time_s - release
        width = float(keyed(since, [0, 0.12], [cast.width_m, cast.open_m]))
        back = keyed(since, [0.1, 0.7], [np.zeros(3), leaving])
        point = _steadied(cast, high, time_s)
        pose = cast.carried(point) if since < 0 else _fallen(cast, held, since)
        return cast.main.gripping(point + back, width, shoulder), pose

    return _one_hand(cast, act)


def _picking_up(cast: Cast) -> Course:
    reach, closed, top = cast.times(0.34, 0.44, 0.84)
    start = cast.times(0)[0]
    return _fetched(cast, [start, reach, closed, top], [cast.away_m, cast.on_table_m, cast.on_table_m, cast.in_air_m])


def _putting_down(cast: Cast) -> Course:
    start, down, opened, end = cast.times(0.16, 0.56, 0.66, 1)
    return _fetched(cast, [end, opened, down, start], [cast.away_m, cast.on_table_m, cast.on_table_m, cast.in_air_m])


def _fetched(cast: Cast, times_s: list[float], stops_m: list[Array]) -> Course:
    """Away, at the thing with an open hand, gripping it, aloft with it: in this order in time, or backwards."""
    forwards = times_s[-1] > times_s[0]
    order = slice(None) if forwards else slice(None, None, -1)
    shoulder = cast.main.shoulder(cast.on_table_m)
    widths = [cast.open_m, cast.open_m, cast.width_m, cast.width_m]
    gripped_s = times_s[2]
    # A hand that comes from its side reaches out as one that pokes, and opens for the grip on its way.
    reaching = POINTING if cast.manner.finger else OPEN
    tip = 0.03 * cast.main.forwards

    def act(time_s: float) -> tuple[HandState, Pose]:
        point = keyed(time_s, times_s[order], stops_m[order])
        width = float(keyed(time_s, times_s[order], widths[order]))
        if time_s >= gripped_s if forwards else time_s <= gripped_s:
            point = _steadied(cast, point, time_s)
            return cast.main.gripping(point, width, shoulder), cast.carried(point)
        # The free hand is steady where it closes, as the thing on the table is: else it would jump at that moment.
        steady = min(0.5, float(np.linalg.norm(point - cast.on_table_m)) / 0.1)
        point = point + steady * cast.shake_m(time_s)
        hand = cast.main.gripping(point, width, shoulder)
        if not cast.manner.from_above:
            out = cast.main.pointing(point - tip, shoulder, cast.main.elevation_rad, reaching)
            there = keyed(time_s, sorted(times_s[:2]), [0, 1] if forwards else [1, 0])
            hand = between_states(out, hand, float(there))
        return hand, cast.carried(cast.on_table_m)

    return _one_hand(cast, act)


def _moving(direction: float) -> Callable[[Cast], Course]:
    def build(cast: Cast) -> Course:
        half = 0.075 + 0.045 * cast.luck[5]
        manner = cast.manner
        hop = max(0.0, 0.06 * (cast.luck[6] - 0.5)) if manner.lifted else 0.0
        place, turn = _aloft(cast) if manner.lifted else (cast.on_table_m, np.eye(3))
        middle = place * (0.5, 1, 1)
        reach = np.array([direction * half, 0, 0])
        ends = [middle - reach, middle + reach]
        times = cast.times(0.1, 0.9)

        def motion(time_s: float) -> tuple[Array, Array]:
            point = keyed(time_s, times, ends)
            share = (point[0] - ends[0][0]) / (ends[1][0] - ends[0][0])
            return _steadied(cast, point - (0, 4 * hop * share * (1 - share), 0), time_s), turn

        def follow(actor: Actor, point: Array) -> Array:
            """The arm follows the hand half-way."""
            return actor.shoulder(middle) + 0.5 * (point - middle) * (1, 0, 1)

        if manner.lifted and manner.both_hands:
            return _in_both_hands(
                cast, motion, follow, apart=lambda _: manner.apart, joins=manner.joins and not manner.apart
            )
        if manner.slides and not manner.lifted:
            return _slid(cast, lambda time_s: keyed(time_s, times, ends) - cast.on_table_m)
        return _carried(cast, motion, follow)

    return build


def _slid(cast: Cast, moved_m: Callable[[float], Array]) -> Course:
    """Return the course of a thing that is moved about the table by the fingertip that touches it."""
    standing = cast.carried(cast.on_table_m)
    touch, hand = _poked(cast)

    def act(time_s: float) -> tuple[HandState, Pose]:
        way = moved_m(time_s)
        return hand(touch + way), Pose(standing.turn, standing.place_m + way)

    return _one_hand(cast, act)


def _poked(cast: Cast) -> tuple[Array, Callable[[Array], HandState]]:
    """Return where a fingertip touches the thing on its place, and the hand whose fingertip is at a point."""
    thing, actor = cast.thing, cast.main
    height = (0.5 + 0.25 * cast.luck[7]) * thing.height_m
    reach = thing.depth_m / 2 * thing.share_at(height)
    touch = cast.carried(cast.on_table_m).place_m - (0, height, 0) - reach * actor.forwards
    elevation = math.radians(4 + 16 * cast.luck[9])
    angles = POINTING if cast.manner.finger else OPEN
    return touch, lambda tip: actor.pointing(tip, actor.shoulder(touch), elevation, angles)


def _poking(cast: Cast) -> Course:
    standing, forwards = cast.carried(cast.on_table_m), cast.main.forwards
    touch, hand = _poked(cast)
    push = (0.008 + 0.017 * cast.luck[8]) * forwards
    stops = [touch - 0.36 * forwards - (0, 0.05, 0), touch, touch + push, touch - 0.05 * forwards]
    stops.append(touch - 0.25 * forwards - (0, 0.04, 0))
    times = cast.times(0.16, 0.56, 0.66, 0.78, 1)

    def act(time_s: float) -> tuple[HandState, Pose]:
        tip = keyed(time_s, times, stops)
        # What the fingertip has pushed stays where it was pushed to.
        furthest = keyed(min(time_s, times[2]), times, stops)
        pushed = max(0.0, float((furthest - touch) @ forwards)) * forwards
        steady = 0.1 + 0.9 * float(minimum_jerk(-(tip - touch) @ forwards / 0.05))
        return hand(tip + steady * cast.shake_m(time_s)), Pose(standing.turn, standing.place_m + pushed)

    return _one_hand(cast, act)


def _holding(cast: Cast) -> Course:
    place, turn = _aloft(cast)
    if cast.manner.offered:
        away, back, nod = _showing_angles(cast)
        share = cast.luck[45]
        place, turn = cast.near_m, _looked_at(away + share * (back - away), nod * cast.luck[46]) @ turn
    drift = 0.012 * (2 * cast.luck[41:44] - 1)
    times = cast.times(0, 1)

    def motion(time_s: float) -> tuple[Array, Array]:
        return keyed(time_s, times, [place, place + drift]) + cast.shake_m(time_s), turn

    return _held(cast, motion, place)


def _showing(cast: Cast) -> Course:
    (place, upside), near = _aloft(cast), cast.near_m
    away, back, nod = _showing_angles(cast)
    times = cast.times(0.3, 0.62, 0.82, 1)

    def motion(time_s: float) -> tuple[Array, Array]:
        point = keyed(time_s, times, [place, near, near, near]) + cast.shake_m(time_s)
        yaw, pitch = keyed(time_s, times, [(0, 0), (away, nod), (back, nod), (0.4 * away, 0.5 * nod)])
        return point, _looked_at(float(yaw), float(pitch)) @ upside

    return _held(cast, motion, near)


def _showing_angles(cast: Cast) -> tuple[float, float, float]:
    """Return by how much what is shown is turned away from the viewer, then back, but not before it, and its nod."""
    away = -cast.main.side * math.radians(25 + 25 * cast.luck[11])
    back = cast.main.side * min(math.radians(20 + 25 * cast.luck[12]), cast.main.azimuth_rad - math.radians(30))
    return away, back, math.radians(-10 - 20 * cast.luck[13])


def _looked_at(yaw: float, pitch: float) -> Array:
    """Return the turn of what is shown."""
    return rotation([0, 1, 0], yaw) @ rotation([1, 0, 0], pitch)


def _held(cast: Cast, motion: Motion, place_m: Array) -> Course:
    """Return the course of what is held about a place, by one hand or both."""

    def shoulder(actor: Actor, _: Array) -> Array:
        return actor.shoulder(place_m)

    if cast.manner.both_hands:
        apart = cast.manner.apart
        return _in_both_hands(cast, motion, shoulder, apart=lambda _: apart, joins=cast.manner.joins and not apart)
    return _carried(cast, motion, shoulder)


def _tearing(cast: Cast) -> Course:
    place = cast.in_air_m * (0.5, 1, 1)
    pinched, torn = cast.times(0.7, 0.98)

    def motion(time_s: float) -> tuple[Array, Array]:
        return place + cast.shake_m(time_s), np.eye(3)

    def apart(time_s: float) -> float:
        return float(keyed(time_s, [pinched, torn], [0, 1]))

    def shoulder(actor: Actor, _: Array) -> Array:
        return actor.shoulder(place)

    return _in_both_hands(cast, motion, shoulder, apart=apart, joins=cast.manner.joins)


def _pouring(cast: Cast) -> Course:
    tilting, end = cast.times(0.4, 0.62), cast.times(1)[0]
    shoulder = cast.main.shoulder(cast.tipped_m)

    def held(time_s: float) -> tuple[Array, Array]:
        point = keyed(time_s, tilting, [cast.in_air_m, cast.tipped_m])
        angle = float(keyed(time_s, tilting, [0.0, cast.tip_rad]))
        return _steadied(cast, point, time_s), rotation(cast.main.forwards, angle)

    def act(time_s: float) -> tuple[HandState, Pose]:
        point, turn = held(time_s)
        return cast.main.gripping(point, cast.width_m, shoulder, turn), cast.carried(point, turn)

    opening = cast.times(0.56)[0]
    span = (opening, opening + 0.9 * (end - opening))
    return _one_hand(cast, act, Grains(cast, lambda time_s: cast.carried(*held(time_s)), span))


_COURSES: dict[str, Callable[[Cast], Course]] = {
    "dropping": _dropping,
    "moving_right_to_left": _moving(-1.0),
    "moving_left_to_right": _moving(1.0),
    "picking_up": _picking_up,
    "putting_down": _putting_down,
    "poking": _poking,
    "tearing": _tearing,
    "pouring": _pouring,
    "holding": _holding,
    "showing": _showing,
}
