"""Reconstruction of one measurement: reading it, choosing its camera and method, writing the result."""

from learning.reconstruct.job import Reconstruction, reconstruct

__all__ = ["Reconstruction", "reconstruct"]
