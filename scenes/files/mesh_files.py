"""Meshes from files: OBJ, PLY, STL, glTF and GLB through trimesh, as triangles in our axes with textures of linear light.

What is read: geometry of all nodes in place, normals, texture coordinates, base colour (texture, factor, vertex and face
colours), gloss. What is not: transparency, metal, emission, normal maps, skins and animation.
"""

from __future__ import annotations

import functools
import json
import math
import struct
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from scenes.layout import rotation
from scenes.meshes import face_cross, unit, welded
from simulator.colour import decode_srgb_image, srgb_to_linear
from simulator.errors import InputError
from simulator.io.images import area_mean, image_shape

Array = NDArray[np.float64]
Up = Literal["auto", "y", "z"]
MESH_SUFFIXES = (".obj", ".ply", ".stl", ".gltf", ".glb")

_PLY_HEADER = 2**16
_GLB_MAGIC, _GLB_JSON = 0x46546C67, 0x4E4F534A
_IMAGES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tga", ".tif", ".tiff", ".gif")
# Ways to pack a glTF file that would need decoders of their own.
_PACKED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_texture_basisu")


def mesh_inputs(path: Path) -> list[Path]:
    """Return the files that decide what a mesh file looks like, itself first.

    Raises:
        InputError: when one is missing or is not an image, or the file is packed in a way that is not read.
    """
    if not path.is_file():
        raise InputError(path, "no such file; expected a mesh (OBJ, PLY, STL, glTF or GLB)")
    names = {".obj": _of_obj, ".ply": _of_ply, ".gltf": _of_gltf, ".glb": _of_gltf}.get(path.suffix.lower())
    found = [path]
    for user, name in names(path) if names else ():
        file = user.parent / name
        if not file.is_file():
            raise InputError(user, f"it needs {name!r}, and there is no file {file}; put it there, or mend the name")
        if file.suffix.lower() in _IMAGES:
            image_shape(file)
        found.append(file)
    return list(dict.fromkeys(found))


def _of_obj(path: Path) -> Iterator[tuple[Path, str]]:
    """Yield the material file and its colour textures; trimesh reads one material file."""
    with path.open(encoding="utf-8", errors="replace") as lines:
        library = next((line[6:].strip() for line in lines if line.startswith("mtllib")), None)
    if library is None:
        return
    yield path, library
    materials = path.parent / library
    for line in materials.read_text(encoding="utf-8", errors="replace").splitlines():
        key, _, name = line.strip().partition(" ")
        if key.lower() == "map_kd":
            if name.strip().startswith("-"):
                raise InputError(materials, f"options of the texture {line.strip()!r} are not read; remove them")
            yield path, name.strip()  # beside the OBJ file, even if its material file is elsewhere


def _of_ply(path: Path) -> Iterator[tuple[Path, str]]:
    with path.open("rb") as file:
        header = file.read(_PLY_HEADER).partition(b"end_header")[0].decode("latin-1")
    for line in header.splitlines():
        words = line.split(maxsplit=2)
        if len(words) == 3 and words[0] == "comment" and words[1] == "TextureFile":
            yield path, words[2].strip()


def _of_gltf(path: Path) -> Iterator[tuple[Path, str]]:
    """Yield what lies outside of the file; data within it are ``data:`` addresses or views of its own buffer."""
    tree = _gltf_tree(path)
    packed = [name for name in tree.get("extensionsRequired", []) if name in _PACKED]
    if packed:
        raise InputError(path, f"it needs {', '.join(packed)}, which is not read; export it without compression")
    for part in (*tree.get("buffers", []), *tree.get("images", [])):
        address = part.get("uri", "data:")
        if not address.startswith("data:"):
            yield path, unquote(address)


def _gltf_tree(path: Path) -> dict[str, Any]:
    """Return the JSON tree of a .gltf file, or of the first chunk of a .glb file."""
    content = path.read_bytes()
    try:
        if path.suffix.lower() == ".glb":
            magic, _, _, length, kind = struct.unpack_from("<5I", content)
            if (magic, kind) != (_GLB_MAGIC, _GLB_JSON):
                raise struct.error("wrong first bytes")
            content = content[20 : 20 + length]
        tree = json.loads(content)
    except (ValueError, struct.error) as error:
        raise InputError(path, f"damaged, or not a glTF file ({error}); export it again") from error
    if not isinstance(tree, dict):
        raise InputError(path, "not a glTF file: its JSON is not an object; export it again")
    return tree


_NEUTRAL = 0.5  # reflectance of what says nothing of its colour
# trimesh gives what has texture coordinates and no material an image of 2 x 2 such pixels.
_MADE_UP = (100, 100, 100)
# Images are a few hundred pixels wide: larger textures would only cost memory and alias.
_LARGEST_TEXTURE = 1024
# A rougher coat looks matt, a smoother one only makes noise.
_MATT_ROUGHNESS, _SMOOTHEST = 0.9, 0.15


@dataclass(frozen=True)
class Surface:
    """How a geometry's triangles look, three corners each.

    Attributes:
        colours: linear RGB ``(F, 3, 3)``, by triangle, corner and channel; used where there is no texture.
        uv: ``(3 F, 2)``, v downwards, as Mitsuba counts.
        texture: linear RGB ``(h, w, 3)`` or None; one object for all that share it.
        roughness: of a coat, in tenths; None is matt.
    """

    colours: Array
    uv: Array
    texture: NDArray[np.float32] | None
    roughness: float | None

    def reversed(self) -> Surface:
        """Return the same for triangles whose corners are counted backwards."""
        uv = self.uv.reshape(-1, 3, 2)[:, ::-1].reshape(-1, 2)
        return replace(self, colours=self.colours[:, ::-1], uv=uv)


def surface_of(mesh: Any, kept: NDArray[np.bool_], path: Path) -> Surface:
    """Return how the kept faces ``(F,)`` of a ``trimesh.Trimesh`` look; vertex colours are sRGB but in glTF files.

    Raises:
        InputError: when its texture is damaged.
    """
    count = np.count_nonzero(kept)
    colours = np.full((count, 3, 3), _NEUTRAL)
    uv, texture, roughness = np.zeros((3 * count, 2)), None, None
    visual = mesh.visual
    kind = visual.kind if count else None
    if kind == "texture":
        material = visual.material
        factor, image, roughness = _material(material)
        colours[:] = np.clip(factor, 0, 1)
        if image is not None:
            texture = _texture(image, tuple(factor), path)
            uv = _coordinates(mesh, kept, visual.uv)
    elif kind in ("vertex", "face"):
        raw = (visual.vertex_colors if kind == "vertex" else visual.face_colors)[:, :3] / 255.0
        linear = raw if path.suffix.lower() in (".glb", ".gltf") else srgb_to_linear(raw)
        faces = np.asarray(mesh.faces)[kept]
        colours = linear[faces] if kind == "vertex" else np.repeat(linear[kept][:, np.newaxis], 3, axis=1)
    return Surface(colours.astype(np.float64), uv, texture, roughness)


def baked(colours: Array) -> tuple[Array, NDArray[np.float32]]:
    """Return texture coordinates ``(3 F, 2)`` and a texture that blends each triangle's three colours as its corners do.

    A triangle owns 2 x 2 texels: its colours a, b, c and b + c - a. Bilinear interpolation between these is linear.

    Args:
        colours: ``(F, 3, 3)``, by triangle, corner and channel.
    """
    if np.all(colours == colours[0, 0]):
        return np.zeros((3 * len(colours), 2)), colours[:1, :1].astype(np.float32)
    side = math.ceil(math.sqrt(len(colours)))
    row, column = np.divmod(np.arange(len(colours)), side)
    texture = np.zeros((2 * side, 2 * side, 3), np.float32)
    a, b, c = np.moveaxis(colours, 1, 0)
    for down, across, value in ((0, 0, a), (0, 1, b), (1, 0, c), (1, 1, b + c - a)):
        texture[2 * row + down, 2 * column + across] = value
    corner = np.stack([column, row], axis=-1)[:, np.newaxis] * 2 + 0.5
    uv = (corner + np.array([(0, 0), (1, 0), (0, 1)])) / (2 * side)
    return uv.reshape(-1, 2), texture


def _material(material: Any) -> tuple[Array, Any, float | None]:
    """Return a material's linear colour factor, its image or None, and its roughness."""
    if hasattr(material, "baseColorFactor"):  # glTF
        factor = np.ones(3) if material.baseColorFactor is None else np.asarray(material.baseColorFactor)[:3]
        factor = factor / (255.0 if factor.dtype == np.uint8 else 1.0)  # trimesh keeps factors as bytes
        given = material.roughnessFactor
        return factor, material.baseColorTexture, _coat(1.0 if given is None else float(given))
    image = material.image
    if image is not None and image.size == (2, 2) and np.all(np.asarray(image.convert("RGB")) == _MADE_UP):
        image = None
    words = getattr(material, "kwargs", {})  # of the MTL file, as floats
    factor = np.array(words["kd"], dtype=float) if len(np.atleast_1d(words.get("kd", 0))) == 3 else None
    if factor is None or (image is not None and not factor.any()):  # some exporters write black beside a texture
        factor = np.ones(3) if image is not None else np.full(3, _NEUTRAL)
    shine, strength = words.get("ns", 0.0), np.max(words.get("ks", 0.0))
    # Blinn's exponent n is as wide as a microfacet coat of alpha^2 = 2 / (n + 2), and alpha = roughness^2 (Walter, 2007).
    roughness = (2 / (float(np.max(shine)) + 2)) ** 0.25 if strength > 0 else 1.0
    return factor, image, _coat(roughness)


def _coat(roughness: float) -> float | None:
    """Count in tenths, so that parts of about the same gloss can be joined."""
    return None if roughness > _MATT_ROUGHNESS else max(round(roughness, 1), _SMOOTHEST)


def _texture(image: Any, factor: tuple[float, ...], path: Path) -> NDArray[np.float32]:
    try:
        pixels = np.asarray(image.convert("RGB"))
    except (OSError, ValueError, SyntaxError) as error:
        raise InputError(path, f"a texture of it cannot be decoded ({error}); replace it") from error
    return _decoded(pixels.tobytes(), pixels.shape, factor)


@functools.lru_cache(maxsize=16)
def _decoded(pixels: bytes, shape: tuple[int, ...], factor: tuple[float, ...]) -> NDArray[np.float32]:
    """Return one object for equal images, so that their triangles are joined."""
    light = decode_srgb_image(np.frombuffer(pixels, np.uint8).reshape(shape))
    light = area_mean(light, [min(size, _LARGEST_TEXTURE) for size in shape[:2]])
    return np.clip(light * np.array(factor), 0, 1).astype(np.float32)


def _coordinates(mesh: Any, kept: NDArray[np.bool_], uv: Any) -> Array:
    """Return texture coordinates of the corners, v downwards; those that are missing come from a box around the mesh."""
    faces = np.asarray(mesh.faces)[kept]
    if uv is not None and len(uv) == len(mesh.vertices) and np.isfinite(uv).all():
        return np.asarray(uv)[faces].reshape(-1, 2) * (1, -1) + (0, 1)
    vertices = np.asarray(mesh.vertices, dtype=np.float64)
    within = (vertices - vertices.min(axis=0)) / np.ptp(vertices, axis=0).max()
    facing = np.argmax(np.abs(face_cross(vertices, faces)), axis=1)
    axes = np.array([(2, 1), (0, 2), (0, 1)])[facing]
    return np.take_along_axis(within[faces], axes[:, np.newaxis], axis=2).reshape(-1, 2) * (1, -1) + (0, 1)


# Where a facet leans away from its surroundings by more than this, an edge is meant.
_CREASE_COS = np.cos(np.radians(35))
# From the file's axes to ours: x stays to the right, up becomes -y, and what looks at the viewer keeps doing so.
_TO_OURS = {"y": np.diag([1.0, -1, -1]), "z": np.array([(1.0, 0, 0), (0, 0, -1), (0, 1, 0)])}
_STL_HEAD = 84


@dataclass(frozen=True)
class Part:
    """Triangles of one material; each has three corners of its own.

    Attributes:
        corners: ``(3 F, 3)`` in the file's unit and our axes, counter-clockwise from outside.
        normals: ``(3 F, 3)`` unit.
        uv: ``(3 F, 2)``, v downwards.
        reflectance: linear RGB ``(h, w, 3)``.
        roughness: None is matt.
    """

    corners: Array
    normals: Array
    uv: Array
    reflectance: NDArray[np.float32]
    roughness: float | None


@dataclass(frozen=True)
class Model:
    """All that a file holds; ``centre`` (of its bounding box) and ``radius`` (of the ball around that) in its unit."""

    parts: tuple[Part, ...]
    centre: Array
    radius: float


def load_model(path: Path, up: Up = "auto", turn_degrees: float = 0.0) -> Model:
    """Return the mesh of a file; a process keeps the latest few.

    ``up`` is the axis that points up: ``auto`` is z for STL and y for all others; ``turn_degrees`` turns about the
    upright, to the right as seen from above.

    Raises:
        InputError: when it cannot be read, or has no faces, no size, or vertices that are not finite.
    """
    axis = ("z" if path.suffix.lower() == ".stl" else "y") if up == "auto" else up
    state = path.stat()
    return _load(path, axis, turn_degrees, state.st_mtime_ns, state.st_size)


@functools.lru_cache(maxsize=8)
def _load(path: Path, axis: str, turn_degrees: float, *_when: int) -> Model:
    # A quarter turn to the right takes what is ahead (+z) to the right (+x).
    to_ours = rotation([0, 1, 0], np.radians(turn_degrees)) @ _TO_OURS[axis] if turn_degrees else _TO_OURS[axis]
    pieces = [_triangles(path, *node, to_ours) for node in _nodes(path)]
    if not pieces:
        _refuse_cut_stl(path)
        raise InputError(path, "holds no faces: a point cloud or an empty file; export it as triangles")
    every = np.concatenate([corners for corners, _, _ in pieces])
    low, high = every.min(axis=0), every.max(axis=0)
    centre = (low + high) / 2
    return Model(tuple(_merged(pieces)), centre, float(np.linalg.norm(every - centre, axis=1).max()))


def _refuse_cut_stl(path: Path) -> None:
    """Name the fault of a binary STL file, of 50 bytes a triangle after 80 and their count, whose length is not that."""
    head, size = path.read_bytes()[:_STL_HEAD], path.stat().st_size
    if path.suffix.lower() != ".stl" or len(head) < _STL_HEAD or b"facet" in head:
        return
    count = int.from_bytes(head[80:84], "little")
    expected = _STL_HEAD + 50 * count
    if size != expected:
        raise InputError(
            path,
            f"damaged or cut short: its header promises {count} triangles, which are {expected} bytes, "
            f"and it has {size}; fetch it or export it again",
        )


def _nodes(path: Path) -> list[tuple[Any, Array]]:
    """Return each geometry with its transform; trimesh is heavy, and imported only here."""
    import trimesh

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of NaN, which gets a message of its own
            scene = trimesh.load_scene(path, process=False)
    except Exception as error:  # trimesh raises whatever the broken bytes lead to
        _refuse_cut_stl(path)
        reason = f"cannot be read as a mesh ({type(error).__name__}: {error}); export it again"
        raise InputError(path, reason) from error
    placed = [scene.graph[node] for node in scene.graph.nodes_geometry]
    found = [(scene.geometry[name], np.asarray(matrix, dtype=np.float64)) for matrix, name in placed]
    return [(mesh, matrix) for mesh, matrix in found if len(getattr(mesh, "faces", ()))]


def _triangles(path: Path, mesh: Any, matrix: Array, to_ours: Array) -> tuple[Array, Array, Surface]:
    """Return a geometry's corners and normals in our axes, and how it looks."""
    # Only what came with the file: asking for the attribute would make normals up.
    normals = mesh._cache["vertex_normals"]
    vertices, faces = (np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces))
    broken = ~np.isfinite(vertices).all(axis=1)
    if broken.any():
        raise InputError(path, f"{np.count_nonzero(broken)} of {len(vertices)} vertices are NaN or inf; clean the mesh")
    turn = to_ours @ matrix[:3, :3]
    places = vertices @ turn.T + to_ours @ matrix[:3, 3]
    cross = face_cross(places, faces)
    length = np.linalg.norm(cross, axis=1)
    if not length.max() > 0:
        raise InputError(path, "all its vertices lie on one line or point; check its unit and export it again")
    kept = length > 1e-12 * length.max()
    surface = surface_of(mesh, kept, path)
    faces, cross = faces[kept], cross[kept]
    if np.linalg.det(turn) < 0:  # a mirror turns the corners' order round
        faces, cross, surface = faces[:, ::-1], -cross, surface.reversed()
    corners = places[faces].reshape(-1, 3)
    usable = normals is not None and len(normals) == len(vertices) and np.isfinite(normals).all()
    if not usable:
        return corners, _made_up_normals(corners, cross), surface
    turned = np.asarray(normals, dtype=np.float64) @ np.linalg.inv(turn).astype(np.float64)
    given = unit(turned[faces].reshape(-1, 3))
    flat = np.repeat(unit(cross), 3, axis=0)
    given = np.where(np.linalg.norm(given, axis=1, keepdims=True) > 0, given, flat)
    return corners, given, surface


def _made_up_normals(corners: Array, cross: Array) -> Array:
    """Smooth the facets' normals over what bends gently, and keep the edges."""
    size = float(np.ptp(corners, axis=0).max())
    place = welded(corners, 1e-6 * size)
    flat, weighted = np.repeat(unit(cross), 3, axis=0), np.repeat(cross, 3, axis=0)
    sums = [np.bincount(place, weights=weighted[:, axis]).astype(np.float64) for axis in range(3)]
    smooth = unit(np.stack(sums, axis=1))[place]
    gentle = np.einsum("ij,ij->i", flat, smooth) > _CREASE_COS
    return np.where(gentle[:, np.newaxis], smooth, flat)


def _merged(pieces: list[tuple[Array, Array, Surface]]) -> list[Part]:
    """Join what looks alike: every shape costs rendering time. What has no texture shares one of baked colours."""
    groups: dict[tuple[Any, ...], list[tuple[Array, Array, Surface]]] = {}
    for piece in pieces:
        surface = piece[2]
        key = (None if surface.texture is None else id(surface.texture), surface.roughness)
        groups.setdefault(key, []).append(piece)
    parts = []
    for (_, roughness), group in groups.items():
        corners = np.concatenate([corners for corners, _, _ in group])
        normals = np.concatenate([normals for _, normals, _ in group])
        texture = group[0][2].texture
        if texture is None:
            uv, texture = baked(np.concatenate([surface.colours for _, _, surface in group]))
        else:
            uv = np.concatenate([surface.uv for _, _, surface in group])
        parts.append(Part(corners, normals, uv, texture, roughness))
    return parts
