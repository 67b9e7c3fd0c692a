"""Distances between features of networks trained on other pictures: as a loss (VGG), as a metric (LPIPS).

Their weights are files that may be absent. They are looked for where torch keeps them, checked, and never downloaded; nothing
else takes their place unless it was asked for by name.
"""

from learning.perceptual.features import PerceptualLoss
from learning.perceptual.lpips_distance import LpipsDistance, available_lpips

__all__ = ["LpipsDistance", "PerceptualLoss", "available_lpips"]
