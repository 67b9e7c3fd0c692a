"""The networks, by name and by size, and trained ones as methods."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any, NamedTuple

from learning.camera import CaptureModel
from learning.method import check_choices
from learning.models.flatnet import SIZES, FlatNet, FlatNet2D, FlatNet3D, LearnedMethod
from learning.models.videonet import VIDEO_SIZES, VideoMethod, VideoNet
from simulator.errors import InputError
from simulator.validation import now_called

__all__ = [
    "NETWORKS",
    "SIZES",
    "VIDEO_SIZES",
    "FlatNet2D",
    "FlatNet3D",
    "LearnedMethod",
    "VideoMethod",
    "VideoNet",
    "build_network",
    "full_architecture",
    "learned_method",
]


class Kind(NamedTuple):
    """A network, the numbers of its sizes, and what makes it a method."""

    network: type[FlatNet2D | FlatNet3D | VideoNet]
    sizes: Mapping[str, Mapping[str, Any]]
    method: type[LearnedMethod | VideoMethod]


NETWORKS = {
    "flatnet3d": Kind(FlatNet3D, SIZES, LearnedMethod),
    "flatnet2d": Kind(FlatNet2D, SIZES, LearnedMethod),
    "videonet": Kind(VideoNet, VIDEO_SIZES, VideoMethod),
}


def build_network(capture: CaptureModel, name: str, size: str = "compact", **changes: Any) -> FlatNet | VideoNet:
    """Return a network of `NETWORKS` for a camera, its weights drawn from torch's generator.

    ``changes`` are of the size's numbers; see `FlatNet` and `VideoNet`.

    Raises:
        InputError: an unknown name or size, or numbers that the network refuses.
    """
    numbers = _numbers(name, size)
    kind = NETWORKS[name].network
    known = [key for key in inspect.signature(kind).parameters if key != "capture"]
    for key in changes:
        if key not in known:
            raise InputError(key, f"unknown; {name} has {', '.join(known)}{now_called(key, known)}")
    return kind(capture, **{**numbers, **changes})


def full_architecture(architecture: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``network``, ``size`` and changes with all numbers of the size: it stays the same network when sizes change.

    Raises:
        InputError: an unknown name or size.

    Example:
        >>> full_architecture({"network": "flatnet3d", "size": "tiny", "filters": 8})["filters"]
        8
    """
    name, size = architecture.get("network"), architecture.get("size", "compact")
    return {"network": name, "size": size, **_numbers(name, size), **architecture}


def learned_method(name: str, network: FlatNet | VideoNet, capture: CaptureModel) -> LearnedMethod | VideoMethod:
    """Return a trained network as a `learning.method.Method` of a name, for the camera that it was built for."""
    (kind,) = {kind.method for kind in NETWORKS.values() if isinstance(network, kind.network)}
    return kind(name, network, capture)  # pyright: ignore[reportArgumentType]  of two pairs, the right one


def _numbers(name: Any, size: Any) -> Mapping[str, Any]:
    check_choices(("network", name, NETWORKS))
    sizes = NETWORKS[name].sizes
    check_choices(("size", size, sizes))
    return sizes[size]
