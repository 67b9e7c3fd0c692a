"""How the triangles of a mesh file look: textures in linear light, flat and vertex colours, gloss."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.models.resampling import area_mean
from scenes.surfaces import face_cross
from simulator.colour import decode_srgb_picture, srgb_to_linear
from simulator.errors import InputError

Array = NDArray[np.float64]
_NEUTRAL = 0.5  # reflectance of what says nothing of its colour
# trimesh gives what has texture coordinates and no material a picture of 2 x 2 such pixels.
_MADE_UP = (100, 100, 100)
# Pictures are a few hundred pixels wide: larger textures would only cost memory and alias.
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
    """Return how a ``trimesh.Trimesh`` looks.

    Args:
        mesh: the geometry.
        kept: ``(F,)`` which of its faces count.
        path: its file, which says whether vertex colours are sRGB (not in glTF).

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
    """Return a material's linear colour factor, its picture or None, and its roughness."""
    if hasattr(material, "baseColorFactor"):  # glTF
        factor = _scaled(material.baseColorFactor, 1.0)
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


def _scaled(values: Any, default: float) -> Array:
    """Return R, G, B as floats; trimesh keeps factors as bytes."""
    if values is None:
        return np.full(3, default)
    array = np.asarray(values)
    return array[:3] / (255.0 if array.dtype == np.uint8 else 1.0)


def _coat(roughness: float) -> float | None:
    """Count in tenths, so that parts of about the same gloss can be joined."""
    return None if roughness > _MATT_ROUGHNESS else max(round(roughness, 1), _SMOOTHEST)


def _texture(image: Any, factor: tuple[float, ...], path: Path) -> NDArray[np.float32]:
    try:
        pixels = np.asarray(image.convert("RGB"))
    except (OSError, ValueError, SyntaxError) as error:
        msg = f"{path}: a texture of it cannot be decoded ({error}); replace it"
        raise InputError(msg) from error
    return _decoded(pixels.tobytes(), pixels.shape, factor)


@functools.lru_cache(maxsize=16)
def _decoded(pixels: bytes, shape: tuple[int, ...], factor: tuple[float, ...]) -> NDArray[np.float32]:
    """Return one object for equal pictures, so that their triangles are joined."""
    light = decode_srgb_picture(np.frombuffer(pixels, np.uint8).reshape(shape))
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
