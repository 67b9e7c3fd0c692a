"""Scene family "high speed": salient textured things in fast motion, on black or in a room, for reconstruction of video.

Made for a rolling shutter that records tens of frames in one exposure, at thousands of frames per second.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from scenes.high_speed.actors import Act, Actor, floor_depth, rigid
from scenes.high_speed.bodies import body_library
from scenes.high_speed.events import EVENTS, MOST_ACTORS, Event, cast_event
from scenes.high_speed.rooms import Room, behind, draw_room, floor_of, lamps_of, wall_of
from scenes.layout import far_end, random_rotation
from scenes.textures import draw_ramp, draw_reflectance, draw_theme
from simulator.render import Light, Material, Renderer, Scene, TriangleMesh
from simulator.types import Clip, View

_TEXTURE_SIZE = 64
_BACKDROPS = 2
# Coats of the actors' slots: fixed, so that no kernel is compiled after the first clip (see render.Scene).
_COATED = (False, True, False, True, False)
_BLACK = np.full((_TEXTURE_SIZE, _TEXTURE_SIZE, 3), 0.01, np.float32)

Background = Literal["black", "room", "mixed"]


def high_speed(
    view: View,
    *,
    frames: Annotated[int, Field(ge=1, le=2000)] = 20,
    frames_per_second: Annotated[float, Field(ge=1, le=1e6)] = 2000.0,
    samples_per_pixel: Annotated[int, Field(ge=1, le=4096)] = 16,
    background: Background = "black",
    event: Literal["mixed", Event] = "mixed",
    renderer: Renderer,
) -> HighSpeed:
    """Return the family for a view: clips of one to five things that fly, tumble, bend, bounce, collide or cross.

    Speeds follow from the image: over the clip a thing crosses 0.2 to 1 of the width, or makes about one turn or beat.
    Twenty frames at 2000 per second last 10 ms, so at 10 cm a thing flies at 3 to 13 m/s. Gravity is scaled alike: a fall
    takes a third to two thirds of the clip, as if time ran faster; the sample's metadata tell gravity and speeds.

    Args:
        view: image shape, pinhole geometry and depth range; ``far_m`` must be at least 1.1 ``near_m``.
        frames: how many frames a clip has.
        frames_per_second: of the clip; each frame shows the scene in the middle of its time.
        samples_per_pixel: light paths per pixel; noise falls with the square root.
        background: black (nothing is valid there), a room with textured wall and floor, or mixed: both in turn.
        event: the kind of motion, which is the clip's label; mixed takes each in turn by index.
        renderer: how to render.

    Raises:
        InputError: when the depth range is too thin to hold solids.
    """
    far_end(view)  # refuses a view that cannot be filled, before any work is done
    return HighSpeed(view, frames, frames_per_second, samples_per_pixel, background, event, renderer)


@dataclass(frozen=True)
class HighSpeed:
    """A `simulator.types.SceneSource`; cheap to pickle, all contents come from the generator that ``clip`` is given."""

    view: View
    frames: int
    frames_per_second: float
    samples_per_pixel: int
    background: Background
    event: Literal["mixed", Event]
    renderer: Renderer
    inputs: tuple[Path, ...] = field(default=(), init=False)

    def clip(self, index: int, rng: np.random.Generator) -> Clip:
        """Draw a clip from ``rng`` and render it; ``index`` decides its event and background where these are mixed."""
        event = event_of(self.event, index)
        black = is_black(self.background, index)
        play = draw_play(self.view, event, black, self.frames / self.frames_per_second, rng)
        facts = {
            "family": "high_speed",
            "index": index,
            "event": event,
            "background": "black" if black else "room",
            "frames_per_second": self.frames_per_second,
            "actors": [
                {"name": actor.name, "radius_m": actor.radius_m, **actor.facts}
                for actor in play.actors
                if not actor.still
            ],
        }
        times = (np.arange(self.frames) + 0.5) / self.frames_per_second
        return self.renderer.clip(
            play.scenes(times),
            self.view,
            frames_per_second=self.frames_per_second,
            samples_per_pixel=self.samples_per_pixel,
            seed=int(rng.integers(2**32)),
            source=facts,
            label=event,
        )


def event_of(event: Literal["mixed", Event], index: int) -> Event:
    """Return the event of a sample: each in turn by index where events are mixed."""
    return EVENTS[index % len(EVENTS)] if event == "mixed" else event


def is_black(background: Background, index: int) -> bool:
    """Whether a sample is on black: every other round of all events is, where backgrounds are mixed."""
    return background == "black" or (background == "mixed" and index // len(EVENTS) % 2 == 0)


@dataclass(frozen=True)
class Play:
    """What a clip shows.

    Attributes:
        room: the space.
        actors: what is in it.
        backdrops: the slots of wall and floor.
        slots: for each further slot its material, and the actor in it or None.
        lights: what shines.
    """

    room: Room
    actors: tuple[Actor, ...]
    backdrops: tuple[TriangleMesh, ...]
    slots: tuple[tuple[Material, Actor | None], ...]
    lights: tuple[Light, ...]

    def scenes(self, times_s: np.ndarray) -> Iterator[Scene]:
        """Yield the scene at each time; what does not move is the same object in all of them."""
        resting = [
            _parked(material) if actor is None else actor.shape(0.0, material) if actor.still else None
            for material, actor in self.slots
        ]
        for time in times_s:
            shapes = [
                rest if actor is None or rest is not None else actor.shape(float(time), material)
                for rest, (material, actor) in zip(resting, self.slots, strict=True)
            ]
            yield Scene(
                (*self.backdrops, *(shape for shape in shapes if shape is not None)), self.lights, hide_lights=True
            )


def draw_play(view: View, event: Event, black: bool, duration_s: float, rng: np.random.Generator) -> Play:
    """Draw all that a clip of an event shows; a black one has no wall and floor."""
    theme = draw_theme(rng)
    room = draw_room(view, rng)
    act = Act(room, duration_s, rng)
    actors = cast_event(event, act)
    if not black:
        actors += _props(act, actors)
    wall, floor = wall_of(room, theme, _TEXTURE_SIZE, rng), floor_of(room, theme, _TEXTURE_SIZE, rng)
    backdrops = tuple(_parked(Material(_BLACK)) for _ in range(_BACKDROPS)) if black else (wall, floor)
    places = rng.permutation(MOST_ACTORS)
    slots: list[tuple[Material, Actor | None]] = []
    for coated, place in zip(_COATED, places, strict=True):
        roughness = float(rng.uniform(0.15, 0.5)) if coated else None
        if place >= len(actors):
            slots.append((Material(_BLACK, roughness), None))
            continue
        reflectance = draw_reflectance(rng, draw_ramp(rng, theme, saturation=(0.25, 0.9)), _TEXTURE_SIZE)
        slots.append((Material(reflectance, roughness), actors[place]))
    lamps = lamps_of(room, rng)
    if view.margin != (0, 0):
        backdrops += (_parked(Material(_BLACK)) if black else behind(room, theme, _TEXTURE_SIZE, rng),)
    return Play(room, tuple(actors), backdrops, tuple(slots), lamps)


def _props(act: Act, actors: list[Actor]) -> list[Actor]:
    """Return things that stand about on the floor, in slots that the event leaves free and out of everyone's way."""
    rng = act.rng
    free = MOST_ACTORS - len(actors)
    props: list[Actor] = []
    for _ in range(int(rng.integers(0, free + 1))):
        relative = min(float(act.room.half.min()) * rng.uniform(0.12, 0.3), 0.3)
        depth = floor_depth(act, relative)
        radius = relative * depth
        mesh, turn = body_library()[rng.integers(len(body_library()))], random_rotation(rng)
        lowest = radius * float((mesh.vertices @ turn.T)[:, 1].max())
        spot = np.array([rng.uniform(-0.9, 0.9) * act.room.half[0] * depth, act.room.floor_m - lowest, depth])
        prop = rigid(
            "prop", mesh, radius, lambda _, spot=spot: spot, lambda _, turn=turn: turn, grounded=True, still=True
        )
        if act.accepts([prop], [*actors, *props]):
            props.append(prop)
    return props


def _parked(material: Material) -> TriangleMesh:
    """Return a speck behind the camera, for a slot that is not used."""
    corners = np.array([(0.0, 0, -0.01), (1e-5, 0, -0.01), (0, 1e-5, -0.01)])
    return TriangleMesh(corners, np.tile((0.0, 0, 1), (3, 1)), np.zeros((3, 2)), np.array([(0, 1, 2)]), material)
