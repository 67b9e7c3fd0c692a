"""Shutters: which share of each frame interval every sensor row sees."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError


@dataclass(frozen=True)
class GlobalShutter:
    """All rows are exposed together, from time zero.

    Attributes:
        exposure_s: seconds.
    """

    exposure_s: float

    def __post_init__(self) -> None:
        if not 0 < self.exposure_s < np.inf:
            msg = f"exposure_s: got {self.exposure_s!r}, expected positive seconds (10 ms is 0.01)"
            raise InputError(msg)

    def weights(self, rows: int, frame_edges_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return S ``(T, rows)``: the share, 0..1, of each frame interval inside each row's window.

        With dt the frame durations, sum_t dt_t S[t, r] is the exposure time for every row.

        Args:
            rows: physical sensor rows, top first.
            frame_edges_s: ``(T + 1,)`` increasing seconds; must cover the exposure.

        Raises:
            InputError: when the clip is shorter than the exposure.
        """
        edges = np.asarray(frame_edges_s, np.float64)
        if edges[0] > 0 or edges[-1] < self.exposure_s * (1 - 1e-12):
            msg = (
                f"the clip lasts from {edges[0]:g} to {edges[-1]:g} s, but the shutter is open from 0 to "
                f"{self.exposure_s:g} s; use a longer clip or a shorter exposure"
            )
            raise InputError(msg)
        seen = np.clip(np.minimum(edges[1:], self.exposure_s) - np.maximum(edges[:-1], 0), 0, None)
        return np.repeat((seen / np.diff(edges))[:, None], rows, axis=1)
