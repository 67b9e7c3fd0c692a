"""Convolution of stacks of images whose gradient is right in bfloat16 on a CPU, too."""

from __future__ import annotations

import torch
from torch import Tensor, nn


class Conv3d(nn.Conv3d):
    """`torch.nn.Conv3d`, in the weights' own precision where a CPU's bfloat16 fails.

    Under autocast, weights of a kernel longer than the stack get what memory happened to hold as their gradient, often NaN
    (oneDNN in torch 2.15, measured on a CPU with AVX-512 BF16). A network over several scales has two frames on some level.
    """

    def forward(self, image: Tensor) -> Tensor:
        """Return ``(B, out, T, h, w)`` of ``(B, in, T, h, w)``."""
        if image.device.type == "cpu" and image.shape[2] < self.kernel_size[0]:
            with torch.autocast("cpu", enabled=False):
                return super().forward(image.to(self.weight.dtype))
        return super().forward(image)
