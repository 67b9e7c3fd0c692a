"""Who and what takes part in a clip, and how things are done in it: all drawn before the action is known.

So a second hand, grains on the table, a tipped bottle or a torn sheet is no action's alone. What a still of the right moment
tells remains: only pouring has grains in the air, and only dropping a thing in the air that no hand holds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scenes.activity.hand import widest_grip_m
from scenes.activity.holds import Actor, Pose
from scenes.activity.things import Thing

Array = NDArray[np.float64]
Idle = Literal["away", "rests", "enters"]
# Least and greatest share of a clip in which nothing is done; an action takes at least so long, unless the clip is shorter.
_REST = (0.25, 0.5)
_QUICKEST_S = 0.9


@dataclass(frozen=True)
class Manner:
    """How things are done where an action leaves it open.

    Attributes:
        both_hands: whether a thing that is held, shown, dropped or moved through the air is held by both hands, as one that
            is torn.
        apart: how far its halves are then apart from the beginning, as a share of where tearing ends; 0 is whole, as
            what is dropped.
        joins: whether the second hand comes only when the action has begun, to what is whole and not dropped.
        tipped: whether one hand holds, shows or carries a thing tipped over, as for pouring.
        lifted: whether things are moved through the air, not upright along the table by one hand.
        slides: whether what is moved along the table is not gripped, but slides with a fingertip that pokes it.
        offered: whether a thing that is held is near the viewer and turned, as one that is shown.
        from_above: whether a hand comes to what it picks up from above, and leaves what it alone has put down or dropped
            upwards; else from its own side, and to it.
        finger: whether the index finger pokes, else a flat hand.
        spilled: share of the grains that lie on the table from the beginning.
        idle: what a hand does that takes no part: it is out of the image, lies on the table, or enters without acting.
    """

    both_hands: bool
    apart: float
    joins: bool
    tipped: bool
    lifted: bool
    slides: bool
    offered: bool
    from_above: bool
    finger: bool
    spilled: float
    idle: Idle


@dataclass(frozen=True)
class Cast:
    """All that a course depends on beside the action; lengths in metres of the set.

    Attributes:
        thing: what is handled.
        main: the hand that acts.
        second: the other hand.
        manner: how things are done.
        spot_m: ``(x, z)`` of the action on the table.
        aloft_m: how high a lifted thing's foot is.
        grip_height_m: above the thing's foot.
        to_viewer: unit vector to the camera.
        duration_s: of the clip, in the set's time.
        margins: shares of the duration before the action starts and after it ends.
        tremor_m: amplitude of the hand's shaking.
        grain_m: radius of the grains.
        luck: ``(48,)`` numbers in 0..1 that each action uses in its own way.
    """

    thing: Thing
    main: Actor
    second: Actor
    manner: Manner
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
    def tipped_m(self) -> Array:
        """Point to grip when the thing is lifted so high that it can be tipped over."""
        top = float(np.hypot(self.thing.height_m - self.grip_height_m, self.thing.width_m))
        return np.array([self.spot_m[0], min(self.in_air_m[1], -0.06 - top), self.spot_m[1]])

    @property
    def tip_rad(self) -> float:
        """By which a thing is tipped over, inwards, as a forearm turns, and so towards the viewer.

        What falls out of it then falls before the hand, not behind its fingers.
        """
        return -self.main.side * math.radians(112 + 33 * self.luck[10])

    @property
    def near_m(self) -> Array:
        """Point to grip when the thing is shown to the viewer."""
        place = self.tipped_m if self.tips else self.in_air_m
        return place * (0.5, 1, 1) + (0.03 + 0.03 * self.luck[44]) * self.to_viewer

    @property
    def tips(self) -> bool:
        """Whether the thing is tipped over where it is held."""
        return self.manner.tipped and not self.manner.both_hands

    @property
    def away_m(self) -> Array:
        """Where the gripping point of a hand is that waits out of the way, or above the thing."""
        if self.manner.from_above:
            return self.in_air_m - (0, 0.03 + 0.02 * self.luck[0], 0) - 0.03 * self.main.forwards
        return self.on_table_m - 0.3 * self.main.forwards - (0, 0.05 + 0.04 * self.luck[0], 0)

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


def draw_manner(rng: np.random.Generator) -> Manner:
    """Draw how things are done; the same number of draws whatever comes out."""
    shares = rng.random(12)
    apart = 0.2 + 0.8 * shares[1] if shares[2] < 0.5 else 0.0
    idle: tuple[Idle, ...] = ("away", "rests", "enters", "enters")
    return Manner(
        both_hands=bool(shares[0] < 0.55),
        apart=float(apart),
        joins=bool(shares[3] < 0.7),
        tipped=bool(shares[4] < 0.6),
        lifted=bool(shares[5] < 0.5),
        slides=bool(shares[11] < 0.85),
        offered=bool(shares[6] < 0.45),
        from_above=bool(shares[7] < 0.5),
        finger=bool(shares[8] < 0.5),
        spilled=float(max(0.0, 1.6 * shares[9] - 0.6)),
        idle=idle[int(4 * shares[10])],
    )


def draw_cast(thing: Thing, hand_size: float, to_viewer: Array, rng: np.random.Generator, *, duration_s: float) -> Cast:
    """Draw all else of a cast with a thing and hands of a size, for a clip of a duration in the set's time."""
    shares = rng.random(13)
    # Long things are gripped in the middle, flat ones high enough for the hand to stay above the table.
    grip_height = min(max((0.55 + 0.2 * shares[0]) * thing.height_m, 0.045), 0.85 * thing.height_m)
    least = math.acos(min(1.0, grip_height / 0.058))
    elevation = max(math.radians(30 * shares[1]), least)
    left = bool(shares[2] < 0.5)
    elbow = 0.06 + 0.08 * shares[3]
    # The action begins early or late: a still in the middle of the clip may show any stage of it.
    least = min(_REST[0], max(0.0, 1 - _QUICKEST_S / duration_s))
    rest = least + shares[9] * (max(least, min(_REST[1], 1 - _QUICKEST_S / duration_s)) - least)
    return Cast(
        thing=thing,
        main=Actor(hand_size, left, math.radians(42 + 38 * shares[4]), elevation, elbow),
        second=Actor(hand_size, not left, math.radians(42 + 38 * shares[5]), elevation, elbow),
        manner=draw_manner(rng),
        spot_m=np.array([0.085 * (2 * shares[6] - 1), 0.04 * (2 * shares[7] - 1)]),
        aloft_m=0.055 + 0.045 * shares[8],
        grip_height_m=grip_height,
        to_viewer=to_viewer,
        duration_s=duration_s,
        margins=(rest * shares[10], rest * (1 - shares[10])),
        tremor_m=0.0006 + 0.0012 * shares[12],
        grain_m=0.0065 + 0.003 * shares[11],
        luck=rng.random(48),
    )
