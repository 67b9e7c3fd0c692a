"""From one measurement to a picture, a depth map and a volume, by any method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from learning.display import decode, encode
from learning.method import Clock, Method
from learning.models.method import LearnedMethod
from learning.planar import PlanarMethod
from simulator.arrays import to_numpy
from simulator.errors import InputError
from simulator.types import FARTHEST_M

_WHITE_PERCENTILE = 99.5  # of the lit values, as in all pictures that the simulator shows


@runtime_checkable
class HasVolume(Protocol):
    """A method that can show its volume."""

    def volume(self, measurement: Tensor) -> Tensor:
        """Return ``(B, K, C, h, w)`` of measurements ``(B, C, H, W)``."""
        ...


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """What was made of a measurement.

    Attributes:
        radiance: ``(3, h, w)`` float32 linear sRGB. Of one plane without a scale of its own, in the unit measurement / PSF.
        picture: ``(3, h, w)`` float32 sRGB codes 0..1; 1 is ``white``.
        white: the radiance that the picture shows as 1.
        white_from: why this one; empty where it is the method's own.
        depth_m: ``(h, w)`` float32 metres, at most `FARTHEST_M`; None where the PSFs are of one depth.
        volume: ``(K, C, h, w)`` float32 radiance in the camera's channels; None where it was not asked for.
        seconds: by stage.
    """

    radiance: NDArray[np.float32]
    picture: NDArray[np.float32]
    white: float
    white_from: str
    depth_m: NDArray[np.float32] | None
    volume: NDArray[np.float32] | None
    seconds: dict[str, float]


def reconstruct(
    measurement: NDArray[Any],
    method: Method,
    *,
    volume: bool = False,
    white: float | None = None,
    device: torch.device | str = "cpu",
) -> Reconstruction:
    """Reconstruct a still.

    Args:
        measurement: ``(C, H, W)``, DN / 2^bits.
        method: learned or classical, on the device.
        volume: whether the volume is wanted too.
        white: of a picture from one plane, the radiance to show as 1; None shows the brightest half per cent as white. All
            other methods show ``method.capture.white``, by which they work.
        device: where the method is.

    Raises:
        InputError: NaN or infinite numbers, a shape that is not the camera's, or a method that has no volume to show.
    """
    capture = method.capture
    expected = (len(capture.stack.channels), *capture.sensor_shape)
    if tuple(measurement.shape) != expected:
        msg = f"measurement: got shape {tuple(measurement.shape)}, expected the camera's {expected}: channels, rows, columns"
        raise InputError(msg)
    if not np.isfinite(measurement).all():
        msg = "measurement: got NaN or infinite numbers, expected finite ones; repair these pixels first"
        raise InputError(msg)
    if volume and not isinstance(method, HasVolume | LearnedMethod):
        msg = f"volume: {method.name} has none to show; leave it out"
        raise InputError(msg)
    batch = torch.from_numpy(np.array(measurement, np.float32))[None].to(device)
    clock = Clock(device)
    if isinstance(method, PlanarMethod):
        return _planar(batch, method, clock, volume=volume, white=white)
    estimate = method.reconstruct(batch, clock).clamped()
    shown = None
    if isinstance(method, LearnedMethod) and volume:
        with torch.no_grad():
            shown = method.network.inversion(batch)
    elif isinstance(method, HasVolume) and volume:
        shown = method.volume(batch)
    depth_m = np.minimum(to_numpy(estimate.depth_m(capture))[0, 0], FARTHEST_M)
    return Reconstruction(
        radiance=to_numpy(decode(estimate.picture, capture.white))[0],
        picture=to_numpy(estimate.picture)[0],
        white=capture.white,
        white_from="",
        depth_m=depth_m if len(capture.stack.depths_m) > 1 else None,
        volume=None if shown is None else to_numpy(shown)[0] * np.float32(capture.white),
        seconds=clock.seconds,
    )


def _planar(batch: Tensor, method: PlanarMethod, clock: Clock, *, volume: bool, white: float | None) -> Reconstruction:
    unit = method.capture.white
    with clock.stage(method.stage):
        plane = method.volume(batch)
    radiance = to_numpy(method.radiance(plane))[0] * np.float32(unit)
    reason = "as told"
    if white is None:
        lit = radiance[radiance > 0]
        white = float(np.percentile(lit, _WHITE_PERCENTILE)) if lit.size else 1.0
        reason = f"{_WHITE_PERCENTILE}th percentile of the picture's positive values"
    picture = to_numpy(encode(torch.from_numpy(radiance), white))
    shown = to_numpy(plane)[0] * np.float32(unit) if volume else None
    return Reconstruction(radiance, picture, white, reason, None, shown, clock.seconds)
