"""Scene family "activity": the ten coarse actions of Something-Something, acted by an articulated hand over a table.

After the ten classes that action recognition with lensless cameras is trained on; Goyal et al., ICCV 2017.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenes.activity.actions import ACTIONS, GRAINS, Action, Cast, Moment, course
from scenes.activity.hand import hand_surface
from scenes.activity.holds import Actor, Pose
from scenes.activity.tabletop import Viewpoint, check_range, draw_lights, draw_viewpoint, table_mesh, wall_mesh
from scenes.activity.things import BACKGROUNDS, Looks, draw_looks, draw_thing, grains_mesh, paint
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
    renderer: Renderer,
) -> Activity:
    """Return the family for a view: each clip is one action, labelled, with the classes in turn from index to index.

    Thing, hand, skin, light, background and viewpoint are drawn before the action is looked at, so that nothing but the
    action tells the label. The action fills the clip, whatever its length; things fall with the gravity of the set, which
    is a real one scaled down to the depth range, unless the clip is shorter than 1.4 s: then all of it runs faster.

    Args:
        view: image shape, pinhole geometry and depth range; ``far_m`` must be about 3.5 ``near_m`` (65 degrees wide).
        frames: number of frames in a clip.
        frames_per_second: frame rate; the default is that of Something-Something, 20 frames last 1.7 s.
        samples_per_pixel: light paths per pixel of a frame; noise falls with the square root.
        actions: the classes, in turn; all ten unless given.
        renderer: how to render.

    Raises:
        InputError: when the depth range is too thin for a table and a wall, or an action is named twice.
    """
    check_range(view)
    chosen = tuple(actions) if actions is not None else ACTIONS
    if len(set(chosen)) < len(chosen):
        raise InputError("actions", f"got {', '.join(chosen)}, expected each at most once; leave out what is repeated")
    return Activity(view, frames, frames_per_second, samples_per_pixel, chosen, renderer)


@dataclass(frozen=True)
class Activity:
    """A `simulator.types.SceneSource`; cheap to pickle, all contents come from the generator that ``clip`` is given."""

    view: View
    frames: int
    frames_per_second: float
    samples_per_pixel: int
    actions: tuple[str, ...]
    renderer: Renderer
    inputs: tuple[Path, ...] = field(default=(), init=False)

    def clip(self, index: int, rng: np.random.Generator) -> Clip:
        """Draw and render a clip of the action ``index % len(actions)``."""
        action = self.actions[index % len(self.actions)]
        duration = self.frames / self.frames_per_second
        drawn = draw_parameters(action, self.view, rng, duration_s=max(duration, _SHORTEST_S))
        return self.renderer.clip(
            clip_scenes(drawn, self.view, self.frames),
            self.view,
            frames_per_second=self.frames_per_second,
            samples_per_pixel=self.samples_per_pixel,
            seed=int(rng.integers(2**32)),
            source={"family": "activity", "index": index, **drawn.facts()},
            label=action,
        )


@dataclass(frozen=True)
class Parameters:
    """All that a clip shows: the action, its cast, how things look, where the set stands and how it is lit."""

    action: str
    cast: Cast
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
            "pitch_deg": round(math.degrees(self.viewpoint.pitch_rad), 3),
            "scale": round(self.viewpoint.scale, 6),
        }


def draw_parameters(action: str, view: View, rng: np.random.Generator, *, duration_s: float = 5 / 3) -> Parameters:
    """Draw everything of a clip of a duration in the set's time, without rendering; the action takes no part in any draw."""
    viewpoint = draw_viewpoint(view, rng)
    light, lights = draw_lights(viewpoint, rng)
    thing = draw_thing(rng)
    looks = draw_looks(rng)
    shares = rng.random(16)
    # Long things are gripped in the middle, flat ones high enough for the hand to stay above the table.
    grip_height = min(max((0.55 + 0.2 * shares[0]) * thing.height_m, 0.045), 0.85 * thing.height_m)
    least = math.acos(min(1.0, grip_height / 0.058))
    elevation = max(math.radians(30 * shares[1]), least)
    left = bool(shares[2] < 0.5)
    elbow = 0.06 + 0.08 * shares[3]
    cast = Cast(
        thing=thing,
        main=Actor(looks.hand_size, left, math.radians(42 + 38 * shares[4]), elevation, elbow),
        second=Actor(looks.hand_size, not left, math.radians(42 + 38 * shares[5]), elevation, elbow),
        second_rests=bool(shares[6] < 0.25),
        spot_m=np.array([0.06 * (2 * shares[7] - 1), 0.04 * (2 * shares[8] - 1)]),
        aloft_m=0.055 + 0.045 * shares[9],
        grip_height_m=grip_height,
        to_viewer=-viewpoint.turn[2],
        duration_s=duration_s,
        margins=(0.02 + 0.12 * shares[10], 0.02 + 0.12 * shares[11]),
        tremor_m=0.0006 + 0.0012 * shares[12],
        grain_m=0.0065 + 0.003 * shares[13],
        luck=rng.random(32),
    )
    return Parameters(action, cast, looks, viewpoint, light, lights)


def clip_scenes(drawn: Parameters, view: View, frames: int) -> Iterator[Scene]:
    """Yield the scene in the middle of each frame, in the rendered world.

    The slots are: table, wall, acting hand, other hand, the thing's left and right half, grains.
    """
    at = course(drawn.action, drawn.cast)
    set_up = _SetUp(drawn, view)
    for number in range(frames):
        yield set_up.scene(at(drawn.cast.duration_s * (number + 0.5) / frames))


class _SetUp:
    """Puts moments into scenes; what has not moved since the moment before stays the same object."""

    def __init__(self, drawn: Parameters, view: View) -> None:
        looks = paint(drawn.looks)
        self._drawn = drawn
        self._looks = looks
        self._backdrop = (
            table_mesh(view, drawn.viewpoint, looks.table, looks.repeats[0]),
            wall_mesh(view, drawn.viewpoint, looks.wall, looks.repeats[1]),
        )
        self._hands = (replace(looks.hand, left=drawn.cast.main.left), replace(looks.hand, left=drawn.cast.second.left))
        # Out of sight: a speck behind the camera.
        self._parked_m = np.array([0, 0, -0.5 * view.near_m])
        surface = hand_surface().mesh
        self._no_hand = self._speck(surface, looks.hand.material)
        self._no_grains = self._speck(grains_mesh(np.zeros((GRAINS, 3)), np.ones(GRAINS)), looks.grains)
        self._last: dict[str, tuple[bytes, TriangleMesh]] = {}

    def _speck(self, mesh: UnitMesh, material: Material) -> TriangleMesh:
        small = 1e-3 * self._parked_m[2] * mesh.vertices
        return TriangleMesh(self._parked_m + small, mesh.normals, mesh.uv, mesh.faces, material)

    def scene(self, moment: Moment) -> Scene:
        """Return the scene of a moment."""
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
