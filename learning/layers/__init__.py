"""Layers: inversion of the measurement in the Fourier domain, U-Nets, NAF networks, attention gates."""

from learning.layers.inversion import RegularisedInversion, WienerInversion
from learning.layers.naf import NafBlock, NafNet
from learning.layers.unet import GridAttention, UNet

__all__ = ["GridAttention", "NafBlock", "NafNet", "RegularisedInversion", "UNet", "WienerInversion"]
