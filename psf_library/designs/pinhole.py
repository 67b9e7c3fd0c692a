"""A pinhole: one small round hole, the camera whose picture needs no computation."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from simulator.optics.mask import Mask


def pinhole(
    *,
    diameter_um: Annotated[float, Field(gt=0.1, le=1e4)] = 40.0,
    pixel_um: Annotated[float, Field(ge=0.05, le=20)] = 0.5,
) -> Mask:
    """Return a round hole with an area-weighted edge.

    Args:
        diameter_um: diameter of the hole.
        pixel_um: mask pixel.
    """
    amplitude = disc(diameter_um / pixel_um)
    return Mask(np.zeros_like(amplitude), amplitude, pixel_um * 1e-6, profile="staircase", name="pinhole")


def disc(diameter: float, supersample: int = 16) -> np.ndarray:
    """Return a disc's area coverage per pixel, float32, on the smallest odd grid that holds it.

    Args:
        diameter: in pixels.
        supersample: sub-pixels per pixel and axis.
    """
    size = 2 * int(np.ceil(diameter / 2)) + 1
    fine = (np.arange(size * supersample) + 0.5) / supersample - size / 2
    inside = (fine[:, None] ** 2 + fine[None, :] ** 2 <= (diameter / 2) ** 2).astype(np.float32)
    return inside.reshape(size, supersample, size, supersample).mean((1, 3))
