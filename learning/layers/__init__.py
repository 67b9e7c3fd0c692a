"""Layers: inversion of the measurement in the Fourier domain, U-Nets, NAF networks, attention gates."""
