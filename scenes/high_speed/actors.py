"""Who acts in a clip: things with a course in time, and the draws of their size, depth, place and course that fit a room."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.high_speed.bodies import Soft
from scenes.high_speed.dynamics import Tumble
from scenes.high_speed.figures import Figure
from scenes.high_speed.rooms import Room
from scenes.layout import random_rotation
from scenes.meshes import UnitMesh, placed
from simulator.render import Material, TriangleMesh

Array = NDArray[np.float64]
Course = Callable[[float], Array]
"""A time in seconds to a place (3,) in metres, or to a rotation matrix (3, 3)."""
Phase = Callable[[float], float]
"""A time in seconds to radians."""

_CHECKED = 48
_IN_VIEW = 0.7


@dataclass(frozen=True)
class Actor:
    """A thing with a course in time.

    Attributes:
        name: what it is, for the sample's metadata.
        radius_m: none of its vertices is farther from its centre.
        centre: where it is.
        shape: time and material to the surface in the scene.
        facts: what is known of its motion, JSON-serialisable.
        grounded: whether it stands or lands on the floor, and so is not kept above it.
        still: whether it never moves.
    """

    name: str
    radius_m: float
    centre: Course
    shape: Callable[[float, Material], TriangleMesh]
    facts: dict[str, Any] = field(default_factory=dict)
    grounded: bool = False
    still: bool = False


@dataclass(frozen=True)
class Act:
    """What all events are told: the space, the length of the clip, and the generator that decides everything."""

    room: Room
    duration_s: float
    rng: np.random.Generator

    def path(self, course: Course) -> Array:
        """Return places ``(n, 3)`` along a course, evenly in time from the clip's beginning to its end."""
        return np.array([course(float(time)) for time in np.linspace(0, self.duration_s, _CHECKED)])

    def mean_speed(self, course: Course) -> float:
        """Return the length of a course over the clip's duration, m/s."""
        return float(np.linalg.norm(np.diff(self.path(course), axis=0), axis=1).sum() / self.duration_s)

    def accepts(self, group: Sequence[Actor], others: Sequence[Actor]) -> bool:
        """Whether actors stay in the room, are in the image most of the time, and run into no others."""
        paths = [self.path(actor.centre) for actor in group]
        for actor, path in zip(group, paths, strict=True):
            if not self.room.holds(path, actor.radius_m, above_floor=not actor.grounded):
                return False
            if self.room.seen(path).mean() < _IN_VIEW:
                return False
        for other in others:
            there = self.path(other.centre)
            for actor, path in zip(group, paths, strict=True):
                if np.linalg.norm(path - there, axis=1).min() < actor.radius_m + other.radius_m:
                    return False
        return True


def cast(act: Act, count: int, propose: Callable[[float, int], Sequence[Actor]]) -> list[Actor]:
    """Cast up to ``count`` actors or groups of actors, at least one; those who find no room are left out.

    ``propose`` makes a group from a factor of size that shrinks with every refusal and the number of proposals before; an
    empty group is a refusal.
    """
    chosen: list[Actor] = []
    for number in range(count):
        attempts = 30 if chosen else 300
        for attempt in range(attempts):
            group = propose(max(0.97**attempt, 0.05), number)
            if group and act.accepts(group, chosen):
                chosen += group
                break
    if not chosen:
        msg = f"no course fits into the room {act.room}"
        raise RuntimeError(msg)
    return chosen


def rigid(name: str, mesh: UnitMesh, size_m: Array | float, centre: Course, turn: Course, **more: Any) -> Actor:
    """Return a rigid body; ``size_m`` is metres per unit, one number or one for each of its axes."""
    size = np.broadcast_to(np.asarray(size_m, dtype=float), 3)

    def shape(time: float, material: Material) -> TriangleMesh:
        return placed(mesh, material, centre(time), size, turn(time))

    return Actor(name, float(size.max()), centre, shape, **more)


def moving(
    name: str, body: Soft | Figure, size_m: float, centre: Course, turn: Course, phase: Phase, **more: Any
) -> Actor:
    """Return a soft body or a figure of links whose farthest reach over all phases is ``size_m``."""
    scale = size_m / body.reach() if isinstance(body, Soft) else size_m  # figures fit into the unit ball

    def shape(time: float, material: Material) -> TriangleMesh:
        return body.placed(phase(time), material, centre(time), scale, turn(time))

    return Actor(name, size_m, centre, shape, **more)


# A ball that just fits still does after rounding.
_ROUNDING = 1e-9
# How far most ways across the image lean, standard deviation in radians.
_LEAN = 0.35


def draw_depth(
    act: Act, size: tuple[float, float], shrink: float, depths: tuple[float, float] = (0, 1)
) -> tuple[float, float]:
    """Draw a ball of a salient size: its radius and the depth of its centre, metres.

    ``size`` is the range of its radius in the image, as a share of half of the shorter edge; ``depths`` the part of the
    room's disparities that is used: 0 is at the wall, 1 is nearest.
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
    """Draw a straight way across the image that stays above the floor if it can: its first and last point.

    Three ways in four are about level, the others have any slope. ``share`` is the range of its length in the image, as a
    share of the width.
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
    """Draw a place in the image at which a ball is above the floor, if there is one in this depth."""
    room = act.room
    slack = np.maximum(spread - 0.7 * radius_m / (room.half * depth_m), 0.1)
    across = act.rng.uniform(-slack, slack)
    across[1] = min(across[1], (room.floor_m - radius_m) / (room.half[1] * depth_m))
    return room.place(across, depth_m)


def floor_depth(act: Act, radius_m_per_m: float) -> float:
    """Draw a depth in which a ball on the floor, of this radius per depth, is wholly in the image, if there is one."""
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
    """Draw a tumble about any axis, whose precession makes so many turns in the clip; for ``inertia_ratio`` see `Tumble`."""
    rate = 2 * math.pi * act.rng.uniform(*turns) / act.duration_s
    return Tumble(random_rotation(act.rng), random_rotation(act.rng)[0], rate, inertia_ratio)
