"""U-Net for images (2D) and for stacks of images in time or depth (3D), with attention gates on its skips where wanted.

Sources: Ronneberger et al., U-Net, MICCAI 2015, with ELU and batch normalisation as in the thesis; Oktay et al., Attention
U-Net, MIDL 2018 (additive gates on a grid).
"""

from __future__ import annotations

from itertools import pairwise
from typing import Literal

import torch
import torch.nn.functional as nnf
from torch import Tensor, nn

from learning.layers.convolution import Conv3d
from learning.layers.multiscale import MultiScaleNetwork


class GridAttention(nn.Module):
    """Weights 0..1 for every position of a skip, from the skip and from the next coarser level."""

    def __init__(self, skip: int, gate: int, dimensions: int = 2) -> None:
        """Build the gate for a skip and a coarser level, half as fine, of so many channels, in 2 or 3 dimensions."""
        super().__init__()
        conv, norm = (nn.Conv2d, nn.BatchNorm2d) if dimensions == 2 else (Conv3d, nn.BatchNorm3d)
        inner = max(skip // 2, 1)
        self.mode = "bilinear" if dimensions == 2 else "trilinear"
        self.theta = conv(skip, inner, 2, stride=2, bias=False)
        self.phi = conv(gate, inner, 1)
        self.psi = conv(inner, 1, 1)
        self.mix = nn.Sequential(conv(skip, skip, 1), norm(skip))

    def forward(self, skip: Tensor, gate: Tensor) -> Tensor:
        """Return the gated skip ``(B, skip, ...)``, with ``gate`` ``(B, gate, ...)`` of half its size."""
        weights = torch.sigmoid(self.psi(nnf.elu(self.theta(skip) + self.phi(gate))))
        weights = nnf.interpolate(weights, size=skip.shape[2:], mode=self.mode, align_corners=False)
        return self.mix(skip * weights)


class UNet(MultiScaleNetwork):
    """An encoder that halves the image at each level, a decoder that doubles it, and skips between them."""

    first_weight = "down.0.0.weight"

    def __init__(
        self,
        inputs: int,
        outputs: int,
        *,
        filters: int = 16,
        levels: int = 5,
        dimensions: Literal[2, 3] = 2,
        attention: bool = False,
        stem: int = 1,
        start: float = 0.0,
    ) -> None:
        """Build the network; weights are drawn by Xavier's rule (Glorot and Bengio 2010) from torch's generator.

        Args:
            inputs: see `MultiScaleNetwork` for this and the other sizes.
            outputs: linear.
            filters: of the first level.
            levels: how many.
            dimensions: 2 or 3.
            attention: gate the skips.
            stem: pixels per side that become channels.
            start: about what the output begins at: Adam takes hundreds of steps from 0 to the middle of a range.

        Raises:
            InputError: for sizes that `MultiScaleNetwork` refuses.
        """
        super().__init__(inputs, outputs, filters=filters, levels=levels, dimensions=dimensions, stem=stem)
        conv = nn.Conv2d if dimensions == 2 else Conv3d
        widths = [filters * 2**level for level in range(levels)]
        ins = [inputs * stem**2, *widths[:-1]]
        self.down = nn.ModuleList(_block(a, b, dimensions) for a, b in zip(ins, widths, strict=True))
        self.up = nn.ModuleList(conv(b, a, 3, padding=1) for a, b in pairwise(widths))
        self.merge = nn.ModuleList(_block(2 * a, a, dimensions) for a in widths[:-1])
        gates = pairwise(widths) if attention else ()
        self.gates = nn.ModuleList(GridAttention(a, b, dimensions) for a, b in gates)
        self.head = conv(widths[0], outputs * stem**2, 1)
        for module in self.modules():
            if isinstance(module, (nn.Conv2d, nn.Conv3d)):
                nn.init.xavier_uniform_(module.weight)
                if module.bias is not None:
                    nn.init.zeros_(module.bias)
        assert self.head.bias is not None
        nn.init.constant_(self.head.bias, start)

    def body(self, image: Tensor) -> Tensor:
        """Return ``(B, outputs * stem ** 2, ...)`` of ``(B, inputs * stem ** 2, ...)``, sides divisible by 2^(levels - 1)."""
        skips: list[Tensor] = []
        for level, block in enumerate(self.down):
            if level:
                image = nnf.max_pool2d(image, 2) if self.dimensions == 2 else nnf.max_pool3d(image, 2)
            image = block(image)
            skips.append(image)
        for level in reversed(range(self.levels - 1)):
            skip = skips[level]
            if self.gates:
                skip = self.gates[level](skip, image)
            image = self.up[level](nnf.interpolate(image, scale_factor=2.0, mode="nearest"))
            image = self.merge[level](torch.cat([skip, image], dim=1))
        return self.head(image)


def _block(inputs: int, outputs: int, dimensions: int) -> nn.Sequential:
    conv, norm = (nn.Conv2d, nn.BatchNorm2d) if dimensions == 2 else (Conv3d, nn.BatchNorm3d)
    layers: list[nn.Module] = []
    for source in (inputs, outputs):
        layers += [conv(source, outputs, 3, padding=1, bias=False), norm(outputs), nn.ELU()]
    return nn.Sequential(*layers)
