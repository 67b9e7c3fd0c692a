"""What every method returns, learned or classical: a picture and a depth map."""

from __future__ import annotations

from typing import NamedTuple

from torch import Tensor

from learning.capture import CaptureModel


class Estimate(NamedTuple):
    """Pictures and depths of B scenes.

    Attributes:
        picture: ``(B, 3, h, w)`` sRGB codes, nominally 0..1 (a network's are not clipped); see `learning.display`.
        disparity: ``(B, 1, h, w)``, nominally 0 (far) to 1 (near); see `CaptureModel.disparity`.
    """

    picture: Tensor
    disparity: Tensor

    def clamped(self) -> Estimate:
        """Return the same within the ranges: what metrics see, of every method alike."""
        return Estimate(self.picture.clamp(0, 1), self.disparity.clamp(0, 1))

    def depth_m(self, capture: CaptureModel) -> Tensor:
        """Return depths ``(B, 1, h, w)`` in metres, clamped to the stack's range."""
        return capture.depth_m(self.disparity)
