"""Scene family "activity": the ten coarse actions of Something-Something, acted by an articulated hand over a table.

After the ten classes that action recognition with lensless cameras is trained on; Goyal et al., ICCV 2017.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenes.activity.actions import ACTIONS, Action, Moment, course
from scenes.activity.cast import Cast, draw_cast
from scenes.activity.grains import GRAINS
from scenes.activity.hand import hand_surface
from scenes.activity.holds import Pose
from scenes.activity.tabletop import Viewpoint, check_range, draw_lights, draw_viewpoint, table_mesh, wall_mesh
from scenes.activity.things import BACKGROUNDS, Looks, draw_looks, draw_thing, grains_mesh, paint
from scenes.layout import rotation
from scenes.meshes import UnitMesh
from simulator.errors import InputError
from simulator.render import Environment, Material, Renderer, Scene, SphereLight, TriangleMesh
from simulator.types import Clip, View

Array = NDArray[np.float64]
# A shorter clip shows an action of this length in quick motion, gravity and all; a longer one a slower action.
_SHORTEST_S = 1.4


def activity(
    view: View,
    *,
    frames: Annotated[int, Field(ge=1, le=500)] = 20,
    frames_per_second: Annotated[float, Field(gt=0, le=100_000)] = 12.0,
    samples_per_pixel: Annotated[int, Field(ge=1, le=4096)] = 16,
    actions: Annotated[list[Action], Field(min_length=1)] | None = None,
    only_background: bool = False,
    renderer: Renderer,
) -> Activity:
    """Return the family for a view: each clip is one action, labelled, with the classes in turn from index to index.

    Thing, hand, skin, light, background and viewpoint, and how things are done, are drawn before the action is looked at, so
    that nothing but the action tells the label; and stills of different actions are alike, as far as these can be: things
    are held upright or tipped over, whole or torn, by one hand or by both, other hands come in that do nothing, grains lie
    on the table. The action fills half of the clip at least, whatever its length; things fall with the gravity of the set,
    which is a real one scaled down to the depth range, unless the clip is shorter than 1.4 s: then all of it runs faster.

    Args:
        view: image shape, pinhole geometry and depth range; ``far_m`` must be about 3.5 ``near_m`` (65 degrees wide).
        frames: number of frames in a clip.
        frames_per_second: frame rate; the default is that of Something-Something, 20 frames last 1.7 s.
        samples_per_pixel: light paths per pixel of a frame; noise falls with the square root.
        actions: the classes, in turn; all ten unless given.
        only_background: without hands, what they handle, and grains: what is left should tell nothing of the action.
        renderer: how to render.

    Raises:
        InputError: when the depth range is too thin for a table and a wall, or an action is named twice.
    """
    check_range(view)
    chosen = tuple(actions) if actions is not None else ACTIONS
    if len(set(chosen)) < len(chosen):
        raise InputError("actions", f"got {', '.join(chosen)}, expected each at most once; leave out what is repeated")
    return Activity(view, frames, frames_per_second, samples_per_pixel, chosen, only_background, renderer)


@dataclass(frozen=True)
class Activity:
    """A `simulator.types.SceneSource`; cheap to pickle, all contents come from the generator that ``clip`` is given."""

    view: View
    frames: int
    frames_per_second: float
    samples_per_pixel: int
    actions: tuple[str, ...]
    only_background: bool
    renderer: Renderer
    inputs: tuple[Path, ...] = field(default=(), init=False)

    def clip(self, index: int, rng: np.random.Generator) -> Clip:
        """Draw and render a clip of the action ``index % len(actions)``."""
        action = self.actions[index % len(self.actions)]
        duration = self.frames / self.frames_per_second
        drawn = draw_parameters(action, self.view, rng, duration_s=max(duration, _SHORTEST_S))
        return self.renderer.clip(
            clip_scenes(drawn, self.view, self.frames, only_background=self.only_background),
            self.view,
            frames_per_second=self.frames_per_second,
            samples_per_pixel=self.samples_per_pixel,
            seed=int(rng.integers(2**32)),
            source={"family": "activity", "index": index, **drawn.facts()},
            label=action,
        )


@dataclass(frozen=True)
class Parameters:
    """All that a clip shows: the action, its cast, how things look, where the set stands and how it is lit.

    Attributes:
        companion: a thing that stands aside, as a mesh of the set; None where none does.
    """

    action: str
    cast: Cast
    companion: UnitMesh | None
    looks: Looks
    viewpoint: Viewpoint
    light: str
    lights: tuple[SphereLight | Environment, ...]

    def facts(self) -> dict[str, Any]:
        """Return what there is to know of the drawing beside the action, JSON-serialisable."""
        return {
            "object": self.cast.thing.kind,
            "background": BACKGROUNDS[self.looks.background],
            "light": self.light,
            "skin": self.looks.skin,
            "hand": "left" if self.cast.main.left else "right",
            "manner": asdict(self.cast.manner),
            "starts": round(self.cast.margins[0], 3),
            "ends": round(1 - self.cast.margins[1], 3),
            "pitch_deg": round(math.degrees(self.viewpoint.pitch_rad), 3),
            "scale": round(self.viewpoint.scale, 6),
        }


def draw_parameters(action: str, view: View, rng: np.random.Generator, *, duration_s: float = 5 / 3) -> Parameters:
    """Draw everything of a clip of a duration in the set's time, without rendering; the action takes no part in any draw."""
    viewpoint = draw_viewpoint(view, rng)
    light, lights = draw_lights(viewpoint, rng)
    thing = draw_thing(rng)
    looks = draw_looks(rng)
    cast = draw_cast(thing, looks.hand_size, -viewpoint.turn[2], rng, duration_s=duration_s)
    companion = _draw_companion(cast.second.side, viewpoint, rng)
    return Parameters(action, cast, companion, looks, viewpoint, light, lights)


def _draw_companion(side: float, viewpoint: Viewpoint, rng: np.random.Generator) -> UnitMesh | None:
    """Draw a thing that stands at a side, beyond where things are moved to; None, too, where the wall leaves no room."""
    thing, shares = draw_thing(rng), rng.random(4)
    x = side * (0.25 + 0.04 * shares[0])
    room = viewpoint.wall_m - x * math.tan(viewpoint.wall_yaw_rad) - 0.06
    if shares[1] > 0.6 or room < 0.06:
        return None
    turn = rotation([0, 1, 0], 2 * math.pi * shares[3])
    place = np.array([x, 0, min(room, 0.06 + 0.06 * shares[2])])
    whole = thing.whole
    return UnitMesh(place + whole.vertices @ turn.T, whole.normals @ turn.T, whole.uv, whole.faces)


def clip_scenes(drawn: Parameters, view: View, frames: int, *, only_background: bool = False) -> Iterator[Scene]:
    """Yield the scene in the middle of each frame, in the rendered world.

    The slots are: table, wall, the companion, acting hand, other hand, the thing's left and right half, grains.
    """
    at = course(drawn.action, drawn.cast)
    set_up = _SetUp(drawn, view)
    for number in range(frames):
        moment = at(drawn.cast.duration_s * (number + 0.5) / frames)
        yield set_up.scene(None if only_background else moment)


class _SetUp:
    """Puts moments into scenes; what has not moved since the moment before stays the same object."""

    def __init__(self, drawn: Parameters, view: View) -> None:
        looks = paint(drawn.looks)
        self._drawn = drawn
        self._looks = looks
        self._hands = (replace(looks.hand, left=drawn.cast.main.left), replace(looks.hand, left=drawn.cast.second.left))
        # Out of sight: a speck behind the camera.
        self._parked_m = np.array([0, 0, -0.5 * view.near_m])
        surface = hand_surface().mesh
        self._no_hand = self._speck(surface, looks.hand.material)
        self._no_halves = tuple(self._speck(half, looks.thing) for half in drawn.cast.thing.halves)
        self._no_grains = self._speck(grains_mesh(np.zeros((GRAINS, 3)), np.ones(GRAINS)), looks.grains)
        companion = drawn.companion
        place = drawn.viewpoint.placed
        self._backdrop = (
            table_mesh(view, drawn.viewpoint, looks.table, looks.repeats[0]),
            wall_mesh(view, drawn.viewpoint, looks.wall, looks.repeats[1]),
            self._speck(drawn.cast.thing.whole, looks.companion)
            if companion is None
            else place(
                TriangleMesh(companion.vertices, companion.normals, companion.uv, companion.faces, looks.companion)
            ),
        )
        self._last: dict[str, tuple[bytes, TriangleMesh]] = {}

    def _speck(self, mesh: UnitMesh, material: Material) -> TriangleMesh:
        small = 1e-3 * self._parked_m[2] * mesh.vertices
        return TriangleMesh(self._parked_m + small, mesh.normals, mesh.uv, mesh.faces, material)

    def scene(self, moment: Moment | None) -> Scene:
        """Return the scene of a moment; of the background alone for None."""
        if moment is None:
            shapes = (*self._backdrop, self._no_hand, self._no_hand, *self._no_halves, self._no_grains)
            return Scene(shapes, self._drawn.lights)
        place = self._drawn.viewpoint.placed
        second = self._no_hand
        if moment.second is not None:
            state = moment.second
            key = state.angles_rad.tobytes() + state.frame.tobytes() + state.wrist_m.tobytes()
            second = self._kept("second", key, lambda: place(state.mesh(self._hands[1])))
        shapes = (
            *self._backdrop,
            place(moment.hand.mesh(self._hands[0])),
            second,
            *(self._half(number, pose) for number, pose in enumerate(moment.halves)),
            self._grains(moment.grains_m),
        )
        return Scene(shapes, self._drawn.lights)

    def _half(self, number: int, pose: Pose) -> TriangleMesh:
        mesh = self._drawn.cast.thing.halves[number]

        def build() -> TriangleMesh:
            return self._drawn.viewpoint.placed(
                TriangleMesh(
                    pose.place_m + mesh.vertices @ pose.turn.T,
                    mesh.normals @ pose.turn.T,
                    mesh.uv,
                    mesh.faces,
                    self._looks.thing,
                )
            )

        return self._kept(f"half {number}", pose.turn.tobytes() + pose.place_m.tobytes(), build)

    def _grains(self, centres_m: Array | None) -> TriangleMesh:
        if centres_m is None:
            return self._no_grains
        return self._kept("grains", centres_m.tobytes(), lambda: self._grains_at(centres_m))

    def _grains_at(self, centres_m: Array) -> TriangleMesh:
        inside = np.isnan(centres_m[:, :1])
        world = np.where(inside, self._parked_m, self._drawn.viewpoint.to_world(centres_m))
        sizes = np.full(GRAINS, self._drawn.cast.grain_m * self._drawn.viewpoint.scale)
        sizes[inside[:, 0]] *= 1e-3
        mesh = grains_mesh(world, sizes)
        return TriangleMesh(mesh.vertices, mesh.normals, mesh.uv, mesh.faces, self._looks.grains)

    def _kept(self, slot: str, key: bytes, build: Any) -> TriangleMesh:
        if slot not in self._last or self._last[slot][0] != key:
            self._last[slot] = (key, build())
        return self._last[slot][1]
