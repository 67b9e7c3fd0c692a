"""The networks, by name and by size, and trained ones as methods."""

from __future__ import annotations

from learning.camera import CaptureModel
from learning.models.flatnet import SIZES, FlatNet, FlatNet2D, FlatNet3D, LearnedMethod, build_network
from learning.models.videonet import VIDEO_SIZES, VideoMethod, VideoNet, build_videonet

__all__ = [
    "SIZES",
    "VIDEO_SIZES",
    "FlatNet2D",
    "FlatNet3D",
    "LearnedMethod",
    "VideoMethod",
    "VideoNet",
    "build_network",
    "build_videonet",
    "learned_method",
]


def learned_method(name: str, network: FlatNet | VideoNet, capture: CaptureModel) -> LearnedMethod | VideoMethod:
    """Return a trained network as a `learning.method.Method` of a name, for the camera that it was built for."""
    kind = VideoMethod if isinstance(network, VideoNet) else LearnedMethod
    return kind(name, network, capture)  # pyright: ignore[reportArgumentType]  of two pairs, the right one
