"""VideoNet3D: the frames of a moving scene and the depth of each, from one capture of a rolling shutter.

A capture that says when things were where, row by row, also says how far away they were: PSFs scale with 1 / z. The network
begins with what two estimates know that make opposite assumptions. A FlatNet3D takes the capture for that of a still scene,
which is right where nothing moves. Joint least squares over space, time and depth, with a few planes in place of all, know
what moves, and see little of the detail. A body that looks at both, and at the light that the FlatNet3D's inversions find at
all planes, says how much of the change that least squares see to add to the FlatNet3D's picture, and what both lack.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.layers.noise import level_image, noise_ratio
from learning.layers.space_time import JOINT, JointLeastSquares
from learning.method import Clock, Estimate, check_choices, inference, linear_to_srgb
from learning.models.clip_network import ClipNetworkMethod, FrameBody, check_clips, copy_weights
from learning.models.flatnet import SIZES, FlatNet3D
from learning.models.refinement import MOST_RADIANCE
from simulator.errors import InputError
from simulator.io.files import sha256_bytes


class Start(NamedTuple):
    """What the network begins with; light is in the camera's channels, 1 for white.

    Attributes:
        frames: ``(B, N, K C, h, w)``, light of a few planes of each frame, by joint least squares.
        planes: ``(B, P, h, w)``, light of all planes of the whole capture as if nothing moved: the FlatNet3D's inversions.
        image: ``(B, 3, h, w)``, what it makes of them, sRGB codes.
        disparity: ``(B, 1, h, w)``.
    """

    frames: Tensor
    planes: Tensor
    image: Tensor
    disparity: Tensor


class Beginning(nn.Module):
    """Both estimates that the network begins with.

    Attributes:
        still: the FlatNet3D.
        planes: how many planes the frames have.
        channels: of the image that is the inversions of the whole capture, P.
    """

    def __init__(self, capture: CaptureModel, still: Mapping[str, Any], planes: int, iterations: int) -> None:
        """Build both; ``still`` is the architecture of the FlatNet3D."""
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
        steps: dict[str, Any] = dict(JOINT) | {"iterations": iterations}
        self.joint = JointLeastSquares(seen, **steps)
        inversions = 1 if self.still.joint is None else 2
        self.channels = inversions * len(capture.stack.depths_m) * len(capture.stack.channels)
        frames = (capture.frames, self.planes * len(capture.stack.channels))
        self._shapes = [(*many, *capture.scene_shape) for many in (frames, (self.channels,), (3,), (1,))]

    @property
    def told(self) -> dict[str, Any]:
        """What decides it beside the camera, plain."""
        weights = b"".join(values.detach().cpu().numpy().tobytes() for values in self.still.state_dict().values())
        return self._told | {"joint": self.joint.told, "planes": self.planes, "weights": sha256_bytes(weights)}

    @torch.no_grad()
    def forward(self, measurement: Tensor) -> Tensor:
        """Return all of `Start` of each measurement in a row, ``(B, numbers)``."""
        frames = self.joint.volumes(measurement)
        with inference(self.still):
            inverted = self.still.invert(measurement)
            image, disparity = self.still.refine(self.still.enhance(inverted), inverted)
        volumes = inverted.volumes[self.still.image]
        return torch.cat([each.flatten(1) for each in (frames, volumes, image.to(frames), disparity.to(frames))], dim=1)

    def parts(self, start: Tensor) -> Start:
        """Return what `forward` has put in a row."""
        sizes = [math.prod(shape) for shape in self._shapes]
        return Start(*(one.unflatten(1, shape) for one, shape in zip(start.split(sizes, 1), self._shapes, strict=True)))


class VideoNet3D(nn.Module):
    """Frames and depth of captures; all is in float32 but the body, which autocast may run in bfloat16.

    At first its depth is the FlatNet3D's, and half of the change of least squares is added to each frame's picture.

    Attributes:
        joint: gives the estimate that it begins with, see `Beginning`; the FlatNet3D in it is not trained here.
    """

    colours: Tensor

    def __init__(
        self,
        capture: CaptureModel,
        *,
        still: Mapping[str, Any],
        dimensions: Literal[2, 3],
        filters: int,
        blocks: int,
        levels: int,
        joint_planes: int,
        joint_iterations: int,
    ) -> None:
        """Build the network for a camera.

        Args:
            capture: the camera, with its timing and the PSFs of two planes or more.
            still: architecture of the FlatNet3D, ``network`` and ``size`` and what differs from it.
            dimensions: 2: frames are channels; 3: a stack.
            filters: of the first level of NAF blocks.
            blocks: on each level and way.
            levels: how many.
            joint_planes: of the joint least squares, evenly in disparity from the nearest to the farthest.
            joint_iterations: of the joint least squares.

        Raises:
            InputError: the camera of stills, a single plane, or sizes that make no sense.
        """
        super().__init__()
        check_clips(capture, type(self).__name__)
        if len(capture.stack.depths_m) < 2:
            raise InputError(
                "stack", "got one plane, expected several to tell depth by; take psf.depths: 13, or videonet"
            )
        self.joint = Beginning(capture, still, joint_planes, joint_iterations)
        self.joint.still.requires_grad_(False)
        sizes: dict[str, Any] = {"filters": filters, "blocks": blocks, "levels": levels, "stem": 1}
        own = len(capture.stack.channels) * self.joint.planes + 3
        shared = self.joint.channels + 3 + 1 + 1
        self.body = FrameBody(capture.frames, own, shared, 5, dimensions=dimensions, body="naf", **sizes)
        colours = torch.from_numpy(np.linalg.pinv(capture.scene_to_camera)).to(torch.get_default_dtype())
        self.register_buffer("colours", colours, persistent=False)

    def forward(self, measurement: Tensor, start: Tensor | None = None) -> Estimate:
        """Return the film of measurements ``(B, C, H, W)``, DN / 2^bits; ``start`` is what `begin` gives, where known."""
        with torch.autocast(measurement.device.type, enabled=False):
            frames, planes, image, disparity = self.joint.parts(self.begin(measurement) if start is None else start)
            level = level_image(noise_ratio(self.joint.still.inversion.light(measurement)), image)
            # Of all planes together: least squares find much better how bright a pixel is than how far away.
            light = frames.unflatten(2, (self.joint.planes, -1)).sum(dim=2)
            radiance = torch.einsum("ac,bnchw->bnahw", self.colours, light).clamp(0, MOST_RADIANCE)
            codes = linear_to_srgb(radiance, 1.0, clip=False)
        known = torch.cat([frames, codes], dim=2)
        answer = self.body(known, torch.cat([planes, image, disparity, level], dim=1)).to(image)
        moving = codes - codes.mean(dim=1, keepdim=True)
        frames = image[:, None] + answer[:, :, 4:].sigmoid() * moving + answer[:, :, :3]
        return Estimate(frames, disparity[:, None] + answer[:, :, 3:4])

    def begin(self, measurement: Tensor) -> Tensor:
        """Return what it begins with, to be kept; see `Beginning`."""
        return self.joint(measurement)

    def take(self, known: nn.Module, source: str) -> list[str]:
        """Put the weights of another VideoNet3D into this one, and say what was taken.

        Raises:
            InputError: another kind of network, or weights of other shapes, naming the ``source``.
        """
        if not isinstance(known, VideoNet3D):
            raise InputError(source, f"got a {type(known).__name__}, expected a VideoNet3D")
        cure = "take a checkpoint of the same size (filters, blocks, levels, dimensions, joint_planes) and slivers"
        return copy_weights(self, known.state_dict(), source, cure, self.state_dict())


def still_camera(capture: CaptureModel) -> CaptureModel:
    """Return a camera as it sees what stands still: all rows see the same, whenever they are open."""
    return replace(capture, timing=None)


VIDEO_3D_SIZES: dict[str, dict[str, Any]] = {
    "compact": {
        **{"dimensions": 2, "filters": 48, "blocks": 1, "levels": 4},
        **{"joint_planes": 4, "joint_iterations": 10},
    },
    "tiny": {
        **{"dimensions": 2, "filters": 8, "blocks": 1, "levels": 2},
        **{"joint_planes": 2, "joint_iterations": 5},
    },
}


class Video3DMethod(ClipNetworkMethod[VideoNet3D]):
    """A VideoNet3D as a method."""

    def reconstruct(self, measurement: Tensor, clock: Clock | None = None) -> Estimate:
        """Return the frames and depths of measurements ``(B, C, H, W)``; stages ``joint`` and ``network``."""
        clock = clock or Clock(measurement.device)
        with inference(self.network):
            start = self.begin(measurement, clock)
            with clock.stage("network"):
                return self.network(measurement, start)
