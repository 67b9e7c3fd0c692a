"""Grains: they fall out of a thing that is tipped over, and lie on the table then, or do so from the beginning."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from scenes.activity.cast import Cast
from scenes.activity.holds import GRAVITY_M_S2, Pose
from scenes.layout import rotation

Array = NDArray[np.float64]
GRAINS = 72


class Grains:
    """Ballistic flights from the lowest point of a tipped top to the table, where the grains stay."""

    def __init__(
        self, cast: Cast, pose: Callable[[float], Pose] | None = None, span_s: tuple[float, float] = (0.0, 0.0)
    ) -> None:
        """Let some lie on the table from the beginning, as the cast's manner says.

        The others fall out of the thing in a span of time, during which it has the ``pose``; without one they stay in it.
        """
        rng = np.random.default_rng(int(cast.luck[14] * 2**32))
        lying = round(cast.manner.spilled * GRAINS)
        falling = span_s[0] + (span_s[1] - span_s[0]) * np.sort(rng.random(GRAINS - lying))
        self._released_s = np.concatenate([np.full(lying, -np.inf), falling if pose else np.full(len(falling), np.inf)])
        tipped = cast.carried(cast.tipped_m, rotation(cast.main.forwards, cast.tip_rad))
        thing, side = cast.thing, math.copysign(1, cast.tip_rad)
        lip = side * thing.width_m / 2 * thing.share_at(0.98 * thing.height_m)
        starts, speeds = [], []
        for time_s in self._released_s:
            own = pose(float(time_s)) if pose and math.isfinite(time_s) else tipped
            opening = np.array([lip * rng.uniform(0.4, 1.0), -thing.height_m - cast.grain_m, 0])
            opening[2] = thing.depth_m * rng.uniform(-0.2, 0.2)
            starts.append(own.place_m + own.turn @ opening)
            speeds.append(own.turn @ (0, -rng.uniform(0.1, 0.3), 0) + rng.normal(0, 0.035, 3))
        self._starts_m, self._speeds = np.array(starts), np.array(speeds)
        fall = np.maximum(-cast.grain_m - self._starts_m[:, 1], 0)
        down = self._speeds[:, 1]
        self._lands_s = (np.sqrt(down**2 + 2 * GRAVITY_M_S2 * fall) - down) / GRAVITY_M_S2

    def at(self, time_s: float) -> Array | None:
        """Return the centres ``(GRAINS, 3)``, NaN where a grain is still inside; None where all are."""
        since = time_s - self._released_s
        if not (since >= 0).any():
            return None
        flown = np.clip(since, 0, self._lands_s)[:, np.newaxis]
        places = self._starts_m + self._speeds * flown
        places[:, 1] += 0.5 * GRAVITY_M_S2 * flown[:, 0] ** 2
        places[since < 0] = np.nan
        return places
