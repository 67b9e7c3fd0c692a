"""Rendered frames: what they hold beside colour and depth, how broken pixels are repaired, and how they become one clip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.render.gbuffer import GBuffer
from simulator.render.hidden import HiddenLayer
from simulator.types import FARTHEST_M, Clip, Surroundings, View

Output = Literal["shape_id", "normal", "albedo", "motion", "hidden"]
OUTPUTS: tuple[str, ...] = get_args(Output)
"""What may be asked for:

- ``shape_id``: int32 ``(T, H, W)``, number of the shape at the pixel's centre, -1 where nothing is seen;
- ``normal``: float32 ``(T, H, W, 3)``, unit shading normal in world axes (x right, y down, z into the scene), towards the
  camera; zero where nothing is seen;
- ``albedo``: float32 ``(T, H, W, 3)``, diffuse reflectance, linear RGB;
- ``motion``: float32 ``(T, H, W, 3)``, where the surface point at the pixel's centre will be in the next frame: pixels to the
  right, pixels down, metres away; zero in the last frame. ``motion_valid``, bool ``(T, H, W)``, is true where that point is
  seen in both frames (in the image and not hidden);
- ``hidden``: the surfaces behind those that are seen, one layer after the other: ``hidden1_rgb`` float32 ``(T, H, W, 3)``,
  ``hidden1_depth_m`` float32 ``(T, H, W)``, ``hidden1_valid`` bool ``(T, H, W)``, then ``hidden2_...``.
"""


def check_outputs(outputs: Sequence[str]) -> None:
    """Refuse what cannot be rendered.

    Raises:
        InputError: an unknown name, or one that is given twice.
    """
    for name in outputs:
        if name not in OUTPUTS:
            raise InputError("render.outputs", f"got {name!r}, expected some of {', '.join(OUTPUTS)}")
    if len(set(outputs)) != len(outputs):
        raise InputError("render.outputs", f"got {list(outputs)}, in which a name comes twice; name each once")


# More broken pixels than this mean a broken scene, not a path tracer's rare accident.
_MAX_BROKEN_SHARE = 1e-3
_FIREFLY_RATIO = np.float32(2)


def repair(rgb: NDArray[np.float32]) -> tuple[NDArray[np.float32], int]:
    """Replace pixels that are not finite or are negative by the median of their sound neighbours.

    A path tracer divides by probabilities and now and then yields a NaN; one such pixel would spread over the whole
    measurement. Bright pixels are left alone: clamping them would bias the light.

    Args:
        rgb: ``(H, W, n)``, colour and any bands.

    Returns:
        The repaired image and the number of pixels that were replaced.

    Raises:
        RuntimeError: when more than 0.1 % of the pixels (and more than one) are broken.
    """
    broken = ~np.all(np.isfinite(rgb) & (rgb >= 0), axis=-1)
    count = int(np.count_nonzero(broken))
    if count == 0:
        return rgb, 0
    if count > max(1, _MAX_BROKEN_SHARE * broken.size):
        msg = f"{count} of {broken.size} rendered pixels are not finite or negative: the scene holds broken values"
        raise RuntimeError(msg)
    repaired = rgb.copy()
    for row, column in np.argwhere(broken):
        window = (slice(max(row - 1, 0), row + 2), slice(max(column - 1, 0), column + 2))
        sound = rgb[window][~broken[window]]
        repaired[row, column] = np.median(sound, axis=0) if len(sound) else 0.0
    return repaired, count


def firefly_dimming(rgb: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the factors ``(H, W)`` in 0..1 that dim lone bright pixels to twice their second brightest neighbour.

    Where small lamps light wet walls, one path in thousands finds a lamp's mirror image by way of another wall; its pixel
    glares for want of the other paths that would share its light. Highlights of 2 x 2 pixels and more stay, and lines but
    for their ends.

    Args:
        rgb: ``(H, W, 3)``; images of one row or column are left as they are.
    """
    light = rgb.mean(axis=-1)
    rows, columns = light.shape
    if min(rows, columns) < 2:
        return np.ones_like(light)
    around = np.pad(light, 1, constant_values=-np.inf)
    places = [(row, column) for row in range(3) for column in range(3) if (row, column) != (1, 1)]
    neighbours = np.stack([around[row : row + rows, column : column + columns] for row, column in places])
    limit = _FIREFLY_RATIO * np.partition(neighbours, -2, axis=0)[-2]
    glaring = light > limit
    return np.divide(limit, light, out=np.ones_like(light), where=glaring)


@dataclass
class Frame:
    """One rendered frame.

    Attributes:
        rgb: float32 ``(H, W, 3)``, linear radiance.
        depth_m: float64 ``(H, W)``, ``inf`` where nothing is seen.
        samples: light paths per pixel.
        repaired: number of pixels that were broken.
        outputs: what was asked for beside colour and depth.
        hits: what the pixels' centres see, where ``outputs`` ask for it.
        layers: hidden layers, nearest first, likewise.
        bands: float32 ``(H, W, N)``, or None.
        around: light ``(h, w, 3)`` and depth ``(h, w)`` of the whole field in coarse pixels, where the view has a margin.
        came_from: motion ``(H, W, 3)`` of the frame before this one, and which of its points are seen here ``(H, W)``.
    """

    rgb: NDArray[np.float32]
    depth_m: NDArray[np.float64]
    samples: int
    repaired: int
    outputs: tuple[str, ...]
    hits: GBuffer | None
    layers: list[HiddenLayer]
    bands: NDArray[np.float32] | None = None
    around: tuple[NDArray[np.float32], NDArray[np.float64]] | None = None
    came_from: tuple[NDArray[np.float32], NDArray[np.bool_]] | None = None


def join_frames(
    frames: list[Frame], view: View, frames_per_second: float, source: dict[str, Any], label: str | None
) -> Clip:
    """Return the clip of some frames; ``source`` gains the samples per pixel and the number of repaired pixels."""
    facts = {"samples_per_pixel": frames[0].samples, "repaired_pixels": sum(frame.repaired for frame in frames)}
    depth_m, valid = _finite_depth([frame.depth_m for frame in frames], view)
    return Clip(
        rgb=np.stack([frame.rgb for frame in frames]),
        depth_m=depth_m,
        valid=valid,
        frame_edges_s=np.arange(len(frames) + 1) / frames_per_second,
        label=label,
        source=source | facts,
        extras=_extras(frames, view),
        surroundings=_surroundings(frames, view),
    )


def _surroundings(frames: list[Frame], view: View) -> Surroundings | None:
    around = [frame.around for frame in frames if frame.around is not None]
    if not around:
        return None
    light, depths = zip(*around, strict=True)
    return Surroundings(np.stack(light), _finite_depth(list(depths), view)[0], view.coarse_field[1])


def dim_fireflies_in(frames: list[Frame]) -> dict[str, float]:
    """Dim lone glaring pixels, in all bands alike, and return their share and that of the light that the image loses."""
    before = sum(float(frame.rgb.sum(dtype=np.float64)) for frame in frames)
    dimmed = 0
    for frame in frames:
        factor = firefly_dimming(frame.rgb)[..., np.newaxis]
        frame.rgb = frame.rgb * factor
        frame.bands = None if frame.bands is None else frame.bands * factor
        if frame.around is not None:
            light, depth = frame.around
            frame.around = light * firefly_dimming(light)[..., np.newaxis], depth
        dimmed += int(np.count_nonzero(factor < 1))
    after = sum(float(frame.rgb.sum(dtype=np.float64)) for frame in frames)
    lost = (before - after) / before if before else 0.0
    return {"firefly_share": dimmed / sum(frame.rgb[..., 0].size for frame in frames), "firefly_light_share": lost}


def _finite_depth(depths: list[NDArray[np.float64]], view: View) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return depth with the far one where nothing is seen (a depth is never inf), and where something is."""
    depth = np.stack(depths)
    valid = np.isfinite(depth)
    return np.where(valid, depth, min(view.far_m, FARTHEST_M)).astype(np.float32), valid


def _extras(frames: list[Frame], view: View) -> dict[str, NDArray[Any]]:
    """Collect what was asked for; see `simulator.render.frames`."""
    extras: dict[str, NDArray[Any]] = {}
    outputs = frames[0].outputs
    bands = [frame.bands for frame in frames if frame.bands is not None]
    if bands:
        extras["bands"] = np.stack(bands)
    for name in ("shape_id", "normal", "albedo"):
        if name in outputs:
            extras[name] = np.stack([getattr(frame.hits, name) for frame in frames])
    if "motion" in outputs:
        shape = frames[0].rgb.shape
        last = (np.zeros(shape, np.float32), np.zeros(shape[:2], bool))
        moves = [*(frame.came_from or last for frame in frames[1:]), last]
        extras["motion"] = np.stack([motion for motion, _ in moves])
        extras["motion_valid"] = np.stack([seen for _, seen in moves])
    for number, layers in enumerate(zip(*(frame.layers for frame in frames), strict=True), start=1):
        depth_m, valid = _finite_depth([layer.depth_m for layer in layers], view)
        extras[f"hidden{number}_rgb"] = np.stack([repair(layer.rgb)[0] for layer in layers])
        extras[f"hidden{number}_depth_m"] = depth_m
        extras[f"hidden{number}_valid"] = valid
    return extras
