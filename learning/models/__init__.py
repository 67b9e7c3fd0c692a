"""The networks, by name and by size."""

from learning.models.flatnet import SIZES, FlatNet2D, FlatNet3D, LearnedMethod, build_network

__all__ = ["SIZES", "FlatNet2D", "FlatNet3D", "LearnedMethod", "build_network"]
