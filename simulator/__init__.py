"""Physically based simulation of lensless cameras: rendering, wave optics, shutter and sensor."""

__version__ = "0.2.0"
