"""One picture and one depth map of a volume and the label of each pixel's plane."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from learning.capture import CaptureModel
from learning.display import encode
from learning.estimate import Estimate
from simulator.arrays import like
from simulator.errors import InputError

LIGHT = ("label", "sum")


def assemble(volume: Tensor, labels: Tensor, capture: CaptureModel, light: str = "label") -> Estimate:
    """Return the all-in-focus picture and the depth map.

    Args:
        volume: ``(B, K, C, h, w)`` in the camera's channels, 1 for white, free of the irradiance map.
        labels: ``(B, h, w)`` whole numbers 0 to K - 1, a plane of the capture's stack each.
        capture: the camera.
        light: ``label`` takes each pixel from its label's plane, as the thesis; ``sum`` adds up the planes, for volumes that
            share the light out among them, such as ADMM's.

    Raises:
        InputError: shapes that do not fit, labels outside the volume, or another ``light``.
    """
    planes = len(capture.stack.depths_m)
    if volume.ndim != 5 or volume.shape[1] != planes or labels.shape != (*volume.shape[:1], *volume.shape[3:]):
        msg = (
            f"volume, labels: got shapes {tuple(volume.shape)} and {tuple(labels.shape)}, expected (B, K, C, h, w) and "
            f"(B, h, w) with K = {planes}, the planes of the capture's stack"
        )
        raise InputError(msg)
    if int(labels.min()) < 0 or int(labels.max()) >= planes:
        msg = f"labels: got {int(labels.min())} to {int(labels.max())}, expected planes 0 to {planes - 1}"
        raise InputError(msg)
    disparity = like(capture.plane_disparities(), volume)[labels][:, None]
    inverse = like(np.linalg.pinv(capture.scene_to_camera), volume)
    radiance = torch.einsum("ac,bchw->bahw", inverse, _combined(volume, labels, light))
    return Estimate(encode(radiance, 1.0), disparity)


def _combined(volume: Tensor, labels: Tensor, light: str) -> Tensor:
    """Return the light of each pixel, ``(B, C, h, w)``."""
    if light == "sum":
        return volume.sum(dim=1)
    if light == "label":
        return torch.take_along_dim(volume, labels[:, None, None], dim=1)[:, 0]
    msg = f"light: got {light!r}, expected one of {', '.join(LIGHT)}"
    raise InputError(msg)
