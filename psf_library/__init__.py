"""Mask designs and PSF stacks."""
