"""A choice among depth planes, pixel by pixel, with softmax weights: from a volume to a surface and back."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from learning.camera import CaptureModel


class PlaneChoice(nn.Module):
    """Surfaces of a camera's planes: their light in linear sRGB, 1 for white, and their disparity."""

    to_srgb: Tensor
    to_camera: Tensor
    disparities: Tensor

    def __init__(self, capture: CaptureModel, planes: Sequence[int]) -> None:
        """Keep the camera's colours and the disparities of ``planes``."""
        super().__init__()
        colours = np.asarray(capture.scene_to_camera)
        of_planes = capture.plane_disparities()[list(planes)]
        numbers = {"to_srgb": np.linalg.pinv(colours), "to_camera": colours, "disparities": of_planes}
        for name, values in numbers.items():
            self.register_buffer(name, torch.from_numpy(values).to(torch.get_default_dtype()), persistent=False)

    def light(self, volume: Tensor, weights: Tensor) -> Tensor:
        """Return the light ``(B, 3, h, w)`` of volumes ``(B, K, C, h, w)``, as much of each plane as it weighs."""
        return torch.einsum("ac,bkchw,bkhw->bahw", self.to_srgb, volume, weights)

    def disparity(self, weights: Tensor) -> Tensor:
        """Return the mean disparity ``(B, 1, h, w)`` of weights ``(B, K, h, w)``."""
        return torch.einsum("k,bkhw->bhw", self.disparities, weights)[:, None]

    def volume(self, light: Tensor, weights: Tensor) -> Tensor:
        """Return the volume ``(B, K, C, h, w)`` of light ``(B, 3, h, w)`` that lies on the planes as they weigh."""
        return weights[:, :, None] * torch.einsum("ca,bahw->bchw", self.to_camera, light).relu()[:, None]
