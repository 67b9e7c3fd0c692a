"""A network for stills on the captures of clips: what a method that knows nothing of time makes of them."""

from __future__ import annotations

from typing import Self

import torch
from torch import Tensor

from learning.camera import CaptureModel
from learning.method import Clock, Estimate, Method


class RepeatedStill:
    """It takes each capture for that of a still scene, and gives all frames the same image and depth: a `Method`.

    Attributes:
        frames: a method for clips of the same camera, whose images replace the one image; None: there is none.
    """

    def __init__(self, name: str, still: Method, capture: CaptureModel) -> None:
        """Put it together; ``capture`` is the camera of the clips, with the planes of ``still``."""
        self.name, self.capture = name, capture
        self._still = still
        self.frames: Method | None = None

    def to(self, device: torch.device | str) -> Self:
        """Move both to a device, and return this."""
        self._still.to(device)
        if self.frames is not None:
            self.frames.to(device)
        return self

    def reconstruct(self, measurement: Tensor, clock: Clock | None = None) -> Estimate:
        """Return the frames of measurements ``(B, C, H, W)``; the clock's stages are those of the methods."""
        still = self._still.reconstruct(measurement, clock)
        image, disparity = (each[:, None].expand(-1, self.capture.frames, -1, -1, -1) for each in still)
        if self.frames is not None:
            image = self.frames.reconstruct(measurement, clock).image
        return Estimate(image, disparity)
