"""The kinds of fast motion: each is a function that casts the actors of a clip.

Speeds follow from the picture: over the clip a thing crosses a drawn share of the view's width, or makes a drawn number of
turns or beats, whatever the frame rate. Gravity is scaled alike: it is what makes the drawn fall last as long as it does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from scenes.fast.actors import Act, Actor, Course, cast, jointed, rigid, soft
from scenes.fast.bodies import bodies
from scenes.fast.courses import draw_depth, draw_line, draw_spot, floor_depth, straight, swaying, tumbling
from scenes.fast.deform import Bend, Soft, bowing, flapping, jelly, pulsing, rippling, sheet, twisting
from scenes.fast.figures import FIGURES, draw_figure
from scenes.fast.impacts import bouncing, collision
from scenes.meshes import UnitMesh
from scenes.motion import random_rotation, rotation

Array = NDArray[np.float64]
Event = Literal["translation", "rotation", "articulation", "deformation", "bouncing", "collision", "occlusion"]
EVENTS: tuple[Event, ...] = get_args(Event)
MOST_ACTORS = 5
_MOST_BODIES = 4


def cast_event(event: Event, act: Act) -> list[Actor]:
    """Return the actors of an event: at least one, at most `MOST_ACTORS`."""
    return _CASTS[event](act)


def _pick(rng: np.random.Generator, meshes: Sequence[UnitMesh]) -> UnitMesh:
    return meshes[int(rng.integers(len(meshes)))]


def _fixed(turn: Array) -> Course:
    return lambda _: turn


def _beats(act: Act, least: float, most: float) -> tuple[Callable[[float], float], float]:
    """Return a phase that runs evenly through some beats in the clip, and its beats per second."""
    rate = act.rng.uniform(least, most) / act.duration_s
    first = act.rng.uniform(0, 2 * math.pi)
    return lambda time: first + 2 * math.pi * rate * time, rate


def _flyer(
    act: Act, shrink: float, size: tuple[float, float], share: tuple[float, float], depths: tuple[float, float]
) -> Actor:
    """Return a body that flies straight, turning little."""
    radius, depth = draw_depth(act, size, shrink, depths)
    course = straight(*draw_line(act, depth, radius, share), act.duration_s)
    tumble = tumbling(act, (0.0, 0.12))
    facts = {"speed_m_s": act.mean_speed(course)}
    return rigid("body", _pick(act.rng, bodies()), radius, course, tumble.turn, facts=facts)


def _translation(act: Act) -> list[Actor]:
    """Bodies that cross a share of the picture in straight lines."""

    def propose(shrink: float, number: int) -> list[Actor]:
        share = (0.45, 1.0) if number == 0 else (0.2, 1.0)
        return [_flyer(act, shrink, (0.35, 0.65) if number == 0 else (0.2, 0.5), share, (0, 1))]

    return cast(act, int(act.rng.integers(1, _MOST_BODIES + 1)), propose)


def _rotation(act: Act) -> list[Actor]:
    """Free tops: long or flat bodies that tumble as the laws of motion have it, drifting a little."""

    def propose(shrink: float, number: int) -> list[Actor]:
        rng = act.rng
        radius, depth = draw_depth(act, (0.45, 0.85) if number == 0 else (0.25, 0.55), shrink)
        course = swaying(act, draw_spot(act, depth, radius), rng.uniform(0.0, 0.25))
        stretch = rng.choice([1.0, rng.uniform(0.35, 0.7)])
        axis = bool(rng.random() < 0.5)
        size = radius * np.array([stretch, 1, stretch] if axis else [1, stretch, 1])
        # The moments of inertia of an ellipsoid with these axes.
        ratio = (1 + stretch**2) / (2 * stretch**2) if axis else (1 + stretch**2) / 2
        # A rod precesses slowly and spins fast: limit both.
        tumble = tumbling(act, (0.35, 1.6 if ratio < 2 else 0.9), ratio)
        facts = {"speed_m_s": act.mean_speed(course), "turns_per_s": tumble.rate_rad_s / (2 * math.pi)}
        return [rigid("top", _pick(rng, bodies()), size, course, tumble.turn, facts=facts)]

    return cast(act, int(act.rng.integers(1, 4)), propose)


def _articulation(act: Act) -> list[Actor]:
    """Figures of rigid links whose joints move."""
    rng = act.rng
    kinds = rng.choice(FIGURES, int(rng.integers(1, 4)))
    figures = [draw_figure(str(kind), rng) for kind in kinds]

    def propose(shrink: float, number: int) -> list[Actor]:
        kind, figure = str(kinds[number]), figures[number]
        phase, rate = _beats(act, 0.8, 2.0)
        size = (0.85, 1.15) if number == 0 else (0.5, 0.85)
        radius, depth = draw_depth(act, size, shrink)
        # Seen from about the side, going right or left.
        turn = rotation([0, 1, 0], math.pi * rng.integers(2) + rng.uniform(-0.5, 0.5))
        grounded = kind == "runner"
        if grounded:
            relative = radius / depth
            depth = floor_depth(act, relative)
            radius = relative * depth
            ahead = turn[:, 0] * (1, 0, 0.4)
            step = rng.uniform(0.1, 0.3) * act.room.view.tan_half_width * depth * ahead
            spot = act.room.place((rng.uniform(-0.4, 0.4), 0), depth) * (1, 0, 1)
            spot[1] = act.room.floor_m - radius * figure.lowest
            reach = ((-np.inf, -np.inf, act.room.near_m + radius), (np.inf, np.inf, act.room.wall_m - radius))
            course = straight(np.clip(spot - step, *reach), np.clip(spot + step, *reach), act.duration_s)
        elif kind == "bird":
            course = straight(*draw_line(act, depth, radius, (0.15, 0.6)), act.duration_s)
            ahead = course(act.duration_s) - course(0.0)
            heading = math.atan2(-float(ahead[2]) * 0.5, float(ahead[0]))
            turn = rotation([0, 1, 0], heading) @ rotation([1, 0, 0], rng.uniform(-0.6, 0.6))
        else:
            course = swaying(act, draw_spot(act, depth, radius), rng.uniform(0.0, 0.35))
            turn = turn @ rotation([0, 0, 1], rng.uniform(-math.pi, math.pi))
        turns_per_s = 0.0 if kind in ("runner", "bird") else float(rng.normal(0, 0.15)) / act.duration_s

        def turned(time: float) -> Array:
            return rotation([0, 0, 1], 2 * math.pi * turns_per_s * time) @ turn

        facts = {"speed_m_s": act.mean_speed(course), "beats_per_s": rate, "turns_per_s": turns_per_s}
        return [jointed(kind, figure, radius, course, turned, phase, facts=facts, grounded=grounded)]

    return cast(act, len(figures), propose)


def _deformation(act: Act) -> list[Actor]:
    """Soft bodies and sheets that change their form."""
    flags = int(act.rng.random() < 0.5)

    def propose(shrink: float, number: int) -> list[Actor]:
        rng = act.rng
        if number < flags:
            return [_cloth(act, shrink)]
        radius, depth = draw_depth(act, (0.5, 0.85) if number == 0 else (0.3, 0.6), shrink)
        name, bend = _draw_bend(rng)
        phase, rate = _beats(act, 0.8, 2.2)
        # Fine triangles bend; the bodies of few large ones would show their edges move.
        mesh = _pick(rng, [body for body in bodies() if len(body.faces) > 300])
        course = swaying(act, draw_spot(act, depth, radius), rng.uniform(0.0, 0.35))
        tumble = tumbling(act, (0.0, 0.15))
        facts = {"speed_m_s": act.mean_speed(course), "beats_per_s": rate}
        return [soft(name, Soft(mesh, bend), radius, course, tumble.turn, phase, facts=facts)]

    return cast(act, flags + int(act.rng.integers(1 - flags, 4 - flags)), propose)


def _draw_bend(rng: np.random.Generator) -> tuple[str, Bend]:
    kind = int(rng.integers(4))
    if kind == 0:
        return "pulsing body", pulsing(rng.uniform(0.3, 0.6))
    if kind == 1:
        return "jelly", jelly(random_rotation(rng)[:2], rng.uniform(0.2, 0.4))
    if kind == 2:
        return "twisting body", twisting(rng.uniform(0.6, 1.3))
    return "bowing body", bowing(rng.uniform(0.9, 1.9))


def _cloth(act: Act, shrink: float) -> Actor:
    """Return a flag that flaps, or a free sheet that flutters across the picture."""
    rng = act.rng
    radius, depth = draw_depth(act, (0.7, 1.0), shrink)
    phase, rate = _beats(act, 0.8, 2.2)
    # Never square to the camera, where waves would be seen by their shading only.
    turn = rotation([0, 1, 0], rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 1.0) + math.pi * rng.integers(2))
    mesh = sheet(13, 21, rng.uniform(0.5, 0.9))
    if rng.random() < 0.5:
        bend = flapping(rng.uniform(0.2, 0.35), rng.uniform(0.7, 1.4), rng.normal(0, 0.6))
        course = swaying(act, draw_spot(act, depth, radius), rng.uniform(0.0, 0.1))
        name = "flag"
    else:
        bend = rippling(rng.uniform(0.15, 0.35), rng.uniform(0.4, 1.1), rng.normal(0, 0.8))
        course = straight(*draw_line(act, depth, radius, (0.15, 0.5)), act.duration_s)
        turn = rotation([0, 0, 1], rng.uniform(-0.8, 0.8)) @ turn @ rotation([1, 0, 0], rng.uniform(-1.1, 1.1))
        name = "sheet"
    facts = {"speed_m_s": act.mean_speed(course), "beats_per_s": rate}
    return soft(name, Soft(mesh, bend), radius, course, _fixed(turn), phase, facts=facts)


def _occlusion(act: Act) -> list[Actor]:
    """Bodies in different depths whose ways cross in the picture, so that the nearer hide the farther."""
    rng, room = act.rng, act.room
    crossing = rng.uniform((-0.3, -0.3), (0.3, 0.15))
    count = int(rng.integers(2, _MOST_BODIES + 1))
    towards = rng.choice([-1.0, 1.0])

    def propose(shrink: float, number: int) -> list[Actor]:
        # From the nearest to the farthest, each in its own part of the depths.
        layers = (1 - (number + 1) / count, 1 - (number + 0.4) / count)
        radius, depth = draw_depth(act, (0.35, 0.6), shrink, layers)
        length = rng.uniform(0.15, 0.35) if number == 0 and rng.random() < 0.3 else rng.uniform(0.4, 0.9)
        angle = rng.normal(0, 0.35)
        aspect = room.view.shape[1] / room.view.shape[0]
        step = towards * (-1) ** number * length * np.array([math.cos(angle), aspect * math.sin(angle)])
        meeting = rng.uniform(0.35, 0.65)
        lowest = (room.floor_m - radius) / (room.half[1] * depth)
        middle = crossing + rng.normal(0, 0.06, 2)
        middle[1] = min(middle[1], lowest - 1.3 * abs(step[1]))
        ends = (middle - 2 * step * meeting, middle + 2 * step * (1 - meeting))
        course = straight(room.place(ends[0], depth), room.place(ends[1], depth), act.duration_s)
        tumble = tumbling(act, (0.0, 0.35))
        facts = {"speed_m_s": act.mean_speed(course)}
        return [rigid("body", _pick(rng, bodies()), radius, course, tumble.turn, facts=facts)]

    return cast(act, count, propose)


_CASTS: dict[Event, Callable[[Act], list[Actor]]] = {
    "translation": _translation,
    "rotation": _rotation,
    "articulation": _articulation,
    "deformation": _deformation,
    "bouncing": bouncing,
    "collision": collision,
    "occlusion": _occlusion,
}
