"""Round apertures and the coordinates of a mask's samples, for designs that are drawn by formula."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import require_mask_memory

_SUBPIXELS = 16


def sample_positions_m(samples: int, pitch_m: float) -> NDArray[np.float64]:
    """Return the coordinates ``(samples,)`` of a mask's rows or columns, metres, zero at its middle."""
    return (np.arange(samples, dtype=np.float64) - (samples - 1) / 2) * pitch_m


def radius_squared_m2(samples: int, pitch_m: float) -> NDArray[np.float64]:
    """Return the squared distance of each sample of a square mask from its middle, ``(samples, samples)``, square metres."""
    x = sample_positions_m(samples, pitch_m)
    return x[:, None] ** 2 + x[None, :] ** 2


def round_aperture(samples: int, diameter: float) -> NDArray[np.float32]:
    """Return the share of each sample that lies inside a centred circle.

    Args:
        samples: side of the square grid.
        diameter: of the circle, in samples; a larger one than the grid is cut by it.

    Returns:
        ``(samples, samples)`` 0..1; rim samples are divided into 16 x 16, so their shares are right to about 0.5 %.

    Raises:
        InputError: for a grid that exceeds the machine's memory.

    Example:
        >>> round(float(round_aperture(21, 20).sum()) / 100, 2)  # pi
        3.14
    """
    require_mask_memory((samples, samples))
    x = sample_positions_m(samples, 1.0)
    radius = np.hypot(x[:, None], x[None, :])
    coverage = (radius <= diameter / 2).astype(np.float32)
    rows, columns = np.nonzero(np.abs(radius - diameter / 2) < 0.71)  # a sample's half diagonal
    sub = (np.arange(_SUBPIXELS) + 0.5) / _SUBPIXELS - 0.5
    y, x = x[rows][:, None] + sub, x[columns][:, None] + sub
    inside = y[:, :, None] ** 2 + x[:, None, :] ** 2 <= (diameter / 2) ** 2
    coverage[rows, columns] = inside.mean((1, 2))
    return coverage
