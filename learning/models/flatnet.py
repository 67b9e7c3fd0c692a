"""FlatNet3D and FlatNet2D: picture and depth from one measurement of a still scene.

Source: the thesis, sections 4.3 and 5.2.3; FlatNet: Khan et al., FlatNet: Towards Photorealistic Scene Reconstruction from
Lensless Measurements, TPAMI 2020.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence

import numpy as np
from torch import Tensor, nn

from learning.capture import CaptureModel
from learning.estimate import Estimate
from learning.layers.inversion import RegularisedInversion
from learning.layers.unet import UNet


class FlatNet(nn.Module):
    """Inversion at some planes, then a U-Net from all of them to sRGB codes and disparity: what both networks share."""

    def __init__(
        self,
        capture: CaptureModel,
        *,
        filters: int = 16,
        levels: int = 5,
        attention: bool = False,
        stem: int = 1,
        strength: float = 0.1,
        floor: float = 1.0,
    ) -> None:
        """Build the network for a camera; see `UNet` for its size.

        Args:
            capture: the camera.
            filters: channels of the U-Net's first level.
            levels: of the U-Net.
            attention: gates on its skips.
            stem: its pixel unshuffle.
            strength: initial lambda of the inversion; see `RegularisedInversion`.
            floor: what its P begins with beside the thesis's Laplacian; 0 is the Laplacian alone.
        """
        super().__init__()
        planes = self.planes_of(capture)
        self.inversion = RegularisedInversion(capture, planes, strength=strength, floor=floor)
        channels = len(capture.stack.channels)
        self.enhancement = UNet(
            len(planes) * channels, 4, filters=filters, levels=levels, attention=attention, stem=stem, start=0.5
        )

    @staticmethod
    @abstractmethod
    def planes_of(capture: CaptureModel) -> Sequence[int]:
        """Return the planes of a camera's stack that the network inverts at."""

    def forward(self, measurement: Tensor) -> Estimate:
        """Return the estimate of measurements ``(B, C, H, W)``, DN / 2^bits."""
        return self.enhance(self.inversion(measurement))

    def enhance(self, volume: Tensor) -> Estimate:
        """Return the estimate of the inversion's volume ``(B, K, C, h, w)``."""
        output = self.enhancement(volume.flatten(1, 2))
        return Estimate(output[:, :3], output[:, 3:])


class FlatNet3D(FlatNet):
    """Learned inversion at all depths of the stack, then a U-Net: equations 4.10 and 4.11 of the thesis."""

    @staticmethod
    def planes_of(capture: CaptureModel) -> Sequence[int]:
        """Return all planes."""
        return range(len(capture.stack.depths_m))


class FlatNet2D(FlatNet):
    """The same with the PSF of one depth only, the hyperfocal one: in the middle of the disparities."""

    @staticmethod
    def planes_of(capture: CaptureModel) -> Sequence[int]:
        """Return the hyperfocal plane."""
        return [hyperfocal_plane(capture)]


def hyperfocal_plane(capture: CaptureModel) -> int:
    """Return the plane whose PSF is nearest to those of all depths: the PSF scales with 1 / z, so the middle disparity.

    Of two equally near, the nearer to the camera.
    """
    return int(np.argmin(np.abs(capture.plane_disparities() - 0.5).round(9)))
