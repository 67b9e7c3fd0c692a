"""The two networks of Super SloMo, from named tensors alone.

Source: H. Jiang et al., "Super SloMo: High quality estimation of multiple intermediate frames for video interpolation", CVPR
2018, section 3.3 and figure 4; names, strides and the leaky output as in the public weights (A. Paliwal's, MIT licence).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

STRIDE = 32
"""Rows and columns must be multiples of this: five times halved."""

SLOPE = 0.1
"""Of the leaky rectifiers, section 3.3."""

_DOWN = ((32, 64, 5), (64, 128, 3), (128, 256, 3), (256, 512, 3), (512, 512, 3))
_UP = ((512, 512), (512, 256), (256, 128), (128, 64), (64, 32))


def tensor_shapes(channels_in: int, channels_out: int) -> dict[str, tuple[int, ...]]:
    """Return the name and shape of each tensor of a network with so many channels in and out."""
    convolutions = [("conv1", channels_in, 32, 7), ("conv2", 32, 32, 7)]
    for level, (before, after, size) in enumerate(_DOWN, start=1):
        convolutions += [(f"down{level}.conv1", before, after, size), (f"down{level}.conv2", after, after, size)]
    for level, (before, after) in enumerate(_UP, start=1):
        convolutions += [(f"up{level}.conv1", before, after, 3), (f"up{level}.conv2", 2 * after, after, 3)]
    convolutions.append(("conv3", 32, channels_out, 3))
    shapes: dict[str, tuple[int, ...]] = {}
    for name, before, after, size in convolutions:
        shapes[f"{name}.weight"] = (after, before, size, size)
        shapes[f"{name}.bias"] = (after,)
    return shapes


def u_net(tensors: Mapping[str, Any], planes: Any) -> Any:
    """Evaluate a network.

    Args:
        tensors: torch tensors, named and shaped as :func:`tensor_shapes` says.
        planes: torch ``(N, channels_in, H, W)``, H and W multiples of :data:`STRIDE`.

    Returns:
        ``(N, channels_out, H, W)``.
    """
    import torch
    from torch.nn import functional

    def layer(name: str, values: Any) -> Any:
        weight = tensors[f"{name}.weight"]
        convolved = functional.conv2d(values, weight, tensors[f"{name}.bias"], padding=weight.shape[-1] // 2)
        return functional.leaky_relu(convolved, SLOPE)

    values = layer("conv2", layer("conv1", planes))
    skipped = []
    for level in range(1, len(_DOWN) + 1):
        skipped.append(values)
        values = functional.avg_pool2d(values, 2)
        values = layer(f"down{level}.conv2", layer(f"down{level}.conv1", values))
    for level in range(1, len(_UP) + 1):
        values = functional.interpolate(values, scale_factor=2, mode="bilinear", align_corners=True)
        values = torch.cat((layer(f"up{level}.conv1", values), skipped.pop()), 1)
        values = layer(f"up{level}.conv2", values)
    return layer("conv3", values)
