"""The ten coarse actions of Something-Something as courses in time: who is where at a moment.

Every action uses the same cast (one thing of two halves, one or two hands, grains), drawn before the action is known. So
simplifications are: any thing can be torn (its two shells part along a jagged seam) and poured from (grains come out of
its top), things fall and stand upright, and what is poked slides.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from scenes.activity.hand import widest_grip_m
from scenes.activity.holds import GRAVITY_M_S2, Actor, HandState, Pose, between_states, bounce_height, keyed
from scenes.activity.things import Thing
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
GRAINS = 72


@dataclass(frozen=True)
class Cast:
    """All that a course depends on beside the action; lengths in metres of the set.

    Attributes:
        thing: what is handled.
        main: the hand that acts.
        second: the other hand, which tears.
        second_rests: whether the other hand lies on the table, else it is out of the image.
        spot_m: ``(x, z)`` of the action on the table.
        aloft_m: how high a lifted thing's foot is.
        grip_height_m: above the thing's foot.
        to_viewer: unit vector to the camera.
        duration_s: of the clip, in the set's time.
        margins: shares of the duration before the action starts and after it ends.
        tremor_m: amplitude of the hand's shaking.
        grain_m: radius of the grains.
        luck: ``(32,)`` numbers in 0..1 that each action uses in its own way.
    """

    thing: Thing
    main: Actor
    second: Actor
    second_rests: bool
    spot_m: Array
    aloft_m: float
    grip_height_m: float
    to_viewer: Array
    duration_s: float
    margins: tuple[float, float]
    tremor_m: float
    grain_m: float
    luck: Array

    @property
    def width_m(self) -> float:
        """Width of the thing where it is gripped."""
        return self.thing.width_m * self.thing.share_at(self.grip_height_m)

    @property
    def open_m(self) -> float:
        """Width of the hand before and after a grip."""
        return min(self.width_m + 0.035, widest_grip_m() * self.main.size)

    @property
    def on_table_m(self) -> Array:
        """Point to grip when the thing stands on the action's place."""
        return np.array([self.spot_m[0], -self.grip_height_m, self.spot_m[1]])

    @property
    def in_air_m(self) -> Array:
        """Point to grip when the thing is lifted."""
        return self.on_table_m - (0, self.aloft_m, 0)

    @property
    def away_m(self) -> Array:
        """Where the gripping point of a hand is that waits out of the way."""
        return self.on_table_m - 0.25 * self.main.forwards - (0, 0.05 + 0.04 * self.luck[0], 0)

    def times(self, *shares: float) -> list[float]:
        """Return moments of the action, given as shares of it, in seconds of the clip."""
        before, after = self.margins
        return [self.duration_s * (before + (1 - before - after) * share) for share in shares]

    def shake_m(self, time_s: float) -> Array:
        """Return the tremor of a hand: slow sway and a faint 8 Hz, along each axis."""
        phases = 2 * math.pi * self.luck[20:29].reshape(3, 3)
        rates = np.array([0.7, 2.3, 8.0]) * (0.85 + 0.3 * self.luck[29])
        return self.tremor_m * np.sin(2 * math.pi * rates * time_s + phases) @ (1.0, 0.6, 0.25)

    def carried(self, point_m: Array, turn: Array | None = None) -> Pose:
        """Return the thing's pose when it is gripped at a point."""
        upright = self.main.upright
        foot = np.array([0, self.grip_height_m, 0])
        return Pose(upright, point_m + foot) if turn is None else Pose(turn @ upright, point_m + turn @ foot)


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


def course(action: str, cast: Cast) -> Course:
    """Return an action's course: what is where at a time in seconds, 0 to the cast's duration."""
    return _COURSES[action](cast)


def _resting(cast: Cast) -> HandState | None:
    """Return the other hand where it lies on the table, aside."""
    if not cast.second_rests:
        return None
    place = np.array([cast.second.side * (0.22 + 0.05 * cast.luck[1]), -0.03, -0.16 + 0.05 * cast.luck[2]])
    return cast.second.resting(place)


def _one_hand(cast: Cast, act: Callable[[float], tuple[HandState, Pose]]) -> Course:
    second = _resting(cast)

    def moment(time_s: float) -> Moment:
        hand, pose = act(time_s)
        return Moment(hand, second, (pose, pose))

    return moment


def _steadied(cast: Cast, point_m: Array, time_s: float) -> Array:
    """Add tremor to a gripping point, the less the nearer the thing is to the table, on which it stands still."""
    lifted = -point_m[1] - cast.grip_height_m
    return point_m + min(1.0, max(0.0, lifted / 0.03)) * cast.shake_m(time_s)


def _dropping(cast: Cast) -> Course:
    (release,) = cast.times(0.3 + 0.25 * cast.luck[3])
    high = cast.in_air_m - (0, 0.03, 0)
    shoulder = cast.main.shoulder(high)
    from_m = _steadied(cast, high, release)
    restitution = 0.1 + 0.25 * cast.luck[4]

    def act(time_s: float) -> tuple[HandState, Pose]:
        since = time_s - release
        width = float(keyed(since, [0, 0.12], [cast.width_m, cast.open_m]))
        back = keyed(since, [0.1, 0.7], [np.zeros(3), np.array([0, -0.02, 0]) - 0.03 * cast.main.forwards])
        point = _steadied(cast, high, time_s)
        hand = cast.main.gripping(point + back, width, shoulder)
        if since < 0:
            return hand, cast.carried(point)
        foot = from_m[1] + cast.grip_height_m
        height = bounce_height(-foot, since, restitution)
        return hand, cast.carried(np.array([from_m[0], -height - cast.grip_height_m, from_m[2]]))

    return _one_hand(cast, act)


def _picking_up(cast: Cast) -> Course:
    reach, closed, top = cast.times(0.36, 0.5, 0.95)
    start = cast.times(0)[0]
    return _fetched(cast, [start, reach, closed, top], [cast.away_m, cast.on_table_m, cast.on_table_m, cast.in_air_m])


def _putting_down(cast: Cast) -> Course:
    start, down, opened, end = cast.times(0.05, 0.5, 0.64, 1)
    return _fetched(cast, [end, opened, down, start], [cast.away_m, cast.on_table_m, cast.on_table_m, cast.in_air_m])


def _fetched(cast: Cast, times_s: list[float], stops_m: list[Array]) -> Course:
    """Away, at the thing with an open hand, gripping it, aloft with it: in this order in time, or backwards."""
    forwards = times_s[-1] > times_s[0]
    order = slice(None) if forwards else slice(None, None, -1)
    shoulder = cast.main.shoulder(cast.on_table_m)
    widths = [cast.open_m, cast.open_m, cast.width_m, cast.width_m]
    gripped_s = times_s[2]

    def act(time_s: float) -> tuple[HandState, Pose]:
        point = keyed(time_s, times_s[order], stops_m[order])
        width = float(keyed(time_s, times_s[order], widths[order]))
        if time_s >= gripped_s if forwards else time_s <= gripped_s:
            point = _steadied(cast, point, time_s)
            return cast.main.gripping(point, width, shoulder), cast.carried(point)
        # The free hand is steady where it closes, as the thing on the table is: else it would jump at that moment.
        steady = min(0.5, float(np.linalg.norm(point - cast.on_table_m)) / 0.1)
        hand = cast.main.gripping(point + steady * cast.shake_m(time_s), width, shoulder)
        return hand, cast.carried(cast.on_table_m)

    return _one_hand(cast, act)


def _moving(direction: float) -> Callable[[Cast], Course]:
    def build(cast: Cast) -> Course:
        half = 0.075 + 0.045 * cast.luck[5]
        hop = max(0.0, 0.06 * (cast.luck[6] - 0.5))
        middle = cast.on_table_m * (0.5, 1, 1)
        reach = np.array([direction * half, 0, 0])
        ends = [middle - reach, middle + reach]
        times = cast.times(0.1, 0.9)
        shoulder = cast.main.shoulder(middle)

        def act(time_s: float) -> tuple[HandState, Pose]:
            point = keyed(time_s, times, ends)
            share = (point[0] - ends[0][0]) / (ends[1][0] - ends[0][0])
            point = _steadied(cast, point - (0, 4 * hop * share * (1 - share), 0), time_s)
            # The arm follows the hand half-way.
            follow = shoulder + 0.5 * (point - middle) * (1, 0, 1)
            return cast.main.gripping(point, cast.width_m, follow), cast.carried(point)

        return _one_hand(cast, act)

    return build


def _poking(cast: Cast) -> Course:
    thing, actor = cast.thing, cast.main
    height = (0.5 + 0.25 * cast.luck[7]) * thing.height_m
    standing = cast.carried(cast.on_table_m)
    reach = thing.depth_m / 2 * thing.share_at(height)
    touch = standing.place_m - (0, height, 0) - reach * actor.forwards
    push = (0.008 + 0.017 * cast.luck[8]) * actor.forwards
    elevation = math.radians(4 + 16 * cast.luck[9])
    stops = [touch - 0.2 * actor.forwards - (0, 0.05, 0), touch, touch + push, touch - 0.05 * actor.forwards]
    stops.append(touch - 0.13 * actor.forwards - (0, 0.04, 0))
    times = cast.times(0, 0.38, 0.52, 0.7, 1)
    shoulder = actor.shoulder(touch)

    def act(time_s: float) -> tuple[HandState, Pose]:
        tip = keyed(time_s, times, stops)
        # What the fingertip has pushed stays where it was pushed to.
        furthest = keyed(min(time_s, times[2]), times, stops)
        pushed = max(0.0, float((furthest - touch) @ actor.forwards)) * actor.forwards
        steady = float(np.clip(-(tip - touch) @ actor.forwards / 0.05, 0.1, 1.0))
        hand = actor.pointing(tip + steady * cast.shake_m(time_s), shoulder, elevation)
        return hand, Pose(standing.turn, standing.place_m + pushed)

    return _one_hand(cast, act)


def _holding(cast: Cast) -> Course:
    drift = 0.012 * (2 * cast.luck[10:13] - 1)
    times = cast.times(0, 1)
    shoulder = cast.main.shoulder(cast.in_air_m)

    def act(time_s: float) -> tuple[HandState, Pose]:
        point = keyed(time_s, times, [cast.in_air_m, cast.in_air_m + drift]) + cast.shake_m(time_s)
        return cast.main.gripping(point, cast.width_m, shoulder), cast.carried(point)

    return _one_hand(cast, act)


def _showing(cast: Cast) -> Course:
    near = cast.in_air_m * (0.5, 1, 1) + (0.03 + 0.03 * cast.luck[10]) * cast.to_viewer
    # First the hand turns away from the viewer, then back, but never between thing and viewer.
    away = -cast.main.side * math.radians(25 + 25 * cast.luck[11])
    back = cast.main.side * min(math.radians(20 + 25 * cast.luck[12]), cast.main.azimuth_rad - math.radians(30))
    nod = np.radians(-10 - 20 * cast.luck[13])
    times = cast.times(0.03, 0.35, 0.68, 1)
    shoulder = cast.main.shoulder(near)

    def act(time_s: float) -> tuple[HandState, Pose]:
        point = keyed(time_s, times, [cast.in_air_m, near, near, near]) + cast.shake_m(time_s)
        yaw, pitch = keyed(time_s, times, [(0, 0), (away, nod), (back, nod), (0.4 * away, 0.5 * nod)])
        turn = rotation([0, 1, 0], float(yaw)) @ rotation([1, 0, 0], float(pitch))
        return cast.main.gripping(point, cast.width_m, shoulder, turn), cast.carried(point, turn)

    return _one_hand(cast, act)


def _pouring(cast: Cast) -> Course:
    thing, actor = cast.thing, cast.main
    low, high = cast.in_air_m, cast.in_air_m.copy()
    high[1] = min(high[1], -0.06 - np.hypot(thing.height_m - cast.grip_height_m, thing.width_m))
    # Inwards, as a forearm turns, and so towards the viewer: the stream falls before the hand, not behind its fingers.
    tilt = -actor.side * math.radians(112 + 33 * cast.luck[10])
    tilting, end = cast.times(0.05, 0.4), cast.times(1)[0]
    shoulder = actor.shoulder(high)
    second = _resting(cast)

    def carry(time_s: float) -> tuple[Array, Array]:
        point = keyed(time_s, [tilting[0], tilting[1]], [low, high])
        angle = float(keyed(time_s, tilting, [0.0, tilt]))
        return _steadied(cast, point, time_s), rotation(actor.forwards, angle)

    opening = cast.times(0.3)[0]
    released = opening + (0.9 * end - opening) * np.sort(np.random.default_rng(_seed(cast)).random(GRAINS))
    flights = _Flights(cast, carry, released, math.copysign(1, tilt))

    def moment(time_s: float) -> Moment:
        point, turn = carry(time_s)
        hand = actor.gripping(point, cast.width_m, shoulder, turn)
        pose = cast.carried(point, turn)
        return Moment(hand, second, (pose, pose), flights.at(time_s))

    return moment


def _seed(cast: Cast) -> int:
    return int(cast.luck[14] * 2**32)


class _Flights:
    """Ballistic flights of the grains from the lowest point of the tilted top to the table, where they stay."""

    def __init__(
        self, cast: Cast, carry: Callable[[float], tuple[Array, Array]], released_s: Array, lip_side: float
    ) -> None:
        rng = np.random.default_rng(_seed(cast) + 1)
        thing = cast.thing
        lip = lip_side * thing.width_m / 2 * thing.share_at(0.98 * thing.height_m)
        starts, speeds = [], []
        for time_s in released_s:
            pose = cast.carried(*carry(float(time_s)))
            own = np.array([lip * rng.uniform(0.4, 1.0), -thing.height_m - cast.grain_m, 0])
            own[2] = thing.depth_m * rng.uniform(-0.2, 0.2)
            starts.append(pose.place_m + pose.turn @ own)
            speeds.append(pose.turn @ (0, -rng.uniform(0.1, 0.3), 0) + rng.normal(0, 0.035, 3))
        self._released_s, self._starts_m, self._speeds = released_s, np.array(starts), np.array(speeds)
        fall = np.maximum(-cast.grain_m - self._starts_m[:, 1], 0)
        down = self._speeds[:, 1]
        self._lands_s = (np.sqrt(down**2 + 2 * GRAVITY_M_S2 * fall) - down) / GRAVITY_M_S2

    def at(self, time_s: float) -> Array | None:
        """Return the centres ``(GRAINS, 3)``, NaN where a grain is still inside; None before the first is out."""
        since = time_s - self._released_s
        if not (since >= 0).any():
            return None
        flown = np.clip(since, 0, self._lands_s)[:, np.newaxis]
        places = self._starts_m + self._speeds * flown
        places[:, 1] += 0.5 * GRAVITY_M_S2 * flown[:, 0] ** 2
        places[since < 0] = np.nan
        return places


def _tearing(cast: Cast) -> Course:
    thing = cast.thing
    side = cast.main.side
    yaw = rotation([0, 1, 0], math.radians(16 * (cast.luck[10] - 0.5)))
    middle = (cast.in_air_m - (0, 0.02, 0)) * (0.5, 1, 1)
    height = (0.25 + 0.2 * cast.luck[13]) * thing.height_m
    # Both hands pinch the thing's lower edges from the sides and from below, thumbs towards the viewer.
    actors = {s: Actor(a.size, a.left, math.radians(76), math.radians(-22), a.elbow_m) for s, a in _sides(cast).items()}
    edge = 0.43 * thing.width_m * thing.share_at(height)
    pinch = 0.6 * thing.depth_m * thing.share_at(height)
    start, arrive, pinched, torn = cast.times(0, 0.28, 0.38, 0.85)
    apart = 0.05 + 0.035 * cast.luck[11]
    bend = math.radians(18 + 22 * cast.luck[12])
    shoulders = {s: actors[s].shoulder(middle + edge * np.array([s, 0, 0])) for s in actors}

    def gripped(s: float, time_s: float) -> tuple[Array, Array]:
        """Return a hand's point and its half's turn."""
        part = float(keyed(time_s, [pinched, torn], [0, 1]))
        turn = rotation([0, 0, 1], s * bend * part)
        point = middle + yaw @ (s * edge, 0, 0) + part * np.array([s * apart, 0.01, -0.01])
        return point + cast.shake_m(time_s), turn

    def half(s: float, time_s: float) -> Pose:
        point, turn = gripped(s, time_s)
        return Pose(turn @ yaw, point + turn @ yaw @ (-s * edge, height, 0))

    def hand(s: float, time_s: float, width_m: float) -> HandState:
        point, turn = gripped(s, time_s)
        return actors[s].gripping(point, width_m, shoulders[s], turn)

    def waiting() -> HandState:
        rest = _resting(cast)
        point = middle + 0.28 * np.array([-side, 0, -0.6])
        return actors[-side].gripping(point, pinch + 0.04, shoulders[-side]) if rest is None else rest

    wait = waiting()

    def moment(time_s: float) -> Moment:
        first = hand(side, time_s, pinch)
        width = float(keyed(time_s, [arrive, pinched], [pinch + 0.03, pinch]))
        second = between_states(wait, hand(-side, time_s, width), float(keyed(time_s, [start, arrive], [0, 1])))
        return Moment(first, second, (half(-1.0, time_s), half(1.0, time_s)))

    return moment


def _sides(cast: Cast) -> dict[float, Actor]:
    return {cast.main.side: cast.main, cast.second.side: cast.second}


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
