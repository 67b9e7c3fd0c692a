"""The files that a mesh file is made of: itself, its materials, textures and buffers; what is missing is named."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from simulator.errors import InputError
from simulator.io.images import picture_shape

_PLY_HEADER = 2**16
_GLB_MAGIC, _GLB_JSON = 0x46546C67, 0x4E4F534A
_PICTURES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tga", ".tif", ".tiff", ".gif")
# Ways to pack a glTF file that would need decoders of their own.
_PACKED = ("KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_texture_basisu")


def mesh_inputs(path: Path) -> list[Path]:
    """Return the files that decide what a mesh file looks like, itself first.

    Raises:
        InputError: when one is missing or no picture, or the file is packed in a way that is not read.
    """
    if not path.is_file():
        msg = f"{path}: no such file; expected a mesh (OBJ, PLY, STL, glTF or GLB)"
        raise InputError(msg)
    names = {".obj": _of_obj, ".ply": _of_ply, ".gltf": _of_gltf, ".glb": _of_gltf}.get(path.suffix.lower(), _nothing)
    found = [path]
    for user, name in names(path):
        file = user.parent / name
        if not file.is_file():
            msg = f"{user}: it needs the file {name!r}, and there is none at {file}; put it there, or mend the name"
            raise InputError(msg)
        if file.suffix.lower() in _PICTURES:
            picture_shape(file)
        found.append(file)
    return list(dict.fromkeys(found))


def _nothing(path: Path) -> Iterator[tuple[Path, str]]:
    return iter(())


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
                msg = f"{materials}: its texture {line.strip()!r} has options, which are not read; remove them"
                raise InputError(msg)
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
        msg = f"{path}: it needs {', '.join(packed)}, which is not read; export it without compression"
        raise InputError(msg)
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
                raise ValueError("wrong first bytes")  # noqa: EM101, TRY003
            content = content[20 : 20 + length]
        tree = json.loads(content)
    except (ValueError, struct.error) as error:
        msg = f"{path} is no glTF file, or damaged ({error}): export it again"
        raise InputError(msg) from error
    if not isinstance(tree, dict):
        msg = f"{path} is no glTF file: its JSON is no object"
        raise InputError(msg)
    return tree
