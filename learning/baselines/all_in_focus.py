"""One picture and one depth map of a volume and each pixel's place among its planes."""

from __future__ import annotations

import torch
from torch import Tensor

from learning.capture import CaptureModel
from learning.display import encode
from learning.estimate import Estimate
from simulator.arrays import like
from simulator.errors import InputError

LIGHT = ("label", "sum")


def assemble(volume: Tensor, places: Tensor, capture: CaptureModel, light: str) -> Estimate:
    """Return the all-in-focus picture and the depth map.

    Args:
        volume: ``(B, K, C, h, w)`` in the camera's channels, 1 for white, free of the irradiance map.
        places: ``(B, h, w)``, 0 at the capture's first plane to K - 1 at its last, fractions between two; disparity goes
            linearly from plane to plane.
        capture: the camera.
        light: ``label`` takes each pixel from its place, as the thesis, linearly between the two planes around it; ``sum``
            adds up the planes, for volumes that share the light out among them, such as ADMM's.

    Raises:
        InputError: shapes that do not fit, places outside the volume, or another ``light``.
    """
    planes = len(capture.stack.depths_m)
    if volume.ndim != 5 or volume.shape[1] != planes or places.shape != (*volume.shape[:1], *volume.shape[3:]):
        msg = (
            f"volume, places: got shapes {tuple(volume.shape)} and {tuple(places.shape)}, expected (B, K, C, h, w) and "
            f"(B, h, w) with K = {planes}, the planes of the capture's stack"
        )
        raise InputError(msg)
    low, high = float(places.min()), float(places.max())
    if not (low >= 0 and high <= planes - 1):
        msg = f"places: got {low:g} to {high:g}, expected 0 to {planes - 1}, from the first plane to the last"
        raise InputError(msg)
    before = places.floor().long()
    after = (before + 1).clamp_max(planes - 1)
    share = (places - before).to(volume)
    disparities = like(capture.plane_disparities(), volume)
    disparity = torch.lerp(disparities[before], disparities[after], share)[:, None]
    if light == "sum":
        combined = volume.sum(dim=1)
    elif light == "label":
        one, other = (torch.take_along_dim(volume, at[:, None, None], dim=1)[:, 0] for at in (before, after))
        combined = torch.lerp(one, other, share[:, None])
    else:
        msg = f"light: got {light!r}, expected one of {', '.join(LIGHT)}"
        raise InputError(msg)
    return Estimate(encode(capture.to_srgb(combined), 1.0), disparity)
