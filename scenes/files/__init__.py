"""Scene family "files": your own Mitsuba scenes (XML), meshes (OBJ, PLY, STL, glTF, GLB) and images."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from scenes.files.images import image_clip, plane_depth
from scenes.files.mesh_files import MESH_SUFFIXES, Up, load_model, mesh_inputs
from scenes.files.model_scene import Pose, back_m, model_scene, model_shapes, place_model
from scenes.layout import far_end
from simulator.errors import InputError
from simulator.render import Renderer
from simulator.render.own_scene import check_depths, own_scene_files
from simulator.types import Clip, View

_SCENES = (".xml",)
_IMAGES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".exr")


def files(
    view: View,
    *,
    path: Path | list[Path],
    samples_per_pixel: Annotated[int, Field(ge=1, le=4096)] = 16,
    length_of_unit_cm: Annotated[float | None, Field(gt=0, allow_inf_nan=False)] = None,
    pose: Pose = "random",
    up: Up = "auto",
    turn_degrees: Annotated[float, Field(ge=-360, le=360)] = 0.0,
    light: Literal["studio", "varied"] = "studio",
    background: Literal["wall", "black"] = "wall",
    plane_cm: Annotated[float | None, Field(gt=0, allow_inf_nan=False)] = None,
    renderer: Renderer,
) -> OwnFiles:
    """Return the family for a view: sample i shows file i, and begins again with the first after the last.

    Args:
        view: image shape, pinhole geometry and depth range.
        path: a file, a list of files, or a folder, of which the scenes and meshes are taken in the order of their names, or
            its images if it has neither; images are rotated as their EXIF data say, and what is transparent is seen before
            black.
        samples_per_pixel: light paths per pixel; noise falls with the square root.
        length_of_unit_cm: what one unit of an XML scene or a mesh stands for; without it, scenes are scaled about their
            camera, and meshes about their middle, to fit the view and its depths.
        pose: of meshes, random in rotation, size and place, upright in the middle, or as_is with the file's coordinates (in
            up's axes) being the camera's, which needs length_of_unit_cm.
        up: the axis of a mesh file that points up; auto is z for STL and y for all others.
        turn_degrees: turns meshes about their upright, to the right as seen from above.
        light: of meshes, studio is always the same, varied is drawn; XML scenes bring their own.
        background: of meshes, a wall of drawn pattern at the far end, or black.
        plane_cm: depth of images; without it midway between near and far in disparity.
        renderer: how to render.

    Raises:
        InputError: when there is no such file, or one of an unknown kind, or parameters contradict one another.
    """
    found = _list_files(path)
    if pose == "as_is" and length_of_unit_cm is None:
        raise InputError(
            "pose", "as_is takes the file's coordinates for the camera's, which needs length_of_unit_cm; give it too"
        )
    for key, value, suffixes in (
        ("plane_cm", plane_cm, _IMAGES),
        ("length_of_unit_cm", length_of_unit_cm, (*_SCENES, *MESH_SUFFIXES)),
    ):
        if value is not None and not any(_is(file, suffixes) for file in found):
            raise InputError(
                key, f"got {value:g}, but it applies to no file given, only to {', '.join(suffixes)}; leave it out"
            )
    if any(_is(file, MESH_SUFFIXES) for file in found):
        far_end(view)  # refuses a view that cannot be filled, before any work is done
    depth_m = plane_depth(view, plane_cm)
    unit_m = None if length_of_unit_cm is None else length_of_unit_cm * 1e-2
    finite = pose != "random" or not any(_is(file, MESH_SUFFIXES) for file in found)
    kind = FiniteOwnFiles if finite else OwnFiles
    return kind(
        view, found, samples_per_pixel, unit_m, pose, up, turn_degrees, light, background == "wall", depth_m, renderer
    )


@dataclass(frozen=True)
class OwnFiles:
    """A `simulator.types.SceneSource`; it holds names and numbers only, files are read when they are shown.

    Attributes:
        view: the camera's view.
        paths: the files, one sample each.
        samples_per_pixel: light paths per pixel.
        unit_m: metres per unit of scenes and meshes, or None.
        pose: of meshes.
        up: of meshes.
        turn_degrees: of meshes.
        light: of meshes.
        wall: whether a wall stands behind meshes.
        plane_m: depth of images.
        renderer: how to render.
    """

    view: View
    paths: tuple[Path, ...]
    samples_per_pixel: int
    unit_m: float | None
    pose: Pose
    up: Up
    turn_degrees: float
    light: Literal["studio", "varied"]
    wall: bool
    plane_m: float
    renderer: Renderer

    @property
    def inputs(self) -> list[Path]:
        """All files and what they refer to: materials, textures, buffers, meshes and includes.

        Raises:
            InputError: naming the file, when one that is referred to is missing or broken.
        """
        inputs: list[Path] = []
        for path in self.paths:
            if _is(path, _SCENES):
                inputs += own_scene_files(path)
            else:
                inputs += mesh_inputs(path) if _is(path, MESH_SUFFIXES) else [path]
        return list(dict.fromkeys(inputs))

    def clip(self, index: int, rng: np.random.Generator) -> Clip:
        """Show file ``index`` (modulo their number); ``rng`` decides pose, background and light of a mesh, and the noise.

        Raises:
            InputError: naming the file, when it cannot be shown.
        """
        path = self.paths[index % len(self.paths)]
        source: dict[str, Any] = {"family": "files", "index": index, "file": path.name}
        if _is(path, _SCENES):
            return self.renderer.own_still(
                path,
                self.view,
                metres_per_unit=self.unit_m,
                samples_per_pixel=self.samples_per_pixel,
                seed=int(rng.integers(2**32)),
                source=source,
            )
        if _is(path, MESH_SUFFIXES):
            return self._mesh(path, source, rng)
        return image_clip(path, self.view, self.plane_m, self.renderer.outputs, source)

    def _mesh(self, path: Path, source: dict[str, Any], rng: np.random.Generator) -> Clip:
        mesh_inputs(path)  # trimesh keeps quiet about what is missing
        model = load_model(path, self.up, self.turn_degrees)
        placement = place_model(path, model, self.view, self.pose, self.unit_m, self.wall, rng)
        scene = model_scene(self.view, model_shapes(model, placement), self.light, self.wall, rng)
        clip = self.renderer.still(
            scene,
            self.view,
            samples_per_pixel=self.samples_per_pixel,
            seed=int(rng.integers(2**32)),
            source=source
            | {
                "metres_per_unit": placement.scale,
                "rotation": placement.turn.tolist(),
                "centre_m": placement.centre_m.tolist(),
            },
        )
        if self.pose == "as_is":
            seen = clip.depth_m[clip.valid]
            self._check_seen(path, seen)
            check_depths(path, seen, clip.valid.size, self.view)
        return clip

    def _check_seen(self, path: Path, depth_m: np.ndarray) -> None:
        before = back_m(self.view, self.wall) * (1 - 1e-4) if self.wall else np.inf
        if not np.any(depth_m < before):
            raise InputError(
                path,
                "with pose: as_is nothing of it is in view; move it before the camera, or use pose: upright or random",
            )


@dataclass(frozen=True)
class FiniteOwnFiles(OwnFiles):
    """The same where a file always gives the same clip, but for noise, light and background."""

    def __len__(self) -> int:
        """Return how many different clips there are."""
        return len(self.paths)


def _list_files(path: Path | list[Path]) -> tuple[Path, ...]:
    given = path if isinstance(path, list) else [path]
    if not given:
        raise InputError("path", "got an empty list, expected at least one file")
    known = f"Mitsuba scenes (.xml), meshes ({', '.join(MESH_SUFFIXES)}) and images ({', '.join(_IMAGES)})"
    found: list[Path] = []
    for one in map(Path, given):
        if one.is_dir():
            inside = sorted(file for file in one.iterdir() if file.is_file() and not file.name.startswith("."))
            # Images beside meshes are their textures.
            shown = [file for file in inside if _is(file, (*_SCENES, *MESH_SUFFIXES))]
            shown = shown or [file for file in inside if _is(file, _IMAGES)]
            if not shown:
                raise InputError("path", f"the folder {one} holds nothing that can be shown; expected {known}")
            found += shown
        elif not one.is_file():
            raise InputError("path", f"there is no file {one}; a relative path is taken from the YAML file's folder")
        elif not _is(one, (*_SCENES, *MESH_SUFFIXES, *_IMAGES)):
            raise InputError("path", f"got {one}, whose suffix {one.suffix!r} is unknown; expected {known}")
        else:
            found.append(one)
    return tuple(found)


def _is(path: Path, suffixes: tuple[str, ...]) -> bool:
    return path.suffix.lower() in suffixes
