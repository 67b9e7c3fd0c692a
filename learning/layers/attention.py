"""Grid attention: a gate on a U-Net's skip that lets through what the coarser level asks for.

Source: Oktay et al., Attention U-Net, MIDL 2018 (additive gates on a grid).
"""

from __future__ import annotations

import torch
import torch.nn.functional as nnf
from torch import Tensor, nn


class GridAttention(nn.Module):
    """Weights 0..1 for every position of a skip, from the skip and from the next coarser level."""

    def __init__(self, skip: int, gate: int, dimensions: int = 2) -> None:
        """Build the gate.

        Args:
            skip: channels of the skip.
            gate: channels of the coarser level, half as fine.
            dimensions: 2 or 3.
        """
        super().__init__()
        conv, norm = (nn.Conv2d, nn.BatchNorm2d) if dimensions == 2 else (nn.Conv3d, nn.BatchNorm3d)
        inner = max(skip // 2, 1)
        self.mode = "bilinear" if dimensions == 2 else "trilinear"
        self.theta = conv(skip, inner, 2, stride=2, bias=False)
        self.phi = conv(gate, inner, 1)
        self.psi = conv(inner, 1, 1)
        self.mix = nn.Sequential(conv(skip, skip, 1), norm(skip))

    def forward(self, skip: Tensor, gate: Tensor) -> Tensor:
        """Return the gated skip ``(B, skip, ...)``.

        Args:
            skip: ``(B, skip, ...)``.
            gate: ``(B, gate, ...)``, half of the skip's size.
        """
        weights = torch.sigmoid(self.psi(nnf.elu(self.theta(skip) + self.phi(gate))))
        weights = nnf.interpolate(weights, size=skip.shape[2:], mode=self.mode, align_corners=False)
        return self.mix(skip * weights)
