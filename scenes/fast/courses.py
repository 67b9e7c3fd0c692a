"""Draws of places, sizes and courses that fit a room: how large, how deep, how fast."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scenes.fast.actors import Act, Course
from scenes.fast.dynamics import Tumble
from scenes.motion import random_rotation

Array = NDArray[np.float64]
# A ball that just fits still does after rounding.
_ROUNDING = 1e-9
# How far most ways across the picture lean, standard deviation in radians.
_LEAN = 0.35


def draw_depth(
    act: Act, size: tuple[float, float], shrink: float, depths: tuple[float, float] = (0, 1)
) -> tuple[float, float]:
    """Draw a ball of a salient size: its radius and the depth of its centre, metres.

    Args:
        act: the stage.
        size: range of the radius in the picture, as a share of half of its shorter edge.
        shrink: a factor of it.
        depths: part of the room's disparities that is used: 0 is at the wall, 1 is nearest.
    """
    room = act.room
    # A ball of relative size s reaches from (1 - s) to (1 + s) of its depth; at most half of the room goes to one ball.
    root = math.sqrt(room.wall_m / room.near_m)
    relative = min(0.45, (root - 1) / (root + 1), shrink * float(room.half.min()) * act.rng.uniform(*size))
    farthest, nearest = (1 + relative) / room.wall_m, (1 - relative) / room.near_m
    share = act.rng.uniform(*depths)
    depth = 1 / (farthest + share * (nearest - farthest))
    return relative * depth, depth


def draw_line(act: Act, depth_m: float, radius_m: float, share: tuple[float, float]) -> tuple[Array, Array]:
    """Draw a straight way across the picture that stays above the floor if it can: its first and last point.

    Three ways in four are about level, the others have any slope.

    Args:
        act: the stage.
        depth_m: about the depth of its middle.
        radius_m: of what moves.
        share: range of its length in the picture, as a share of the width.
    """
    room, rng = act.room, act.rng
    length = rng.uniform(*share)
    angle = rng.normal(0, _LEAN) if rng.random() < 0.75 else rng.uniform(-math.pi / 2, math.pi / 2)
    aspect = room.view.shape[1] / room.view.shape[0]
    step = rng.choice([-1.0, 1.0]) * length * np.array([math.cos(angle), aspect * math.sin(angle)])
    lowest = min(0.75, (room.floor_m - radius_m) / (room.half[1] * depth_m))
    # Large things keep to the middle: half of their radius may be cut off.
    slack = np.maximum(1 - np.abs(step) - 0.5 * radius_m / (room.half * depth_m), 0.1)
    middle = rng.uniform(-slack, slack)
    middle[1] = min(middle[1], lowest - abs(step[1]))
    reach = (room.near_m + radius_m, room.wall_m - radius_m)
    towards = rng.normal(0, 0.1) * room.view.tan_half_width
    depths = np.clip(depth_m * np.exp(towards * np.array([-1, 1])), *reach)
    return room.place(middle - step, float(depths[0])), room.place(middle + step, float(depths[1]))


def draw_spot(act: Act, depth_m: float, radius_m: float, *, spread: float = 0.8) -> Array:
    """Draw a place in the picture at which a ball is above the floor, if there is one in this depth."""
    room = act.room
    slack = np.maximum(spread - 0.7 * radius_m / (room.half * depth_m), 0.1)
    across = act.rng.uniform(-slack, slack)
    across[1] = min(across[1], (room.floor_m - radius_m) / (room.half[1] * depth_m))
    return room.place(across, depth_m)


def floor_depth(act: Act, radius_m_per_m: float) -> float:
    """Draw a depth in which a ball that stands on the floor is wholly in the picture, if the room has one.

    Args:
        act: the stage.
        radius_m_per_m: radius of the ball over its depth.
    """
    room = act.room
    farthest = room.wall_m / (1 + radius_m_per_m) * (1 - _ROUNDING)
    nearest = min(max(1.15 * room.floor_begins_m, room.near_m / (1 - radius_m_per_m)), farthest)
    return float(act.rng.uniform(nearest, farthest))


def straight(start_m: Array, end_m: Array, duration_s: float) -> Course:
    """Return even motion from one point to another."""
    velocity = (end_m - start_m) / duration_s
    return lambda time: start_m + velocity * time


def swaying(act: Act, spot_m: Array, share: float) -> Course:
    """Return a slow drift around a place: over a share of the width in the whole clip, with a little depth."""
    angle = act.rng.uniform(0, 2 * math.pi)
    width = 2 * act.room.view.tan_half_width * spot_m[2]
    step = 0.5 * share * width * np.array([math.cos(angle), 0.5 * math.sin(angle), 0.3 * math.sin(2 * angle)])
    return straight(spot_m - step, spot_m + step, act.duration_s)


def tumbling(act: Act, turns: tuple[float, float], inertia_ratio: float = 1.0) -> Tumble:
    """Draw a tumble about any axis, of so many turns in the clip.

    Args:
        act: the stage.
        turns: range of the precession's turns.
        inertia_ratio: of the body, see `Tumble`.
    """
    rate = 2 * math.pi * act.rng.uniform(*turns) / act.duration_s
    return Tumble(random_rotation(act.rng), random_rotation(act.rng)[0], rate, inertia_ratio)
