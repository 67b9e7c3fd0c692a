"""An image as a flat scene: a plane across the view that shines as the image says; nothing is rendered.

Images and textures change their size by averaging areas: no light is lost and nothing aliases.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.images import read_light
from simulator.types import FARTHEST_M, Clip, View


def area_mean(
    values: NDArray[np.floating], shape: Sequence[int], window: Sequence[tuple[float, float]] | None = None
) -> NDArray[np.float32]:
    """Return the mean over the area of each new pixel; where pixels agree they keep their values.

    Args:
        values: ``(H, W, ...)`` linear light.
        shape: rows and columns of the result.
        window: first and last edge along rows and columns, in pixels of ``values`` and inside them; None is all of it.

    Returns:
        float32 ``(*shape, ...)``.

    Example:
        >>> area_mean(np.array([[1.0, 2.0, 3.0]]), (1, 2)).tolist()
        [[1.3333333730697632, 2.6666667461395264]]
    """
    result = np.asarray(values, dtype=np.float64)
    for axis, size in enumerate(shape):
        first, last = (0.0, float(values.shape[axis])) if window is None else window[axis]
        if size == values.shape[axis] and (first, last) == (0.0, float(size)):
            continue
        result = np.moveaxis(_along_rows(np.moveaxis(result, axis, 0), np.linspace(first, last, size + 1)), 0, axis)
    return result.astype(np.float32)


def _along_rows(values: NDArray[np.float64], edges: NDArray[np.float64]) -> NDArray[np.float64]:
    """Take means between edges by differences of the running sum, which is linear within a pixel."""
    running = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
    below = np.minimum(edges.astype(int), len(values) - 1)
    share = (edges - below).reshape(-1, *([1] * (values.ndim - 1)))
    return np.diff(running[below] + share * values[below], axis=0) / (edges[1] - edges[0])


def plane_depth(view: View, plane_cm: float | None) -> float:
    """Return the plane's depth in metres: as given, else midway between near and far in disparity.

    Raises:
        InputError: when it lies outside near..far.
    """
    if plane_cm is None:
        return min(2 / (1 / view.near_m + 1 / view.far_m), FARTHEST_M) if math.isfinite(view.near_m) else FARTHEST_M
    if not view.near_m <= plane_cm * 1e-2 <= view.far_m:
        raise InputError(
            "plane_cm",
            f"got {plane_cm:g}, which is outside near..far = {view.near_m * 100:.4g}..{view.far_m * 100:.4g} cm; "
            "choose a depth inside, or set scene.near_cm and scene.far_cm",
        )
    return plane_cm * 1e-2


def image_clip(path: Path, view: View, depth_m: float, outputs: tuple[str, ...], source: dict[str, Any]) -> Clip:
    """Return an image that fills the view, at one depth: one frame of 1 s.

    The largest centred part of the view's proportions is taken, and averaged to the view's pixels. Of the renderer's
    ``outputs``, the plane is shape 0, faces the camera and reflects nothing.

    Raises:
        InputError: when it cannot be read, or motion or hidden layers are asked of it.
    """
    if "motion" in outputs:
        raise InputError("render.outputs", f"motion needs at least 2 frames, and the image {path} is one; leave it out")
    if "hidden" in outputs:
        raise InputError("render.outputs", f"nothing is hidden behind the image {path}; leave hidden out")
    light = read_light(path)
    factor = min(have / want for have, want in zip(light.shape, view.shape, strict=False))
    margins = [(have - factor * want) / 2 for have, want in zip(light.shape, view.shape, strict=False)]
    window = [(margin, have - margin) for margin, have in zip(margins, light.shape, strict=False)]
    rgb = np.maximum(area_mean(light, view.shape, window), 0)  # differences of sums may round below zero
    frame = (1, *view.shape)
    extras: dict[str, NDArray[Any]] = {}
    if "shape_id" in outputs:
        extras["shape_id"] = np.zeros(frame, np.int32)
    if "normal" in outputs:
        extras["normal"] = np.broadcast_to(np.array([0, 0, -1], np.float32), (*frame, 3)).copy()
    if "albedo" in outputs:
        extras["albedo"] = np.zeros((*frame, 3), np.float32)
    return Clip(
        rgb=rgb[np.newaxis],
        depth_m=np.full(frame, depth_m, np.float32),
        valid=np.ones(frame, bool),
        frame_edges_s=np.array([0.0, 1.0]),
        source=source,
        extras=extras,
    )
