"""The networks, by name and by size."""

from learning.models.flatnet import FlatNet2D, FlatNet3D
from learning.models.sizes import SIZES, build_network

__all__ = ["SIZES", "FlatNet2D", "FlatNet3D", "build_network"]
