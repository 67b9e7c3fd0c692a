"""A mask of your own: `camera: {mask: {design: ./my_mask.py:vortex, charge: 8}}`."""

import numpy as np

from simulator.optics.mask import Mask


def vortex(*, width_mm: float = 2.0, charge: int = 4) -> Mask:
    """Return a phase vortex; its keyword arguments are its YAML keys, checked by type."""
    x = (np.arange(round(width_mm * 500)) - width_mm * 250 + 0.5) * 2e-6
    turns = np.mod(charge * np.arctan2(x[:, None], x[None, :]) / (2 * np.pi), 1)
    return Mask(turns * 532e-9 / 0.4607, np.ones_like(turns), pitch_m=2e-6)
