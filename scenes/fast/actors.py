"""Who acts in a clip: things with a course in time, and the rules by which courses are accepted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.fast.deform import Soft
from scenes.fast.figures import Figure
from scenes.fast.rooms import Room
from scenes.meshes import UnitMesh
from scenes.motion import placed
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
    """What all events are told.

    Attributes:
        room: the space.
        duration_s: length of the clip.
        rng: decides everything.
    """

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
        """Whether actors stay in the room, are in the picture most of the time, and run into no others."""
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

    Args:
        act: the stage.
        count: how many times to propose.
        propose: from a factor of size that shrinks with every refusal, and how many proposals came before, to a group; an
            empty one is a refusal.
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


def soft(name: str, body: Soft, size_m: float, centre: Course, turn: Course, phase: Phase, **more: Any) -> Actor:
    """Return a soft body whose farthest reach over all phases is ``size_m``."""
    scale = size_m / body.reach()

    def shape(time: float, material: Material) -> TriangleMesh:
        return body.placed(phase(time), material, centre(time), scale, turn(time))

    return Actor(name, size_m, centre, shape, **more)


def jointed(name: str, figure: Figure, size_m: float, centre: Course, turn: Course, phase: Phase, **more: Any) -> Actor:
    """Return a figure of links that fits into a ball of radius ``size_m``."""

    def shape(time: float, material: Material) -> TriangleMesh:
        return figure.placed(phase(time), material, centre(time), size_m, turn(time))

    return Actor(name, size_m, centre, shape, **more)
