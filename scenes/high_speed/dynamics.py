"""Bodies under the laws of motion, in closed form: free tumbling, bouncing with squash, and balls that collide.

Nothing is stepped: a position is exact at any time, so that a clip's frame rate changes when it is looked at, not what
happens.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.layout import rotation
from simulator.errors import InputError

Array = NDArray[np.float64]
_MOST_IMPACTS = 1000


@dataclass(frozen=True)
class Tumble:
    """Torque-free motion of a body that is symmetric about its own y axis (Landau and Lifshitz, Mechanics, section 33).

    The axis precesses evenly about the angular momentum, while the body turns about the axis.

    Attributes:
        start: rotation matrix ``(3, 3)`` from the body's axes to the world's at time 0.
        momentum: direction ``(3,)`` of the angular momentum.
        rate_rad_s: angular momentum over the transverse moment of inertia: how fast the axis precesses.
        inertia_ratio: transverse moment of inertia over the axial one: 1 for a ball, above 1 for a rod, 0.5 for a disc.
    """

    start: Array
    momentum: Array
    rate_rad_s: float
    inertia_ratio: float = 1.0

    def turn(self, time_s: float) -> Array:
        """Return the rotation matrix from the body's axes to the world's at a time."""
        momentum = self.momentum / np.linalg.norm(self.momentum)
        spin = self.rate_rad_s * (self.inertia_ratio - 1) * float(momentum @ self.start[:, 1])
        return rotation(momentum, self.rate_rad_s * time_s) @ self.start @ rotation([0, 1, 0], spin * time_s)


@dataclass(frozen=True)
class Bounce:
    """The height of a body that falls on a floor again and again, made by `bounce`.

    Attributes:
        starts_s: when each phase begins; flights and contacts alternate, the first is a flight.
        heights_m: height at the beginning of each phase, of the lowest point above the floor.
        speeds_m_s: upward speed at the beginning of each phase.
        gravity_m_s2: downward acceleration in flight.
        restitution: speed after an impact over speed before.
        contact_s: how long each contact lasts.
    """

    starts_s: Array
    heights_m: Array
    speeds_m_s: Array
    gravity_m_s2: float
    restitution: float
    contact_s: float

    def height(self, time_s: float) -> float:
        """Return how far the undeformed body's lowest point is above the floor; negative where the body is squashed."""
        phase = max(int(np.searchsorted(self.starts_s, time_s, side="right")) - 1, 0)
        elapsed = time_s - float(self.starts_s[phase])
        speed = float(self.speeds_m_s[phase])
        if phase % 2 == 0:
            return float(self.heights_m[phase]) + speed * elapsed - 0.5 * self.gravity_m_s2 * elapsed**2
        # A damped spring, whose damping is what the restitution asks for.
        beat, decay = math.pi / self.contact_s, -math.log(self.restitution) / self.contact_s
        return speed / beat * math.exp(-decay * elapsed) * math.sin(beat * elapsed)


def bounce(
    height_m: float, speed_m_s: float, *, gravity_m_s2: float, restitution: float, contact_s: float, duration_s: float
) -> Bounce:
    """Follow a bouncing body: parabolas, and between them contacts on a damped spring, so that its speed never jumps.

    Args:
        height_m: of its lowest point above the floor at time 0, not negative.
        speed_m_s: upward at time 0.
        gravity_m_s2: downward, positive.
        restitution: above 0, at most 1: speed after an impact over speed before.
        contact_s: length of a contact; the deepest squash is close to impact speed x contact / pi.
        duration_s: how far ahead to look.
    """
    starts, heights, speeds = [0.0], [height_m], [speed_m_s]
    while starts[-1] <= duration_s:
        impact = math.sqrt(speeds[-1] ** 2 + 2 * gravity_m_s2 * heights[-1])
        landing = starts[-1] + (speeds[-1] + impact) / gravity_m_s2
        starts += [landing, landing + contact_s]
        heights += [0.0, 0.0]
        speeds += [-impact, restitution * impact]
    return Bounce(np.array(starts), np.array(heights), np.array(speeds), gravity_m_s2, restitution, contact_s)


@dataclass(frozen=True)
class Balls:
    """Smooth balls at one moment: centres ``(N, 3)`` metres, velocities ``(N, 3)`` m/s, radii and masses ``(N,)``."""

    centres_m: Array
    velocities_m_s: Array
    radii_m: Array
    masses_kg: Array


@dataclass(frozen=True)
class Plane:
    """A hard, fixed plane: balls stay where ``normal @ point >= offset_m``; ``normal`` has length 1."""

    normal: Array
    offset_m: float


@dataclass(frozen=True)
class Billiard:
    """Where colliding balls are at any time, made by `collide`.

    Attributes:
        starts_s: ``(P,)`` times from which the balls fly freely: 0, then each impact.
        states: the balls at those times, right after the impact.
        acceleration_m_s2: ``(3,)`` of all balls in flight.
    """

    starts_s: Array
    states: tuple[Balls, ...]
    acceleration_m_s2: Array

    def at(self, time_s: float) -> Balls:
        """Return the balls at a time from 0 on."""
        phase = max(int(np.searchsorted(self.starts_s, time_s, side="right")) - 1, 0)
        return _flown(self.states[phase], self.acceleration_m_s2, time_s - float(self.starts_s[phase]))


def collide(
    balls: Balls,
    *,
    duration_s: float,
    restitution: float = 1.0,
    planes: Sequence[Plane] = (),
    acceleration_m_s2: ArrayLike = (0.0, 0.0, 0.0),
) -> Billiard:
    """Follow balls from impact to impact; each is instant and without friction, as on an ideal billiard table.

    Args:
        balls: at time 0, apart from each other and on the planes' free sides.
        duration_s: how far ahead to look.
        restitution: speed at which two things part over that at which they met; with 1 no energy is lost.
        planes: fixed walls.
        acceleration_m_s2: the same for all balls, so that seen from each other they fly straight.

    Raises:
        InputError: after 1000 impacts, as under a ball that comes to rest by bouncing.
    """
    pull = np.asarray(acceleration_m_s2, dtype=float)
    starts, states = [0.0], [balls]
    while True:
        wait, impact = _next_impact(states[-1], planes, pull)
        if impact is None or starts[-1] + wait > duration_s:
            return Billiard(np.array(starts), tuple(states), pull)
        if len(starts) > _MOST_IMPACTS:
            raise InputError("collide", f"got over {_MOST_IMPACTS} impacts; shorten the duration or drop the pull")
        starts.append(starts[-1] + wait)
        states.append(_parted(_flown(states[-1], pull, wait), impact, restitution))


# An impact: the ball's number, the direction in which it is pushed, and the other ball's number or None for a plane.
_Impact = tuple[int, Array, int | None]


def _next_impact(balls: Balls, planes: Sequence[Plane], pull: Array) -> tuple[float, _Impact | None]:
    """Return how long until the next impact, and which; infinity and None when there is none."""
    first, found = math.inf, None
    for one in range(len(balls.radii_m)):
        for other in range(one):
            wait = _meeting(balls, one, other)
            if wait < first:
                first = wait
                apart = _flown(balls, pull, wait).centres_m
                offset = apart[one] - apart[other]
                found = (one, offset / np.linalg.norm(offset), other)
        for plane in planes:
            gap = float(plane.normal @ balls.centres_m[one]) - plane.offset_m - float(balls.radii_m[one])
            wait = _landing(gap, float(plane.normal @ balls.velocities_m_s[one]), float(plane.normal @ pull))
            if wait < first:
                first, found = wait, (one, plane.normal, None)
    return first, found


def _meeting(balls: Balls, one: int, other: int) -> float:
    """Return when two balls touch; infinity when they do not, or only part."""
    offset = balls.centres_m[one] - balls.centres_m[other]
    speed = balls.velocities_m_s[one] - balls.velocities_m_s[other]
    closing = -float(offset @ speed)
    gap = float(offset @ offset) - float(balls.radii_m[one] + balls.radii_m[other]) ** 2
    root = closing**2 - float(speed @ speed) * gap
    if closing <= 0 or root < 0:
        return math.inf
    return max(gap, 0.0) / (closing + math.sqrt(root))


def _landing(gap_m: float, speed_m_s: float, pull_m_s2: float) -> float:
    """Return when ``gap + speed t + pull t^2 / 2`` reaches zero from above; infinity when it does not."""
    gap_m = max(gap_m, 0.0)
    root = speed_m_s**2 - 2 * pull_m_s2 * gap_m
    if pull_m_s2 >= 0 and (speed_m_s >= 0 or root <= 0):
        return math.inf
    if speed_m_s <= 0:
        if gap_m == 0:
            return 0.0
        return 2 * gap_m / (math.sqrt(root) - speed_m_s)  # this form loses no digits
    return -(speed_m_s + math.sqrt(root)) / pull_m_s2


def _parted(balls: Balls, impact: _Impact, restitution: float) -> Balls:
    """Return the balls right after an impact: Newton's law along the line of centres."""
    one, push, other = impact
    velocities = balls.velocities_m_s.copy()
    if other is None:
        velocities[one] -= (1 + restitution) * (velocities[one] @ push) * push
    else:
        masses = balls.masses_kg[[one, other]]
        impulse = -(1 + restitution) * ((velocities[one] - velocities[other]) @ push) / (1 / masses).sum() * push
        velocities[one] += impulse / masses[0]
        velocities[other] -= impulse / masses[1]
    return replace(balls, velocities_m_s=velocities)


def _flown(balls: Balls, pull: Array, seconds: float) -> Balls:
    """Return the balls after a free flight."""
    centres = balls.centres_m + balls.velocities_m_s * seconds + 0.5 * pull * seconds**2
    return replace(balls, centres_m=centres, velocities_m_s=balls.velocities_m_s + pull * seconds)
