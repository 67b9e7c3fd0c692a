"""Frames and depth of a clip without learning: joint least squares over space, time and depth, then a graph cut per frame.

Least squares share the light of each frame out among a few planes, as those of stills do; what separates them is that PSFs
scale with 1 / z. Depth is found frame by frame, as `learning.classical.method.ClassicalMethod` finds that of stills.
"""

from __future__ import annotations

from typing import Any, Self

import torch
from torch import Tensor

from learning.camera import CaptureModel
from learning.classical.clips import CLIP_SEARCH
from learning.classical.method import SEARCH, ClassicalMethod
from learning.layers.space_time import JOINT, JointLeastSquares
from learning.method import Clock, Estimate, Value, threads_for
from simulator.errors import InputError

OF_VOLUME: dict[str, Value] = {**JOINT, "planes": 4}
"""The parameters on which the volumes depend."""
_OF_DEPTH: dict[str, Value] = {
    "cost": "spread",
    "measure": "light",
    "contrast": 1.0,
    "window_px": 1.0,
    "pairwise": 2.0,
    "steps_between_planes": 4,
    "light": "sum",
}
CLIP_DEPTH_DEFAULTS: dict[str, dict[str, Value]] = {"joint3d": OF_VOLUME | _OF_DEPTH}
CLIP_DEPTH_SEARCH: dict[str, dict[str, tuple[Value, ...]]] = {
    "joint3d": {
        **CLIP_SEARCH["joint"],
        "iterations": (20, 40, 80),
        "planes": (2, 4, 6),
        **{name: SEARCH["admm"][name] for name in _OF_DEPTH if name in SEARCH["admm"]},
    }
}


class ClipDepth:
    """Joint least squares on some planes and a graph cut: a `learning.method.Method` for clips.

    Attributes:
        name: in tables and figures.
        stage: of the clock, for the least squares.
    """

    name = "joint least squares + graph cut"

    def __init__(self, capture: CaptureModel, *, planes: int, **parameters: Any) -> None:
        """Prepare it; an InputError refuses the camera of stills, a single plane, and what its parts refuse.

        Args:
            capture: the camera.
            planes: of the least squares, evenly in disparity; as many as the stack has where these are fewer.
            **parameters: the others of `OF_VOLUME`, see `JointLeastSquares`, and those of depth, see `ClassicalMethod`.
        """
        if capture.timing is None:
            raise InputError("joint3d", "got the camera of stills, but it reconstructs clips; take cls, admm or pnp")
        if len(capture.stack.depths_m) < 2:
            raise InputError("stack", "got one plane, but joint3d tells depths apart; take psf.depths: 13, or joint")
        self.capture, self.stage = capture, "joint"
        seen = capture.with_planes(min(planes, len(capture.stack.depths_m)))
        self._solver = JointLeastSquares(seen, **{key: parameters[key] for key in JOINT})
        of_depth: dict[str, Any] = {key: parameters[key] for key in _OF_DEPTH}
        self._depth = ClassicalMethod(self.name, seen, self._solver, stage=self.stage, **of_depth)

    def to(self, device: torch.device | str) -> Self:
        """Move the least squares to a device, and return this; graph cuts stay on the CPU."""
        self._solver.to(device)
        return self

    def volume(self, measurement: Tensor) -> Tensor:
        """Return the frames' volumes ``(B, N, K, C, h, w)`` of measurements ``(B, C, H, W)``, light in units of white."""
        with threads_for(measurement[0].numel() * self.capture.frames):
            return self._solver.volumes(measurement)

    def estimate(self, volume: Tensor, clock: Clock | None = None) -> Estimate:
        """Return the estimate of such volumes; stages ``graph cut`` and ``assembly``."""
        every = self._depth.estimate(volume.flatten(0, 1), clock)
        image, disparity = (each.unflatten(0, volume.shape[:2]) for each in every)
        return Estimate(image, disparity)

    def reconstruct(self, measurement: Tensor, clock: Clock | None = None) -> Estimate:
        """Return the estimate of measurements; stages ``joint``, ``graph cut`` and ``assembly``."""
        clock = clock or Clock(measurement.device)
        with clock.stage(self.stage):
            volume = self.volume(measurement)
        return self.estimate(volume, clock)
