"""Networks by name, and their sizes: the thesis's, one for a laptop, one for tests.

FlatNet3D of 8 planes of 3 channels, scenes of 64 x 64, one CPU thread; training on 160 x 192 pixels, reconstruction by
`LearnedMethod` on 208 x 256:

| size    | parameters | training, ms per sample (float32 / bfloat16) | reconstruction, ms |
|---------|------------|----------------------------------------------|--------------------|
| tiny    |      9 216 |                                          16  |                  7 |
| compact |  2 163 348 |                                     29 / 26  |                 15 |
| thesis  | 35 928 104 |                                   321 / 185  |                 90 |

The inversion takes 12 ms of the training, with W(z) anew in each step, and 4 ms of the reconstruction, as constrained least
squares do: W(z), another 3 ms, is worked out when the method is built. Of FlatNet2D, which inverts at one plane, it takes
1 ms of the reconstruction, and W 0.3 ms.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

from learning.capture import CaptureModel
from learning.models.flatnet import FlatNet, FlatNet2D, FlatNet3D
from simulator.errors import InputError

NETWORKS: dict[str, type[FlatNet3D] | type[FlatNet2D]] = {"flatnet3d": FlatNet3D, "flatnet2d": FlatNet2D}
SIZES: dict[str, dict[str, Any]] = {
    "thesis": {"filters": 64, "levels": 5, "attention": True, "stem": 1},
    "compact": {"filters": 16, "levels": 5, "attention": False, "stem": 1},
    "tiny": {"filters": 4, "levels": 3, "attention": False, "stem": 1},
}


def build_network(capture: CaptureModel, name: str, size: str = "compact", **changes: Any) -> FlatNet:
    """Return a network for a camera, its weights drawn from torch's generator.

    Args:
        capture: the camera.
        name: ``flatnet3d`` or ``flatnet2d``.
        size: ``thesis``, ``compact`` or ``tiny``.
        changes: of the size's numbers; see `FlatNet3D`.

    Raises:
        InputError: an unknown name or size, or numbers that the network refuses.
    """
    _check(name, size)
    numbers = [key for key in inspect.signature(NETWORKS[name]).parameters if key != "capture"]
    for key in changes:
        if key not in numbers:
            msg = f"{key}: not a number of this network; {name} has {', '.join(numbers)}"
            raise InputError(msg)
    return NETWORKS[name](capture, **SIZES[size] | changes)


def full_architecture(architecture: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``network``, ``size`` and changes with all numbers of the size: it stays the same network when sizes change.

    Raises:
        InputError: an unknown name or size.

    Example:
        >>> full_architecture({"network": "flatnet3d", "size": "tiny", "filters": 8})["filters"]
        8
    """
    name, size = architecture.get("network"), architecture.get("size", "compact")
    _check(name, size)
    return {"network": name, "size": size, **SIZES[size], **architecture}


def _check(name: Any, size: Any) -> None:
    for what, value, known in (("network", name, NETWORKS), ("size", size, SIZES)):
        if value not in known:
            msg = f"{what}: got {value!r}, expected one of {', '.join(known)}"
            raise InputError(msg)
