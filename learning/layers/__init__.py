"""Layers: inversion of the measurement in the Fourier domain, U-Nets, attention gates."""

from learning.layers.inversion import RegularisedInversion
from learning.layers.unet import GridAttention, UNet
from learning.layers.wiener import WienerInversion

__all__ = ["GridAttention", "RegularisedInversion", "UNet", "WienerInversion"]
