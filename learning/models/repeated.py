"""A network for stills on the captures of clips: what a method that knows nothing of time makes of them."""

from __future__ import annotations

from typing import Self

import torch
from torch import Tensor

from learning.camera import CaptureModel
from learning.method import Clock, Estimate, Method


class RepeatedStill:
    """It takes each capture for that of a still scene, and gives all frames the same picture and depth: a `Method`.

    With ``frames``, a method for clips of the same camera, the pictures are that one's, and only the depth is repeated.
    """

    def __init__(self, name: str, still: Method, capture: CaptureModel, frames: Method | None = None) -> None:
        """Put it together; ``capture`` is the camera of the clips, with the planes of ``still``."""
        self.name, self.capture = name, capture
        self._still, self._frames = still, frames

    def to(self, device: torch.device | str) -> Self:
        """Move both to a device, and return this."""
        self._still.to(device)
        if self._frames is not None:
            self._frames.to(device)
        return self

    def reconstruct(self, measurement: Tensor, clock: Clock | None = None) -> Estimate:
        """Return the frames of measurements ``(B, C, H, W)``; the clock's stages are those of the methods."""
        still = self._still.reconstruct(measurement, clock)
        image, disparity = (each[:, None].expand(-1, self.capture.frames, -1, -1, -1) for each in still)
        return Estimate(
            image if self._frames is None else self._frames.reconstruct(measurement, clock).image, disparity
        )
