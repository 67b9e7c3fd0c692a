"""The ray-traced lensless camera: sensor pixel -> mask opening -> scene, an independent check of the forward model.

It shares nothing with convolution: no depth planes, no shift invariance, no pinhole picture. What it measures differs from
the layered model by that model's own errors, occlusion first of all, and by Monte-Carlo noise, which is known.
"""

from simulator.render.lensless.camera import lensless_render
from simulator.render.lensless.shadow import shadow_psfs

__all__ = ["lensless_render", "shadow_psfs"]
