"""What actions are made of: hands that grip, point or rest, things that are held, fall or lie, courses in time.

All in the axes of the set (`scenes.activity.tabletop`): x right in the image, y down with the table at 0, z away.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scenes.activity.hand import PAD_M, RELAXED, HandLook, grip, pose_bones, posed_hand
from scenes.layout import rotation
from scenes.meshes import unit
from simulator.render import TriangleMesh

Array = NDArray[np.float64]
GRAVITY_M_S2 = 9.81
_UP = np.array([0.0, -1, 0])
_ARM_M = 0.6
# Wrists bend so that arms come in from about this far aside: else they would come too near to the camera.
_ARM_ASIDE_RAD = math.radians(82)
# Skin that would go into the table is pressed flat this high above it.
_SKIN_GAP_M = 5e-4


def minimum_jerk(share: ArrayLike) -> Array:
    """Return how far a reaching hand is, 0..1, after a share 0..1 of its time (Flash and Hogan, 1985); clipped outside.

    Example:
        >>> minimum_jerk([0.0, 0.5, 1.0]).tolist()
        [0.0, 0.5, 1.0]
    """
    t = np.clip(share, 0, 1)
    return t**3 * (10 - 15 * t + 6 * t**2)


def keyed(time_s: float, times_s: Sequence[float], values: ArrayLike) -> Array:
    """Return the value of a course that reaches from key to key in minimum-jerk movements and rests before and after.

    Example:
        >>> float(keyed(1.5, [1.0, 2.0, 3.0], [0.0, 4.0, 0.0]))
        2.0
    """
    stops = np.asarray(values, dtype=float)
    segment = int(np.clip(np.searchsorted(times_s, time_s) - 1, 0, len(times_s) - 2))
    span = times_s[segment + 1] - times_s[segment]
    share = minimum_jerk((time_s - times_s[segment]) / span)
    return np.asarray(stops[segment] + share * (stops[segment + 1] - stops[segment]))


def bounce_height(drop_m: float, time_s: float, restitution: float) -> float:
    """Return how high a thing is that was let go ``drop_m`` above the table, ``time_s`` ago, in the set's gravity.

    Each bounce keeps the share ``restitution`` of the speed; below 6 cm/s it stays down.
    """
    if drop_m <= 0:
        return 0.0
    landing = math.sqrt(2 * drop_m / GRAVITY_M_S2)
    if time_s < landing:
        return drop_m - 0.5 * GRAVITY_M_S2 * max(time_s, 0.0) ** 2
    time_s, speed = time_s - landing, restitution * GRAVITY_M_S2 * landing
    while speed > 0.06:
        if time_s < 2 * speed / GRAVITY_M_S2:
            return speed * time_s - 0.5 * GRAVITY_M_S2 * time_s**2
        time_s, speed = time_s - 2 * speed / GRAVITY_M_S2, restitution * speed
    return 0.0


@dataclass(frozen=True)
class Pose:
    """Where a thing (or half of it) is: ``turn`` (3, 3) from its own axes, ``place_m`` of its foot."""

    turn: Array
    place_m: Array


@dataclass(frozen=True)
class HandState:
    """A posed hand: ``frame`` (3, 3) holds its axes as columns (left-handed ones for a left hand)."""

    angles_rad: Array
    frame: Array
    wrist_m: Array
    shoulder_m: Array

    def mesh(self, look: HandLook) -> TriangleMesh:
        """Return the hand's surface; what would reach into the table is pressed flat on it."""
        mesh = self.unpressed(look)
        mesh.vertices_m[:, 1] = np.minimum(mesh.vertices_m[:, 1], -_SKIN_GAP_M)
        return mesh

    def unpressed(self, look: HandLook) -> TriangleMesh:
        """Return the hand's surface as if there were no table."""
        towards = unit(self.frame.T @ (self.shoulder_m - self.wrist_m))
        bones = pose_bones(self.angles_rad, _bent_at_most(towards, math.radians(85)))
        return posed_hand(look, bones, self.frame, self.wrist_m)


def _bent_at_most(elbow: Array, angle_rad: float) -> Array:
    """Limit the bend of the wrist: bring the elbow's direction to within an angle of the straight one, -x."""
    if -elbow[0] >= math.cos(angle_rad):
        return elbow
    aside = unit(np.array([0.0, elbow[1], elbow[2]]))
    return math.sin(angle_rad) * aside - np.array([math.cos(angle_rad), 0, 0])


def between_states(start: HandState, end: HandState, share: float) -> HandState:
    """Return a hand on its way from one state to another of the same side, turning about a fixed axis."""
    relative = end.frame @ start.frame.T
    angle = math.acos(float(np.clip((np.trace(relative) - 1) / 2, -1, 1)))
    axis = np.array([relative[2, 1] - relative[1, 2], relative[0, 2] - relative[2, 0], relative[1, 0] - relative[0, 1]])
    turn = rotation(axis, share * angle) if np.linalg.norm(axis) > 1e-9 else np.eye(3)
    return HandState(
        start.angles_rad + share * (end.angles_rad - start.angles_rad),
        turn @ start.frame,
        start.wrist_m + share * (end.wrist_m - start.wrist_m),
        start.shoulder_m + share * (end.shoulder_m - start.shoulder_m),
    )


@dataclass(frozen=True)
class Actor:
    """A hand and the arm's way into the image.

    Attributes:
        size: of the hand, 1 for 0.19 m.
        left: whether it is a left hand; it comes from the viewer's left.
        azimuth_rad: by which the arm comes from the side: 0 is from the viewer, pi / 2 from the side.
        elevation_rad: by which the hand points down at what it grips.
        elbow_m: height of the arm above the table, 0.6 m from the hand.
    """

    size: float
    left: bool
    azimuth_rad: float
    elevation_rad: float
    elbow_m: float

    @property
    def side(self) -> float:
        """Where the hand comes from: 1 for the right, -1 for the left."""
        return -1.0 if self.left else 1.0

    @property
    def forwards(self) -> Array:
        """The horizontal direction from the arm to what is gripped."""
        return np.array([-self.side * math.sin(self.azimuth_rad), 0, math.cos(self.azimuth_rad)])

    @property
    def axis(self) -> Array:
        """The horizontal direction from the thumb to the fingers of a gripping hand."""
        x, _, z = self.forwards
        return self.side * np.array([z, 0, -x])

    @property
    def upright(self) -> Array:
        """Axes of a thing that is gripped across its width."""
        return np.column_stack([self.side * self.axis, [0.0, 1, 0], self.forwards])

    def shoulder(self, point_m: Array) -> Array:
        """Return where the arm comes from when the hand works at a point."""
        aside = _ARM_ASIDE_RAD + 0.35 * (self.azimuth_rad - _ARM_ASIDE_RAD)
        place = point_m + _ARM_M * np.array([self.side * math.sin(aside), 0, -math.cos(aside)])
        return np.array([place[0], -self.elbow_m, place[2]])

    def gripping(self, point_m: Array, width_m: float, shoulder_m: Array, turn: Array | None = None) -> HandState:
        """Return the hand whose thumb's and fingers' pads, ``width_m`` apart, have their middle at a point.

        The arm comes from ``shoulder_m`` (of `shoulder`, for a fixed point of the action); hand and thing are turned
        about the point.
        """
        held = grip(width_m / self.size)
        approach = math.cos(self.elevation_rad) * self.forwards - math.sin(self.elevation_rad) * _UP
        frame = self._frame((held.approach, held.axis), (approach, self.axis))
        frame = frame if turn is None else turn @ frame
        return HandState(held.angles_rad, frame, point_m - self.size * frame @ held.centre_m, shoulder_m)

    def pointing(self, tip_m: Array, shoulder_m: Array, elevation_rad: float, angles_rad: Array) -> HandState:
        """Return the hand, its joints at ``angles_rad``, whose index fingertip touches a point from the arm's side."""
        bones = pose_bones(angles_rad)
        along = unit(bones.ends_m[7] - bones.starts_m[5])
        tip = bones.tip_m(1) + PAD_M[1] * along
        approach = math.cos(elevation_rad) * self.forwards - math.sin(elevation_rad) * _UP
        back = math.sin(elevation_rad) * self.forwards + math.cos(elevation_rad) * _UP
        frame = self._frame((along, unit(np.array([0, 0, 1.0]) - along[2] * along)), (approach, back))
        return HandState(angles_rad, frame, tip_m - self.size * frame @ tip, shoulder_m)

    def resting(self, wrist_m: Array) -> HandState:
        """Return the hand that lies on the table, palm down."""
        frame = self._frame((np.array([1.0, 0, 0]), np.array([0, 0, 1.0])), (self.forwards, _UP))
        return HandState(RELAXED, frame, wrist_m, self.shoulder(wrist_m))

    def _frame(self, own: tuple[Array, Array], wanted: tuple[Array, Array]) -> Array:
        """Return the axes that bring two directions of the hand (at right angles) to two of the set."""
        mirror = np.diag([1.0, -1.0, 1.0]) if self.left else np.eye(3)
        first, second = mirror @ own[0], mirror @ own[1]
        source = np.column_stack([first, second, np.cross(first, second)])
        target = np.column_stack([*wanted, np.cross(*wanted)])
        return target @ source.T @ mirror
