"""An image as a flat scene: a plane across the view that shines as the image says; nothing is rendered."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.images import filled, read_light
from simulator.types import FARTHEST_M, Clip, View


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
    rgb = filled(read_light(path), view.shape)
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
