"""The tiles of a clip: its radiance, its depth and its extras as pictures on the scales of a whole sheet."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.preview.colours import depth_colours, id_colours, motion_colours, normal_colours, seen_colours
from simulator.preview.drawing import encoded, white_level
from simulator.types import Clip

_AT_REST_PX = 0.01
_FAST_PERCENTILE = 98  # of what moves: a finger's tip that flies past the camera must not pale all the rest
_HIDDEN_DEPTH = re.compile(r"hidden(\d+)_depth_m")


@dataclass(frozen=True)
class Tile:
    """A named picture, uint8 ``(h, w, 3)``."""

    name: str
    pixels: NDArray[np.uint8]


@dataclass(frozen=True)
class Scales:
    """What white, the first and last depth colour and the full motion colours stand for, in all of a sheet.

    Attributes:
        white: linear radiance.
        near_m: metres.
        far_m: metres.
        motion_px: pixels per frame, 0 where nothing moves.
    """

    white: float
    near_m: float
    far_m: float
    motion_px: float


def common_scales(clips: Sequence[Clip], lit: Sequence[Sequence[int]], coloured: Sequence[Sequence[int]]) -> Scales:
    """Return scales that suit what is shown of each clip.

    Args:
        clips: at least one.
        lit: frames of each whose radiance is shown.
        coloured: frames of each whose depth and extras are shown.
    """
    seen: list[NDArray[np.float32]] = []
    moving = [np.zeros(0, np.float32)]
    for clip, frames in zip(clips, map(list, coloured), strict=True):
        seen.append(clip.depth_m[frames][clip.valid[frames]])
        for name, depth in clip.extras.items():
            if found := _HIDDEN_DEPTH.fullmatch(name):
                seen.append(depth[frames][clip.extras[f"hidden{found[1]}_valid"][frames]])
        if "motion" in clip.extras:
            moved = clip.extras["motion"][frames][clip.valid[frames]]
            speed = np.hypot(moved[:, 0], moved[:, 1])
            moving.append(speed[speed > _AT_REST_PX])
    depths = np.concatenate(seen)
    if depths.size == 0:
        depths = np.concatenate([clip.depth_m.ravel() for clip in clips])
    speeds = np.concatenate(moving)
    return Scales(
        white_level(clip.rgb[list(frames)] for clip, frames in zip(clips, lit, strict=True)),
        float(depths.min()),
        float(depths.max()),
        float(np.percentile(speeds, _FAST_PERCENTILE)) if speeds.size else 0.0,
    )


def radiance_tile(clip: Clip, frame: int, scales: Scales, name: str = "radiance") -> Tile:
    """Return what the scene's light looks like."""
    return Tile(name, encoded(clip.rgb[frame], scales.white))


def depth_tile(clip: Clip, frame: int, scales: Scales) -> Tile:
    """Return the depth in colours."""
    return Tile("depth", depth_colours(clip.depth_m[frame], clip.valid[frame], scales.near_m, scales.far_m))


def extra_tiles(clip: Clip, frame: int, scales: Scales) -> list[Tile]:
    """Return the extras that a picture can show, in the order in which rendering names them."""
    extras = {name: values[frame] for name, values in clip.extras.items()}
    tiles: list[Tile] = []
    if "shape_id" in extras:
        tiles.append(Tile("ids", id_colours(extras["shape_id"])))
    if "normal" in extras:
        tiles.append(Tile("normals", normal_colours(extras["normal"])))
    if "albedo" in extras:  # a reflectance: white is 1, whatever the light
        tiles.append(Tile("albedo", encoded(extras["albedo"])))
    if "motion" in extras:
        largest = scales.motion_px or 1.0
        colours = motion_colours(extras["motion"], clip.valid[frame], extras["motion_valid"], largest)
        tiles.append(Tile("motion", colours))
    for name in extras:
        if found := _HIDDEN_DEPTH.fullmatch(name):
            layer = f"hidden{found[1]}"
            valid = extras[f"{layer}_valid"]
            colours = seen_colours(encoded(extras[f"{layer}_rgb"], scales.white), valid)
            tiles.append(Tile(f"hidden {found[1]}", colours))
            depth = depth_colours(extras[name], valid, scales.near_m, scales.far_m)
            tiles.append(Tile(f"depth {found[1]}", depth))
    return tiles
