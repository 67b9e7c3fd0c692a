"""The networks, by name and by size."""

from learning.models.flatnet import FlatNet2D, FlatNet3D
from learning.models.method import LearnedMethod
from learning.models.sizes import SIZES, build_network

__all__ = ["SIZES", "FlatNet2D", "FlatNet3D", "LearnedMethod", "build_network"]
