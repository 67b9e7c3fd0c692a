"""A user's own Mitsuba scene, seen through our pinhole: its shapes, materials and lights, from where its camera stands.

Its integrator, film and field of view are replaced, its file names made absolute, its shapes numbered. Mitsuba's parser
runs first and says which files the scene is made of; only then is anything loaded.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.render.backend import home_for_kernels, mitsuba
from simulator.render.gbuffer import GBuffer, centre_gbuffer
from simulator.render.mitsuba_scene import SURROUNDINGS, UNITS_PER_M, cameras, path_tracer, shape_name
from simulator.types import View

# Parsing gives the same for every variant; loading needs the active one.
_ANY_VARIANT = "scalar_rgb"
# An infinite far depth is filled this many times the near depth deep, as by the families that are drawn.
_DEPTHS_OF_INFINITY = 50.0
_ROUNDING = 1e-5
# Mitsuba's own defaults, in the scene's units: what its author's camera sees is seen here.
_CLIPPING = {"near_clip": 1e-2, "far_clip": 1e4}


@dataclass(frozen=True)
class OwnScene:
    """A loaded scene; it takes a stage's place in a `Renderer`.

    Attributes:
        path: its file.
        loaded: the ``mitsuba.Scene``.
        to_world: ``(4, 4)``, from camera axes (x right, y down, z into the scene) to the scene's world, in its units.
        shape_ids: the names by which the file calls its shapes, in the order of their numbers.
    """

    path: Path
    loaded: Any
    to_world: NDArray[np.float64]
    shape_ids: tuple[str, ...]

    def look(self, view: View, metres_per_unit: float | None) -> tuple[GBuffer, float]:
        """Return what the pixels' centres see, in metres and camera axes, and the metres that one unit stands for.

        ``metres_per_unit`` None scales the scene about its camera, so that its depths lie in the middle (in log z) of the
        view's.

        Raises:
            InputError: when nothing is seen, or depths lie outside near..far.
        """
        hits = centre_gbuffer(self.loaded)
        points, seen = self._in_camera_axes(hits), np.isfinite(hits.depth_m)
        if not seen.any():
            wide, high = (2 * math.degrees(math.atan(half)) for half in (view.tan_half_width, view.tan_half_height))
            place = f"the scene lies behind it or beside the view ({wide:.3g} x {high:.3g} degrees)"
            raise InputError(self.path, f"its camera sees no surface: {place}; turn its sensor's to_world")
        depth = points[seen, 2]
        scale = _fitting_scale(self.path, depth, view) if metres_per_unit is None else metres_per_unit
        check_depths(self.path, depth * scale, seen.size, view)
        local = replace(
            hits,
            depth_m=np.where(seen, points[..., 2] * scale, np.inf),
            point_m=(points * scale).astype(np.float32),
            normal=(hits.normal @ self.to_world[:3, :3]).astype(np.float32),
        )
        return local, scale

    def depth_beside(self, scale: float) -> NDArray[np.float64]:
        """Return z in metres of what the camera of the whole field sees; ``inf`` where nothing is seen."""
        hits = centre_gbuffer(self.loaded, SURROUNDINGS)
        return np.where(np.isfinite(hits.depth_m), self._in_camera_axes(hits)[..., 2] * scale, np.inf)

    def _in_camera_axes(self, hits: GBuffer) -> NDArray[np.float64]:
        """Return the points that are seen in the scene's own units."""
        return (hits.point_m * UNITS_PER_M - self.to_world[:3, 3]) @ self.to_world[:3, :3]


def load_own_scene(path: Path, view: View, max_depth: int) -> OwnScene:
    """Load a Mitsuba XML file with the active variant, a path tracer and the view's pinhole at its first sensor's place.

    A scene without a sensor is seen from its origin, along its z axis, with its y axis pointing down.

    Raises:
        InputError: when Mitsuba rejects the file, a file that it names is missing, nothing shines, or it holds what has no
            depth (participating media).
    """
    mi = mitsuba()
    state, _ = _parsed(path)
    root = state.root
    sensor_to_world, clipping = None, _CLIPPING
    names = []
    for key, node in _children(state):
        if node.type == mi.ObjectType.Sensor and sensor_to_world is None:
            sensor_to_world = np.array(node.props.get("to_world", mi.ScalarTransform4d()).matrix, dtype=np.float64)
            clipping = {key: float(node.props.get(key, default)) for key, default in _CLIPPING.items()}
        if node.type in (mi.ObjectType.Sensor, mi.ObjectType.Integrator):
            del root.props[key]
        elif node.type == mi.ObjectType.Shape and node.props.plugin_name() != "shapegroup":
            names.append(node.props.id())
            node.props.set_id(shape_name(len(names) - 1))
    if sensor_to_world is None:
        sensor_to_world = np.diag([-1.0, -1.0, 1.0, 1.0])
    placed = clipping | {"to_world": mi.ScalarTransform4f(sensor_to_world)}
    with _mitsuba_errors(path):
        for name, camera in cameras(view).items():
            root.props[name] = mi.load_dict(camera | placed)
        root.props["integrator"] = mi.load_dict(path_tracer(max_depth))
        loaded = mi.parser.instantiate(_config(mi.variant()), state)
    if not loaded.emitters():
        raise InputError(
            path, "nothing in it shines, its image would be black; add an emitter such as <emitter type='constant'/>"
        )
    # Mitsuba's cameras have x to the left and y up.
    return OwnScene(path, loaded, sensor_to_world @ np.diag([-1.0, -1.0, 1.0, 1.0]), tuple(names))


def own_scene_files(path: Path) -> list[Path]:
    """Return the files that a Mitsuba XML file is made of, itself first: includes, meshes, textures, spectra, volumes.

    Raises:
        InputError: when it cannot be parsed, or a file is missing.
    """
    return _parsed(path)[1]


def check_depths(path: Path, depth_m: NDArray[np.floating], pixels: int, view: View) -> None:
    """Refuse a file of which an image of so many pixels shows depths (metres) outside of the view's near..far.

    Raises:
        InputError: with the share of the pixels, the range that was found and the cure.
    """
    outside = (depth_m < view.near_m * (1 - _ROUNDING)) | (depth_m > view.far_m * (1 + _ROUNDING))
    if outside.any():
        raise InputError(
            path,
            f"{np.count_nonzero(outside) / pixels:.1%} of the pixels see a depth outside near..far = "
            f"{view.near_m * 100:.4g}..{view.far_m * 100:.4g} cm; the depths seen are "
            f"{depth_m.min() * 100:.4g}..{depth_m.max() * 100:.4g} cm: change length_of_unit_cm (leave it out to fit), move "
            "the scene, or set scene.near_cm and scene.far_cm",
        )


def _fitting_scale(path: Path, depth: NDArray[np.float64], view: View) -> float:
    near, far = view.near_m, min(view.far_m, _DEPTHS_OF_INFINITY * view.near_m)
    nearest, farthest = float(depth.min()), float(depth.max())
    if nearest <= 0 or farthest / nearest > far / near * (1 + _ROUNDING):
        raise InputError(
            path,
            f"it is seen from {nearest:.4g} to {farthest:.4g} of its units deep, a ratio of "
            f"{farthest / nearest:.4g}; near..far = {near * 100:.4g}..{far * 100:.4g} cm is a ratio of {far / near:.4g}: "
            "widen scene.near_cm and scene.far_cm, or bring its back wall nearer to its camera",
        )
    return math.sqrt(near * far / (nearest * farthest))


def _parsed(path: Path) -> tuple[Any, list[Path]]:
    """Return the parsed scene with absolute file names and in today's syntax, and the files that it is made of."""
    if not path.is_file():
        raise InputError(path, "no such file; expected a Mitsuba scene in XML")
    with home_for_kernels():  # a process that only parses has not activated a variant
        mi = mitsuba()
    before, folder = mi.file_resolver(), path.parent.resolve()
    resolver = mi.FileResolver()
    resolver.clear()  # of the current directory, on which data must not depend
    resolver.append(str(folder))
    mi.set_file_resolver(resolver)
    try:
        config = _config(_ANY_VARIANT)
        with _mitsuba_errors(path):
            state = mi.parser.parse_file(config, str(path.absolute()))
            mi.parser.transform_all(config, state)
        files = [path]
        for name in state.files[1:]:
            files.append(_beside(resolver, folder, str(name)))
            _check_part(path, "an <include>", str(name), files[-1])
        for node in state.nodes:
            for key in list(node.props.keys()):
                # Only these are looked at: Mitsuba takes what was looked at for known, and would keep misspelt names quiet.
                if key.endswith("filename") and node.props.type(key) == mi.Properties.Type.String:
                    value = str(node.props[key])
                    file = _beside(resolver, folder, value)
                    kind = str(node.type).rpartition(".")[2].lower()
                    _check_part(path, f"its {kind} {node.props.plugin_name()!r}", value, file)
                    node.props[key] = str(file)
                    files.append(file)
    finally:
        mi.set_file_resolver(before)
    _refuse_what_has_no_depth(path, state)
    return state, list(dict.fromkeys(files))


def _beside(resolver: Any, folder: Path, name: str) -> Path:
    """Return the absolute path of a file that is named from the XML file's folder, or from a ``<path>`` of its own."""
    found = Path(str(resolver.resolve(name)))  # as it was given where there is none
    return found if found.is_absolute() else folder / found


def _check_part(path: Path, user: str, value: str, file: Path) -> None:
    if not file.is_file():
        raise InputError(
            path,
            f"{user} needs the file {value!r}, and there is none at {file}; "
            "put it beside the XML file, or write its path from there",
        )


def _refuse_what_has_no_depth(path: Path, state: Any) -> None:
    mi = mitsuba()
    if state.root.type != mi.ObjectType.Scene:
        raise InputError(path, f"its outermost element is a {state.root.props.plugin_name()!r}, expected <scene>")
    if any(node.type == mi.ObjectType.Medium for node in state.nodes):
        raise InputError(
            path, "it holds a participating medium (fog, smoke), which has no depth of its own; remove its <medium>"
        )


def _children(state: Any) -> list[tuple[str, Any]]:
    """Return the scene's own parts and the names of their properties, in the file's order."""
    mi = mitsuba()
    return [
        (key, state.nodes[value.index()])
        for key, value in state.root.props.items()
        if isinstance(value, mi.Properties.ResolvedReference)
    ]


def _config(variant: str) -> Any:
    """Return how to parse: shapes stay apart, so that each keeps its number."""
    mi = mitsuba()
    config = mi.parser.ParserConfig(variant)
    config.merge_meshes = False
    config.merge_equivalent = False
    config.parallel = False
    return config


@contextmanager
def _mitsuba_errors(path: Path) -> Iterator[None]:
    """Turn what Mitsuba says against a file into one line."""
    try:
        yield
    except (RuntimeError, ValueError, TypeError) as error:
        said = " ".join(re.sub(r"\[[\w.]+:\d+\] ", "", str(error)).split())
        raise InputError(path, f"Mitsuba rejects it: {said}") from error
