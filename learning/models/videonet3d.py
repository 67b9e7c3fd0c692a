"""VideoNet3D: the frames of a moving scene and the depth of each, from one capture of a rolling shutter.

A capture that says when things were where, row by row, also says how far away they were: PSFs scale with 1 / z. Joint least
squares over space and time estimate how the frames differ; with these differences removed from the capture, a FlatNet3D of
stills estimates image and depth of each frame (`learning.models.still_estimates`). Where nothing moves, its estimate of the
capture as it is remains the better one: a network weighs both estimates pixel by pixel, and adds a correction.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.layers.noise import level_image, noise_ratio
from learning.method import Clock, Estimate, inference
from learning.models.clip_network import ClipNetworkMethod, FrameBody, camera_codes, check_clips, copy_weights
from learning.models.still_estimates import StillEstimates
from simulator.errors import InputError


class VideoNet3D(nn.Module):
    """Frames and depth of captures; all is in float32 but the body, which autocast may run in bfloat16.

    At first it answers with the mean of the two estimates that it begins with.

    Attributes:
        joint: gives the estimate that it begins with, see `StillEstimates`; the FlatNet3D in it is not trained here.
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
        joint_noise: float,
        joint_correlation: float,
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
            joint_noise: their noise.
            joint_correlation: of their colours.

        Raises:
            InputError: the camera of stills, a single plane, or sizes that make no sense.
        """
        super().__init__()
        check_clips(capture, type(self).__name__)
        if len(capture.stack.depths_m) < 2:
            raise InputError(
                "stack", "got one plane, expected several to tell depth by; take psf.depths: 13, or videonet"
            )
        steps = {"iterations": joint_iterations, "noise": joint_noise, "correlation": joint_correlation}
        self.joint = StillEstimates(capture, still, joint_planes, steps)
        self.joint.still.requires_grad_(False)
        sizes: dict[str, Any] = {"filters": filters, "blocks": blocks, "levels": levels, "stem": 1}
        own = len(capture.stack.channels) * self.joint.planes + 3 + 3 + 1
        shared = self.joint.channels + 3 + 1 + 1
        self.body = FrameBody(capture.frames, own, shared, 6, dimensions=dimensions, body="naf", **sizes)
        colours = torch.from_numpy(np.linalg.pinv(capture.scene_to_camera)).to(torch.get_default_dtype())
        self.register_buffer("colours", colours, persistent=False)

    def forward(self, measurement: Tensor, start: Tensor | None = None) -> Estimate:
        """Return the film of measurements ``(B, C, H, W)``, DN / 2^bits; ``start``: their `initial_estimate`, where known."""
        with torch.autocast(measurement.device.type, enabled=False):
            known = self.joint.parts(self.initial_estimate(measurement) if start is None else start)
            level = level_image(noise_ratio(self.joint.still.inversion.light(measurement)), known.image)
            # Of all planes together: least squares find much better how bright a pixel is than how far away.
            light = known.light.unflatten(2, (self.joint.planes, -1)).sum(dim=2)
            codes = camera_codes(self.colours, light)
        own = torch.cat([known.light, codes, known.images, known.disparities], dim=2)
        shared = torch.cat([known.planes, known.image, known.disparity, level], dim=1)
        answer = self.body(own, shared).to(codes)
        shares, image, disparity = answer[:, :, 4:].sigmoid(), known.image[:, None], known.disparity[:, None]
        images = image + shares[:, :, :1] * (known.images - image) + answer[:, :, :3]
        return Estimate(images, disparity + shares[:, :, 1:] * (known.disparities - disparity) + answer[:, :, 3:4])

    def initial_estimate(self, measurement: Tensor) -> Tensor:
        """Return what it begins with, to be kept; see `StillEstimates`."""
        return self.joint(measurement)

    def take(self, known: nn.Module, source: str) -> list[str]:
        """Put the weights of another VideoNet3D into this one, and say what was taken.

        Raises:
            InputError: another kind of network, or weights of other shapes, naming the ``source``.
        """
        if not isinstance(known, VideoNet3D):
            raise InputError(source, f"got a {type(known).__name__}, expected a VideoNet3D")
        alike = "size (filters, blocks, levels, dimensions, joint_planes), planes (psf.depths) and slivers"
        cure = f"take a checkpoint of the same {alike}, which begins with a FlatNet3D of the same size"
        return copy_weights(self, known.state_dict(), source, cure, self.state_dict())


VIDEO_3D_SIZES: dict[str, dict[str, Any]] = {
    "compact": {
        **{"dimensions": 2, "filters": 48, "blocks": 1, "levels": 4},
        **{"joint_planes": 2, "joint_iterations": 80, "joint_noise": 5.0, "joint_correlation": 0.0},
    },
    "tiny": {
        **{"dimensions": 2, "filters": 8, "blocks": 1, "levels": 2},
        **{"joint_planes": 2, "joint_iterations": 5, "joint_noise": 1.0, "joint_correlation": 0.0},
    },
}


class Video3DMethod(ClipNetworkMethod[VideoNet3D]):
    """A VideoNet3D as a method."""

    def reconstruct(self, measurement: Tensor, clock: Clock | None = None) -> Estimate:
        """Return frames and depths of measurements ``(B, C, H, W)``; stages ``joint`` (with the FlatNet3D), ``network``."""
        clock = clock or Clock(measurement.device)
        with inference(self.network):
            start = self.initial_estimate(measurement, clock)
            with clock.stage("network"):
                return self.network(measurement, start)
