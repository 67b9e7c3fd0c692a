"""The bones of a right hand: rest joints, poses as joint angles, forward kinematics, and grips of a wanted width.

Hand axes: origin at the wrist, x along the stretched fingers, y towards the thumb, z out of the back of the hand; metres.
The sizes are those of an adult's hand (0.19 m from wrist to middle fingertip; Buryanov and Kotiuk, Int. J. Morphol. 2010).
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.motion import rotation
from scenes.surfaces import unit

Array = NDArray[np.float64]

FOREARM_M = 0.55
"""Elbow side of the forearm: longer than anatomy (a sleeve goes on), so that its end stays out of the picture."""

FINGERS = ("thumb", "index", "middle", "ring", "little")
# Where each finger's first bone starts, and how long its three bones are.
_ROOTS_M = np.array(
    [
        (0.021, 0.025, -0.010),
        (0.088, 0.026, 0.001),
        (0.092, 0.005, 0.004),
        (0.086, -0.015, 0.002),
        (0.076, -0.034, -0.003),
    ]
)
_LENGTHS_M = np.array(
    [(0.043, 0.031, 0.024), (0.042, 0.024, 0.019), (0.046, 0.028, 0.020), (0.042, 0.026, 0.020), (0.033, 0.020, 0.017)]
)
# Fingers are spread at rest, so that their surfaces do not grow together.
_SPREAD_RAD = np.radians([0.0, 11.0, 2.0, -8.0, -18.0])
PAD_M = np.array([0.0085, 0.0072, 0.0074, 0.0070, 0.0060])
"""Radii of the fingertips, thumb first."""


def _rest_frames() -> Array:
    """Axes of each finger at rest as columns ``(5, 3, 3)``: along it, its flexion axis, its back."""
    fingers = [rotation([0, 0, 1], angle) for angle in _SPREAD_RAD[1:]]
    along = unit(np.array([0.74, 0.62, -0.25]))
    back = unit(np.cross(along, [0.15, -0.1, -1.0]))
    return np.stack([np.column_stack([along, np.cross(back, along), back]), *fingers])


REST_FRAMES = _rest_frames()


@dataclass(frozen=True)
class Bones:
    """Where the 17 bones are: forearm, palm, then three for each finger from its root, thumb first.

    Attributes:
        starts_m: ``(17, 3)`` their near joints; forearm and palm start at the wrist.
        ends_m: ``(17, 3)`` their far ends; the palm's is the root of the middle finger.
        turns: ``(17, 3, 3)`` rotations from the rest pose.
    """

    starts_m: Array
    ends_m: Array
    turns: Array

    def tip_m(self, finger: int) -> Array:
        """Return the end of a finger's last bone."""
        return self.ends_m[4 + 3 * finger]

    def pad_m(self, finger: int) -> Array:
        """Return the middle of a fingertip's gripping side."""
        last = 4 + 3 * finger
        palmar = -self.turns[last] @ REST_FRAMES[finger][:, 2]
        return 0.3 * self.starts_m[last] + 0.7 * self.ends_m[last] + PAD_M[finger] * palmar


def pose_bones(angles_rad: Array, elbow: Array | None = None) -> Bones:
    """Place the bones of a right hand in its own axes.

    Args:
        angles_rad: ``(5, 4)``: for each finger a turn at its root (of the thumb: opposition about the hand's x axis, of the
            others: abduction towards the thumb), then the flexion of its three joints.
        elbow: unit direction from wrist to elbow in hand axes; None for straight.
    """
    starts, ends, turns = np.zeros((17, 3)), np.zeros((17, 3)), np.tile(np.eye(3), (17, 1, 1))
    if elbow is not None:
        turns[0] = between(np.array([-1.0, 0, 0]), elbow)
    ends[0] = turns[0] @ (-FOREARM_M, 0.0, 0.0)
    ends[1] = _ROOTS_M[2]
    for finger in range(5):
        rest = REST_FRAMES[finger]
        aside = rotation([1, 0, 0] if finger == 0 else [0, 0, 1], (-1 if finger == 0 else 1) * angles_rad[finger, 0])
        frame, joint = aside @ rest, _ROOTS_M[finger]
        for bone in range(3):
            frame = frame @ _flexion(angles_rad[finger, 1 + bone])
            number = 2 + 3 * finger + bone
            starts[number], turns[number] = joint, frame @ rest.T
            joint = joint + _LENGTHS_M[finger, bone] * frame[:, 0]
            ends[number] = joint
    return Bones(starts, ends, turns)


def _flexion(angle_rad: float) -> Array:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def between(start: Array, end: Array) -> Array:
    """Return the smallest rotation from one unit vector to another."""
    axis = np.cross(start, end)
    if np.linalg.norm(axis) < 1e-9:
        across = np.cross(start, np.eye(3)[np.argmin(np.abs(start))])
        return np.eye(3) if start @ end > 0 else rotation(across, np.pi)
    return rotation(axis, float(np.arctan2(np.linalg.norm(axis), start @ end)))


def _pose(*rows: tuple[float, float, float, float]) -> Array:
    return np.radians(np.array(rows, dtype=float))


OPEN = _pose((25, 0, 5, 5), (0, 8, 10, 5), (0, 6, 10, 5), (0, 8, 12, 6), (2, 10, 14, 8))
RELAXED = _pose((35, 5, 15, 15), (-4, 22, 30, 15), (0, 28, 34, 18), (4, 32, 36, 20), (8, 35, 36, 20))
POINTING = _pose((60, 15, 35, 30), (-6, 4, 6, 3), (-2, 80, 95, 50), (5, 84, 95, 50), (11, 86, 92, 50))
_CLOSED = _pose((88, -10, 2, 24), (-9, 59, 48, 25), (-2, 61, 48, 25), (6, 63, 50, 25), (13, 65, 52, 25))
_WIDE = _pose((82, -34, 2, 6), (-5, 14, 26, 14), (0, 14, 26, 14), (4, 16, 28, 15), (8, 18, 30, 16))
_GRIP_FINGERS = (1, 2, 3)


@dataclass(frozen=True)
class Grip:
    """A grip between thumb and fingers, in hand axes.

    Attributes:
        angles_rad: ``(5, 4)`` of `pose_bones`.
        centre_m: middle between the thumb's pad and the fingers' pads.
        axis: unit vector from the thumb to the fingers.
        approach: unit vector across the axis, from the hand towards what it grips.
    """

    angles_rad: Array
    centre_m: Array
    axis: Array
    approach: Array


def grip_angles(openness: float) -> Array:
    """Return the joint angles of a grip: 0 closed as in a pinch, 1 as wide as it goes."""
    return _CLOSED + openness * (_WIDE - _CLOSED)


def _pads(angles_rad: Array) -> tuple[Array, Array]:
    bones = pose_bones(angles_rad)
    return bones.pad_m(0), np.mean([bones.pad_m(finger) for finger in _GRIP_FINGERS], axis=0)


@functools.cache
def _grip_widths() -> tuple[Array, Array]:
    """Return openness and the width between the pads, for a fine range of grips."""
    openness = np.linspace(0, 1, 41)
    widths = [float(np.linalg.norm(np.subtract(*_pads(grip_angles(share))))) for share in openness]
    return openness, np.array(widths)


def widest_grip_m() -> float:
    """Return the greatest width that a hand of size 1 can grip."""
    return float(_grip_widths()[1][-1])


@functools.lru_cache(maxsize=64)
def grip(width_m: float) -> Grip:
    """Return the grip whose pads are ``width_m`` apart: at least 8 mm, since pads are soft, and as far as the hand gets."""
    width_m = max(width_m, 0.008)
    openness, widths = _grip_widths()
    angles = grip_angles(float(np.interp(width_m, widths, openness)))
    thumb, fingers = _pads(angles)
    centre, axis = (thumb + fingers) / 2, unit(fingers - thumb)
    approach = unit(np.array([1.0, 0, 0]) - axis[0] * axis)
    return Grip(angles, centre, axis, approach)
