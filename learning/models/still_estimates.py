"""What VideoNet3D begins with: a FlatNet3D's estimates of a capture as it is, and as if all rows had seen the same frame.

A FlatNet3D knows captures of what stands still. In one of a rolling shutter each row has seen other moments; joint least
squares over space, time and a few depths say how these differ; subtracting this difference leaves the capture of a still
scene. Once converged, their own frames are noisy; only what they predict of the capture is used.

The estimates take longer than a step of a training and are kept; by this module's code they are told apart, not by the
network's.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.layers.space_time import JOINT, JointLeastSquares
from learning.method import check_choices, inference
from learning.models.flatnet import SIZES, FlatNet3D
from simulator.errors import InputError
from simulator.io.files import sha256_bytes


class Parts(NamedTuple):
    """What the network begins with; light is in the camera's channels, 1 for white.

    Attributes:
        light: ``(B, N, K C, h, w)``, of a few planes of each frame, by joint least squares.
        images: ``(B, N, 3, h, w)``, what the FlatNet3D makes of the capture as if all of it had seen a frame, sRGB codes.
        disparities: ``(B, N, 1, h, w)``.
        planes: ``(B, P, h, w)``, its inversions of the capture as if all of it had seen the mean of the frames.
        image: ``(B, 3, h, w)``, what it makes of the capture as it is.
        disparity: ``(B, 1, h, w)``.
    """

    light: Tensor
    images: Tensor
    disparities: Tensor
    planes: Tensor
    image: Tensor
    disparity: Tensor


class StillEstimates(nn.Module):
    """A FlatNet3D, and joint least squares over space, time and depth with a few planes in place of all.

    Attributes:
        still: the FlatNet3D.
        planes: how many planes the least squares know.
        channels: of the image that is the FlatNet3D's inversions, P.
    """

    def __init__(
        self, capture: CaptureModel, still: Mapping[str, Any], planes: int, steps: Mapping[str, float]
    ) -> None:
        """Build both; ``still`` is the architecture of the FlatNet3D, ``steps`` what differs from `JOINT`."""
        super().__init__()
        self._told: dict[str, Any] = {"still": dict(still)}
        numbers = dict(still)
        if (name := numbers.pop("network", None)) != "flatnet3d":
            raise InputError("still", f"got the network {name}, expected flatnet3d")
        size = numbers.pop("size", "compact")
        check_choices(("still.size", size, SIZES))
        self.still = FlatNet3D(still_camera(capture), **SIZES[size] | numbers)
        seen = capture.with_planes(min(planes, len(capture.stack.depths_m)))
        self.planes = len(seen.stack.depths_m)
        numbers: dict[str, Any] = {**JOINT, **steps}
        self.joint = JointLeastSquares(seen, **numbers)
        inversions = 1 if self.still.joint is None else 2
        self.channels = inversions * len(capture.stack.depths_m) * len(capture.stack.channels)
        of_frames = [(capture.frames, many) for many in (self.planes * len(capture.stack.channels), 3, 1)]
        self._shapes = [(*many, *capture.scene_shape) for many in (*of_frames, (self.channels,), (3,), (1,))]

    @property
    def told(self) -> dict[str, Any]:
        """What decides it beside the camera, plain."""
        weights = b"".join(values.detach().cpu().numpy().tobytes() for values in self.still.state_dict().values())
        return self._told | {"joint": self.joint.told, "planes": self.planes, "weights": sha256_bytes(weights)}

    @torch.no_grad()
    def forward(self, measurement: Tensor) -> Tensor:
        """Return all of `Parts` of each measurement in a row, ``(B, numbers)``."""
        problem, light = self.joint.problem, self.joint.light(measurement)
        stilled = [problem.instead(measurement, light, frame) for frame in light.split(1)]
        with inference(self.still):
            image, disparity = self._estimated(measurement)
            of_frames = [self._estimated(capture) for capture in stilled]
            images, disparities = (torch.stack(parts, dim=1) for parts in zip(*of_frames, strict=True))
            volumes = self.still.invert(torch.stack(stilled).mean(dim=0)).volumes[self.still.image]
        every = (problem.film(light), images, disparities, volumes, image, disparity)
        return torch.cat([each.flatten(1).to(light) for each in every], dim=1)

    def _estimated(self, measurement: Tensor) -> tuple[Tensor, Tensor]:
        inverted = self.still.invert(measurement)
        image, disparity = self.still.refine(self.still.enhance(inverted), inverted)
        return image, disparity

    def parts(self, start: Tensor) -> Parts:
        """Return what `forward` has put in a row."""
        sizes = [math.prod(shape) for shape in self._shapes]
        return Parts(*(one.unflatten(1, shape) for one, shape in zip(start.split(sizes, 1), self._shapes, strict=True)))


def still_camera(capture: CaptureModel) -> CaptureModel:
    """Return a camera as it sees what stands still: all rows see the same, whenever they are open."""
    return replace(capture, timing=None)
