"""Layers: inversion of the measurement in the Fourier domain, U-Nets, attention gates."""

from learning.layers.inversion import RegularisedInversion, WienerInversion
from learning.layers.unet import GridAttention, UNet

__all__ = ["GridAttention", "RegularisedInversion", "UNet", "WienerInversion"]
