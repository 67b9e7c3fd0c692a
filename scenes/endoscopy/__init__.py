"""Scene family "endoscopy": colon, small intestine and stomach from inside, lit from beside the camera.

The camera is always at the origin; the organ is moved around it. Sizes are anatomical and not those of the view: what is in
view lies 0.5 to 12 cm away.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from scenes.endoscopy.endoscope import (
    CLEARANCE_M,
    Pose,
    brightened,
    direct_light,
    draw_lamps,
    draw_poses,
    first_hits,
    fits,
    pressed,
)
from scenes.endoscopy.mucosa import draw_mucosa
from scenes.endoscopy.organs import ORGANS, Wall
from scenes.endoscopy.segmented import Segment, find_shot, read_segment
from scenes.meshes import unit
from simulator.errors import InputError
from simulator.render import Material, Renderer, Scene, SphereLight, TriangleMesh
from simulator.types import Clip, View

# How free bends and pose are in each try; in the last the tube is straight and the camera in its middle, which always fits.
_TRIES = (1.0, 1.0, 1.0, 0.9, 0.9, 0.8, 0.7, 0.6, 0.45, 0.3, 0.15, 0.0)
_POSES = 6
# Inside of a closed wall every path goes on: a fifth segment would add 3 % of the light and a quarter of the time.
_MAX_DEPTH = 4
_DEEPEST = 0.96  # share of the far depth that walls may fill
_LARGEST_TRAVEL = 0.35  # share of the shortest lumen


def endoscopy(
    view: View,
    *,
    samples_per_pixel: Annotated[int, Field(ge=1, le=4096)] = 16,
    organ: Literal["mixed", "colon", "small_intestine", "stomach"] = "mixed",
    frames: Annotated[int, Field(ge=1, le=100_000)] = 1,
    frames_per_second: Annotated[float, Field(gt=0, le=1e6)] = 30.0,
    advance_mm_per_s: Annotated[float, Field(ge=-1e5, le=1e5)] = 10.0,
    surface: Path | None = None,
    path: Path | None = None,
    voxel_size_mm: tuple[
        Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)], Annotated[float, Field(gt=0)]
    ] = (1.0, 1.0, 1.0),
    dim_fireflies: bool = True,
    renderer: Renderer,
) -> Endoscopy:
    """Return the family for a view: each clip looks into another organ, or from another place into a segmented one.

    Lamp light is set once per clip, so that the wall in view would have the mean radiance `exposure` (0.12 to 0.26, drawn) by
    direct light alone; see `exposed`. Highlights and light from wall to wall come on top.

    Args:
        view: image shape, pinhole geometry and depth range; sizes are anatomical, so near and far must suit them.
        samples_per_pixel: light paths per pixel; noise falls with the square root.
        organ: what is seen, and the clips' label; ``mixed`` takes the three in turn, by index.
        frames: number of frames in a clip; 1 is a still.
        frames_per_second: of a clip.
        advance_mm_per_s: how fast the camera moves along the organ; negative withdraws it.
        surface: a segmented surface to look into: legacy VTK polydata, or any mesh that trimesh reads; ``organ`` must then
            say what it is.
        path: JSON of the line along its middle, ``{"points": [[x, y, z], ...]}`` in the units of ``surface``.
        voxel_size_mm: what one unit of ``surface`` and ``path`` along x, y, z is.
        dim_fireflies: dim lone glaring pixels, which small lamps on wet walls cause, to twice their second brightest
            neighbour; what that takes away (1 % of the light at 16 samples per pixel, more at fewer) is recorded.
        renderer: how to render.

    Raises:
        InputError: when the depth range does not suit the organ, the camera would run through the organ's end, or surface or
            path are missing or broken.
    """
    seconds = (np.arange(frames) - 0.5 * (frames - 1)) / frames_per_second
    if (surface is None) != (path is None):
        raise InputError(
            "surface and path", "got one without the other; a segmented surface needs the line along its middle"
        )
    if surface is not None and organ == "mixed":
        raise InputError(
            "organ", f"got 'mixed' with a surface, expected what {surface.name} shows: one of {', '.join(ORGANS)}"
        )
    family = Endoscopy(
        view,
        organ,
        samples_per_pixel,
        frames,
        frames_per_second,
        advance_mm_per_s,
        surface,
        path,
        voxel_size_mm,
        dim_fireflies,
        renderer,
    )
    check_view(view, family.organs)
    shortest = min(ORGANS[name].shortest_m for name in family.organs)
    travel = abs(advance_mm_per_s) * 1e-3 * float(seconds[-1] - seconds[0])
    if travel > _LARGEST_TRAVEL * shortest:
        raise InputError(
            "advance_mm_per_s",
            f"{advance_mm_per_s:g} over {frames} frames at {frames_per_second:g} per second moves the "
            f"camera {1e3 * travel:.3g} mm, expected at most {1e3 * _LARGEST_TRAVEL * shortest:.3g} mm; make it slower or "
            "clips shorter",
        )
    family.segment()  # refuses broken files before any work is done
    return family


@dataclass(frozen=True)
class Endoscopy:
    """A `simulator.types.SceneSource`; cheap to pickle, all contents come from the generator that ``clip`` is given."""

    view: View
    organ: str
    samples_per_pixel: int
    frames: int
    frames_per_second: float
    advance_mm_per_s: float
    surface: Path | None
    path: Path | None
    voxel_size_mm: tuple[float, float, float]
    dim_fireflies: bool
    renderer: Renderer

    @property
    def inputs(self) -> tuple[Path, ...]:
        """The surface and its path, where they are given."""
        return tuple(file for file in (self.surface, self.path) if file is not None)

    @property
    def organs(self) -> tuple[str, ...]:
        """What is seen at index 0, 1, ..., in turn."""
        return tuple(ORGANS) if self.organ == "mixed" else (self.organ,)

    def segment(self) -> Segment | None:
        """Return the segmented surface, read once per process, or None."""
        if self.surface is None or self.path is None:
            return None
        return read_segment(self.surface, self.path, self.voxel_size_mm)

    def clip(self, index: int, rng: np.random.Generator) -> Clip:
        """Draw an organ and a way through it from ``rng`` and render it."""
        organ = self.organs[index % len(self.organs)]
        seconds = np.arange(self.frames) / self.frames_per_second
        travel = 1e-3 * self.advance_mm_per_s * seconds
        segment = self.segment()
        if segment is None:
            wall, poses = draw_shot(self.view, organ, travel, seconds, rng)
        else:
            wall, poses = find_shot(self.view, segment, travel, seconds, rng)
        scenes = draw_scenes(self.view, organ, wall, poses, rng)
        return replace(self.renderer, max_depth=_MAX_DEPTH).clip(
            scenes,
            self.view,
            frames_per_second=1.0 if self.frames == 1 else self.frames_per_second,
            samples_per_pixel=self.samples_per_pixel,
            seed=int(rng.integers(2**32)),
            source={"family": "endoscopy", "index": index, "organ": organ},
            label=organ,
            dim_fireflies=self.dim_fireflies,
        )


def check_view(view: View, organs: tuple[str, ...]) -> None:
    """Refuse a view whose depth range cannot hold an organ (InputError with the key and the value that would do)."""
    corner = math.hypot(view.tan_half_width, view.tan_half_height)
    for name in organs:
        organ = ORGANS[name]
        # A wall at this distance beside the axis comes into view at the image's corner; the rest is what `fits` allows for.
        nearest = (organ.narrowest_m - CLEARANCE_M / 3) / corner
        label = name.replace("_", " ")
        if not view.near_m <= nearest:
            raise InputError(
                "scene.near_cm",
                f"got {100 * view.near_m:.3g}, but through this camera the wall of a {label} is seen from "
                f"{100 * nearest:.2g} cm on; set scene.near_cm to {0.9 * 100 * nearest:.2g} or less",
            )
        if not view.far_m >= organ.shortest_m:
            raise InputError(
                "scene.far_cm",
                f"got {100 * view.far_m:.3g}, but a {label} is at least {100 * organ.shortest_m:.3g} cm deep; "
                f"set scene.far_cm to {100 * organ.shortest_m:.3g} or more, best to 10",
            )


def draw_shot(
    view: View, organ: str, travel_m: NDArray[np.float64], seconds: NDArray[np.float64], rng: np.random.Generator
) -> tuple[Wall, list[Pose]]:
    """Draw an organ, and poses inside it at which all that is seen lies within near..far.

    ``travel_m`` ``(T,)`` is how far the camera has moved along the organ in each frame, ``seconds`` ``(T,)`` the frame's
    time.
    """
    kind = ORGANS[organ]
    deepest = min(_DEEPEST * view.far_m, kind.longest_m)
    arcs = travel_m - travel_m.min()
    for bend in _TRIES:
        reach = rng.uniform(max(0.7 * deepest, min(kind.shortest_m, deepest)), deepest)
        wall = kind.draw(reach, bend, rng)
        for _ in range(_POSES):
            poses = draw_poses(wall.course, arcs, seconds, kind.loose_m, widest_tilt(view), bend, rng)
            if all(fits(view, pose.seen(wall.vertices_m)) for pose in poses):
                return wall, poses
    msg = f"no pose in a straight {organ} fits {view}"  # `check_view` admits no such view
    raise RuntimeError(msg)


def widest_tilt(view: View) -> float:
    """Return how far the camera may look aside, radians: never back past the tip, where walls begin."""
    corner = math.atan(math.hypot(view.tan_half_width, view.tan_half_height))
    return float(np.clip(math.radians(72) - corner, 0, math.radians(28)))


def draw_scenes(view: View, organ: str, wall: Wall, poses: list[Pose], rng: np.random.Generator) -> list[Scene]:
    """Draw the mucosa and the lamps; return what each frame shows."""
    material = Material(draw_mucosa(organ, rng), roughness=float(rng.uniform(0.14, 0.25)))
    lamps = draw_lamps(rng)
    exposure = float(rng.uniform(0.12, 0.26))
    meshes = [
        TriangleMesh(
            pressed(view, pose.seen(wall.vertices_m)), wall.normals @ pose.axes.T, wall.uv, wall.faces, material
        )
        for pose in poses
    ]
    middles = [meshes[number] for number in sorted({0, len(meshes) // 2, len(meshes) - 1})]
    lights = exposed(view, middles, lamps, exposure)
    return [Scene((mesh,), lights, hide_lights=True) for mesh in meshes]


def exposed(
    view: View, meshes: list[TriangleMesh], lamps: list[SphereLight], exposure: float
) -> tuple[SphereLight, ...]:
    """Return the lamps so bright that direct light gives the walls in view a mean radiance of ``exposure``.

    The mean is over the 9 x 9 rays of `scenes.endoscopy.endoscope.first_hits` and over the meshes (frames of a clip):
    albedo x lamp intensity x mean(cos / distance^2) = exposure. It is known before anything is rendered, like the automatic
    exposure of an endoscope, and holds for a whole clip.
    """
    means = []
    for mesh in meshes:
        seen = first_hits(view, mesh.vertices_m, mesh.faces)
        light = direct_light(lamps, seen.points_m, unit(mesh.normals[mesh.faces[seen.face]].mean(axis=1)))
        means.append(float(light.mean()) * float(mesh.material.reflectance.mean()))
    return brightened(lamps, exposure / float(np.mean(means)))
