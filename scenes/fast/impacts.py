"""The events in which things hit: balls that bounce on a floor, and balls that run into each other."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scenes.fast.actors import Act, Actor, cast, rigid
from scenes.fast.bodies import round_bodies
from scenes.fast.courses import draw_depth, draw_spot, floor_depth, tumbling
from scenes.fast.deform import squash
from scenes.fast.dynamics import Balls, Plane, bounce, collide
from scenes.motion import placed, rotation
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
        # In the picture's plane: the shot crosses a share of the width until it hits, and hits in the first half.
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
    """Return two directions ``(2, 3)`` in which balls roll: across the picture and up or down, the first turned a little."""
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
