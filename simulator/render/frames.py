"""Rendered frames, and how they become one clip."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.render.gbuffer import GBuffer
from simulator.render.hidden import HiddenLayer
from simulator.render.repair import firefly_dimming, repair
from simulator.types import FARTHEST_M, Clip, View


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
    )


def dim_fireflies_in(frames: list[Frame]) -> dict[str, float]:
    """Dim lone glaring pixels, in all bands alike, and return their share and that of the light they lose."""
    before = sum(float(frame.rgb.sum(dtype=np.float64)) for frame in frames)
    dimmed = 0
    for frame in frames:
        factor = firefly_dimming(frame.rgb)[..., np.newaxis]
        frame.rgb = frame.rgb * factor
        frame.bands = None if frame.bands is None else frame.bands * factor
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
    """Collect what was asked for; see `simulator.render.outputs`."""
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
