"""The kinds of fast motion: each is a function that casts the actors of a clip.

Speeds follow from the image: over the clip a thing crosses a drawn share of the view's width, or makes a drawn number of
turns or beats, whatever the frame rate. Gravity is scaled alike: it is what makes the drawn fall last as long as it does.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from scenes.high_speed.actors import (
    Act,
    Actor,
    cast,
    draw_depth,
    draw_line,
    draw_spot,
    floor_depth,
    moving,
    rigid,
    straight,
    swaying,
    tumbling,
)
from scenes.high_speed.bodies import (
    Bend,
    Soft,
    body_library,
    bowing,
    flapping,
    jelly,
    pulsing,
    rippling,
    round_bodies,
    sheet,
    squash,
    twisting,
)
from scenes.high_speed.dynamics import Balls, Plane, bounce, collide
from scenes.high_speed.figures import FIGURES, draw_figure
from scenes.layout import random_rotation, rotation
from scenes.meshes import UnitMesh, placed
from simulator.render import Material, TriangleMesh

Array = NDArray[np.float64]
_MOST_BALLS = 4
# A ball that is squashed to half of its height is 1.42 times as wide.
_WIDEST = 1.43


def bouncing(act: Act) -> list[Actor]:
    """Balls that fall on the floor, are squashed and jump up again; one gravity for all."""
    rng, room = act.rng, act.room
    # From the horizon down to the floor a fall takes this share of the clip.
    gravity = 2 * room.floor_m / (rng.uniform(0.3, 0.65) * act.duration_s) ** 2

    def propose(shrink: float, number: int) -> list[Actor]:
        size = shrink * float(room.half.min()) * rng.uniform(*((0.25, 0.5) if number == 0 else (0.15, 0.35)))
        relative = min(size, 0.3, 0.5 * (room.wall_m / room.near_m - 1))
        depth = floor_depth(act, _WIDEST * relative)
        radius = min(relative * depth, 0.4 * room.floor_m)
        apex = rng.uniform(0.45, 0.9) * (room.floor_m + 0.7 * room.half[1] * depth - 2 * radius)
        # Some fall from their highest point, others are met on their way up or down.
        speed = rng.uniform(-0.8, 0.5) * math.sqrt(2 * gravity * apex)
        restitution = rng.uniform(0.6, 0.92)
        depth_of_squash = rng.uniform(0.2, 0.5) * radius
        flight = bounce(
            apex - speed**2 / (2 * gravity),
            speed,
            gravity_m_s2=gravity,
            restitution=restitution,
            contact_s=math.pi * depth_of_squash / math.sqrt(2 * gravity * apex),
            duration_s=act.duration_s,
        )
        step = rng.uniform(0.1, 0.45) * room.view.tan_half_width * depth * rng.choice([-1.0, 1.0])
        middle = rng.uniform(-0.5, 0.5) * room.view.tan_half_width * depth
        tumble = tumbling(act, (0.0, 0.5))
        mesh = round_bodies()[int(rng.integers(len(round_bodies())))]

        def ground(time: float) -> Array:
            return np.array([middle + step * (2 * time / act.duration_s - 1), room.floor_m, depth])

        def centre(time: float) -> Array:
            return ground(time) - (0, radius + flight.height(time), 0)

        def shape(time: float, material: Material) -> TriangleMesh:
            ball = placed(mesh, material, (0, 0, 0), radius, tumble.turn(time))
            stretch = min(1 + flight.height(time) / radius, 1.0)
            normals = squash(ball.normals, 1 / stretch)
            return TriangleMesh(
                vertices_m=centre(time) + squash(ball.vertices_m, stretch),
                normals=normals / np.linalg.norm(normals, axis=1, keepdims=True),
                uv=ball.uv,
                faces=ball.faces,
                material=material,
            )

        facts = {"speed_m_s": act.mean_speed(centre), "gravity_m_s2": gravity, "restitution": restitution}
        return [Actor("ball", _WIDEST * radius, centre, shape, facts=facts, grounded=True)]

    return cast(act, int(rng.integers(1, _MOST_BALLS + 1)), propose)


def collision(act: Act) -> list[Actor]:
    """Smooth balls that hit each other and the floor in a plane, with momentum kept, and energy if the restitution is 1."""
    rng, room = act.rng, act.room
    count = int(rng.integers(2, _MOST_BALLS + 1))
    pattern = str(rng.choice(["meeting", "break", "row"]))

    def propose(shrink: float, number: int) -> list[Actor]:
        _, depth = draw_depth(act, (0.2, 0.4), shrink)
        unit_m = shrink * float(room.half.min()) * depth
        radii = unit_m * rng.uniform(0.2, 0.4, count)
        if pattern == "row" or (count > 2 and rng.random() < 0.5):
            radii[1:] = radii[1]
        radii = np.minimum(radii, 0.45 * min(depth - room.near_m, room.wall_m - depth))
        spot = draw_spot(act, depth, 1.5 * float(radii.max()), spread=0.5)
        frame = _table(rng)
        places, speeds = _set_up(pattern, radii, rng)
        # In the image's plane: the shot crosses a share of the width until it hits, and hits in the first half.
        hit = rng.uniform(0.25, 0.5) * act.duration_s
        reach = rng.uniform(0.4, 0.9) * room.view.tan_half_width * depth
        velocities = speeds * reach / hit
        drift = np.array([rng.normal(0, 0.15), rng.normal(0, 0.05)]) * room.view.tan_half_width * depth / act.duration_s
        centres = places - velocities * hit
        restitution = 1.0 if rng.random() < 0.5 else float(rng.uniform(0.6, 1.0))
        balls = Balls(spot + centres @ frame, (velocities + drift) @ frame, radii, (radii / unit_m) ** 3)
        offsets = balls.centres_m[:, np.newaxis] - balls.centres_m
        gaps = np.linalg.norm(offsets, axis=-1) - radii - radii[:, np.newaxis]
        if gaps[np.triu_indices(count, 1)].min() < 0 or np.any(balls.centres_m[:, 1] + radii > room.floor_m):
            return []
        floor = Plane(np.array([0.0, -1, 0]), -room.floor_m)
        game = collide(balls, duration_s=act.duration_s, restitution=restitution, planes=(floor,))
        meshes = [round_bodies()[int(rng.integers(len(round_bodies())))] for _ in radii]
        impacts = len(game.starts_s) - 1

        def ball(one: int) -> Actor:
            def centre(time: float) -> Array:
                return game.at(time).centres_m[one]

            facts = {"speed_m_s": act.mean_speed(centre), "impacts_of_all": impacts, "restitution": restitution}
            turn = tumbling(act, (0.0, 0.4)).turn
            return rigid("ball", meshes[one], float(radii[one]), centre, turn, facts=facts)

        return [ball(one) for one in range(count)] if impacts else []

    return cast(act, 1, propose)


def _table(rng: np.random.Generator) -> Array:
    """Return two directions ``(2, 3)`` in which balls roll: across the image and up or down, the first turned a little."""
    turn = rotation([0, 1, 0], rng.normal(0, 0.15))
    return np.stack([turn @ (1.0, 0, 0), (0.0, 1, 0)])


def _set_up(pattern: str, radii: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return where balls would be at the time of the hit, and their velocities, both ``(n, 2)``, the latter in shots."""
    count = len(radii)
    angle = rng.normal(0, 0.35) + math.pi * rng.integers(2)
    along = np.array([math.cos(angle), math.sin(angle)])
    across = np.array([-along[1], along[0]])
    places, speeds = np.zeros((count, 2)), np.zeros((count, 2))
    gap = 1.02
    if pattern == "meeting":  # all come from different sides towards the middle, none quite in line
        turns = angle + 2 * math.pi * (np.arange(count) + rng.uniform(-0.15, 0.15, count)) / count
        out = np.stack([np.cos(turns), np.sin(turns)], axis=1)
        speeds = -out * rng.uniform(0.6, 1.0, (count, 1))
        places = out * radii[:, np.newaxis] * 1.1 + across * rng.normal(0, 0.3, (count, 1)) * radii.min()
        return places, speeds
    speeds[0] = along
    if pattern == "row":  # resting balls in a line, as in Newton's cradle
        middles = np.cumsum(np.concatenate([[0.0], gap * (radii[1:] + radii[:-1])]))
        places = (middles - middles.mean())[:, np.newaxis] * along
    else:  # resting balls in a triangle, as for the break in billiards
        spread = gap * radii[1:].max()
        triangle = np.array([(0, 0), (1.75, 1.02), (1.75, -1.02)])[: count - 1] * spread
        places[1:] = triangle @ np.stack([along, across])
        places[0] = -(radii[0] + radii[1]) * gap * along
    places[0] += across * rng.normal(0, 0.3) * radii[0]
    return places, speeds


Event = Literal["translation", "rotation", "articulation", "deformation", "bouncing", "collision", "occlusion"]
EVENTS: tuple[Event, ...] = get_args(Event)
MOST_ACTORS = 5
_MOST_BODIES = 4


def cast_event(event: Event, act: Act) -> list[Actor]:
    """Return the actors of an event: at least one, at most `MOST_ACTORS`."""
    return _CASTS[event](act)


def _pick(rng: np.random.Generator, meshes: Sequence[UnitMesh]) -> UnitMesh:
    return meshes[int(rng.integers(len(meshes)))]


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
    return rigid("body", _pick(act.rng, body_library()), radius, course, tumble.turn, facts=facts)


def _translation(act: Act) -> list[Actor]:
    """Bodies that cross a share of the image in straight lines."""

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
        return [rigid("top", _pick(rng, body_library()), size, course, tumble.turn, facts=facts)]

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
        return [moving(kind, figure, radius, course, turned, phase, facts=facts, grounded=grounded)]

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
        mesh = _pick(rng, [body for body in body_library() if len(body.faces) > 300])
        course = swaying(act, draw_spot(act, depth, radius), rng.uniform(0.0, 0.35))
        tumble = tumbling(act, (0.0, 0.15))
        facts = {"speed_m_s": act.mean_speed(course), "beats_per_s": rate}
        return [moving(name, Soft(mesh, bend), radius, course, tumble.turn, phase, facts=facts)]

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
    """Return a flag that flaps, or a free sheet that flutters across the image."""
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
    return moving(name, Soft(mesh, bend), radius, course, lambda _: turn, phase, facts=facts)


def _occlusion(act: Act) -> list[Actor]:
    """Bodies in different depths whose ways cross in the image, so that the nearer hide the farther."""
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
        return [rigid("body", _pick(rng, body_library()), radius, course, tumble.turn, facts=facts)]

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
