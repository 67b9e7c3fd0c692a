"""Reconstruction of one measurement: reading it, choosing its camera and method, writing the result."""
