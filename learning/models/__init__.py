"""The networks, by name and by size, and trained ones as methods."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any, NamedTuple

from learning.camera import CaptureModel
from learning.method import check_choices
from learning.models.activitynet import (
    ACTIVITY_SIZES,
    ActivityMethod,
    ActivityNet,
    Classifier,
    LensClassifier,
    RawClassifier,
)
from learning.models.flatnet import SIZES, FlatNet, FlatNet2D, FlatNet3D, LearnedMethod
from learning.models.videonet import VIDEO_SIZES, VideoMethod, VideoNet
from learning.models.videonet3d import VIDEO_3D_SIZES, Video3DMethod, VideoNet3D
from simulator.errors import InputError
from simulator.validation import now_called

__all__ = [
    "ACTIVITY_SIZES",
    "NETWORKS",
    "SIZES",
    "VIDEO_3D_SIZES",
    "VIDEO_SIZES",
    "ActivityMethod",
    "ActivityNet",
    "Classifier",
    "FlatNet2D",
    "FlatNet3D",
    "LearnedMethod",
    "LensClassifier",
    "Network",
    "RawClassifier",
    "Video3DMethod",
    "VideoMethod",
    "VideoNet",
    "VideoNet3D",
    "build_network",
    "full_architecture",
    "learned_method",
    "named",
]


Network = FlatNet | VideoNet | VideoNet3D | Classifier
"""Any of `NETWORKS`."""


class Kind(NamedTuple):
    """A network, the numbers of its sizes, and what makes it a method; None of what looks at no capture."""

    network: type[Network]
    sizes: Mapping[str, Mapping[str, Any]]
    method: type[LearnedMethod | VideoMethod | Video3DMethod | ActivityMethod] | None


_ONE_SIZE: dict[str, dict[str, Any]] = {"compact": {"classifier": "dronet"}}

NETWORKS = {
    "flatnet3d": Kind(FlatNet3D, SIZES, LearnedMethod),
    "flatnet2d": Kind(FlatNet2D, SIZES, LearnedMethod),
    "videonet": Kind(VideoNet, VIDEO_SIZES, VideoMethod),
    "videonet3d": Kind(VideoNet3D, VIDEO_3D_SIZES, Video3DMethod),
    "activitynet": Kind(ActivityNet, ACTIVITY_SIZES, ActivityMethod),
    "raw_classifier": Kind(RawClassifier, _ONE_SIZE, None),
    "lens_classifier": Kind(LensClassifier, {"compact": _ONE_SIZE["compact"] | {"frames": "all"}}, None),
}


def build_network(capture: CaptureModel, name: str, size: str = "compact", **changes: Any) -> Network:
    """Return a network of `NETWORKS` for a camera, its weights drawn from torch's generator.

    ``changes`` are of the size's numbers, and the ``classes`` of what tells some apart; see the networks.

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


def named(architecture: Mapping[str, Any]) -> dict[str, Any]:
    """Return an architecture as `build_network` takes it: ``name`` instead of ``network``."""
    return {"name" if key == "network" else key: value for key, value in architecture.items()}


def learned_method(
    name: str, network: Network, capture: CaptureModel
) -> LearnedMethod | VideoMethod | Video3DMethod | ActivityMethod:
    """Return a trained network as a `learning.method.Method` of a name, for the camera that it was built for.

    Raises:
        InputError: a network that estimates no images of captures.
    """
    (kind,) = {kind.method for kind in NETWORKS.values() if isinstance(network, kind.network)}
    if kind is None:
        reason = (
            f"got a {type(network).__name__}, which reconstructs nothing; take another network, such as activitynet"
        )
        raise InputError(name, reason)
    return kind(name, network, capture)  # pyright: ignore[reportArgumentType]  of several pairs, the right one


def _numbers(name: Any, size: Any) -> Mapping[str, Any]:
    check_choices(("network", name, NETWORKS))
    sizes = NETWORKS[name].sizes
    check_choices(("size", size, sizes))
    return sizes[size]
