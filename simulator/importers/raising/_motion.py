"""What moves where between two frames, and which of them shows it: from the flows of both directions.

Source: S. Baker et al., "A database and evaluation methodology for optical flow", IJCV 92 (2011), section 3.3.2: flow is
carried along itself to the time in between; what the flow of the other direction does not confirm is hidden there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.importers.raising._dis import both_flows, look_up, opencv, pixel_places

CONFIRMED_PIXELS = 2.0
"""Disagreement of the two flows, pixels, at which a point counts as seen by both frames with a weight of 1/e."""

TIE_COST = 0.1
"""Squared pixels of disagreement that one pixel of distance costs: of equally well confirmed flows the nearest one lands."""


COST_STEPS = 1024
"""Steps to a squared pixel in which costs are compared."""


@dataclass(frozen=True)
class Motion:
    """Where every pixel of two frames goes. N = 2 H W pixels, those of the first frame and then those of the second.

    Attributes:
        there: flow of the first frame, ``(H, W, 2)`` pixels.
        back: flow of the second frame, ``(H, W, 2)`` pixels.
        velocity: ``(N, 2)`` pixels per frame, forwards in time.
        visible: ``(N, 2)``, 0..1: how sure it is that the first frame and the second frame show this point.
        cost: ``(N,)``, squared pixels by which the two flows disagree.
    """

    there: NDArray[np.float32]
    back: NDArray[np.float32]
    velocity: NDArray[np.float32]
    visible: NDArray[np.float32]
    cost: NDArray[np.float32]

    @classmethod
    def of(cls, first: NDArray[np.float32], second: NDArray[np.float32]) -> Motion:
        """Measure the motion between two frames ``(H, W, 3)`` of linear light."""
        there, back = both_flows(first, second)
        places = pixel_places(there.shape[:2])
        lost = _squared(there + look_up(back, places + there)).ravel()
        found = _squared(back + look_up(there, places + back)).ravel()
        ones = np.ones_like(lost)
        own_first = np.stack((ones, np.exp(-lost / CONFIRMED_PIXELS**2)), -1)
        own_second = np.stack((np.exp(-found / CONFIRMED_PIXELS**2), ones), -1)
        velocity = np.concatenate((there.reshape(-1, 2), -back.reshape(-1, 2)))
        return cls(there, back, velocity, np.concatenate((own_first, own_second)), np.concatenate((lost, found)))

    def at(self, time: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the velocity at each pixel of the frame at a time, and how visible what is there is in both frames.

        Args:
            time: between 0 and 1.

        Returns:
            Velocity ``(H, W, 2)`` in pixels per frame, and visibility ``(H, W, 2)`` in the first and in the second frame.
        """
        cv2 = opencv()
        shape = self.there.shape[:2]
        winner = self._winner(time).reshape(shape)
        hole = winner < 0
        # Nothing comes to lie in a hole: there the flows of both frames at that pixel are mixed instead.
        velocity = np.where(hole[..., None], (1 - time) * self.there - time * self.back, self.velocity[winner])
        visible = np.where(hole[..., None], 1, self.visible[winner])
        smooth = [cv2.medianBlur(np.ascontiguousarray(velocity[..., axis], np.float32), 5) for axis in (0, 1)]
        return np.stack(smooth, -1), cv2.blur(visible.astype(np.float32), (5, 5))

    def _winner(self, time: float) -> NDArray[np.int64]:
        """Return which of the N pixels comes to lie on each pixel at a time, -1 where none does; ``(H W,)``."""
        height, width = self.there.shape[:2]
        places = pixel_places((height, width))
        landing = (places + time * self.there).reshape(-1, 2), (places + (1 - time) * self.back).reshape(-1, 2)
        x, y = np.ascontiguousarray(np.concatenate(landing).T)
        left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
        # The cost in the upper half and the pixel in the lower half of one number: its minimum is the cheapest pixel.
        number = np.arange(x.size)
        best = np.full(height * width, np.iinfo(np.int64).max)
        for column, row in ((left, top), (left + 1, top), (left, top + 1), (left + 1, top + 1)):
            distance = (column - x) ** 2 + (row - y) ** 2
            inside = (column >= 0) & (column < width) & (row >= 0) & (row < height) & (distance < 1)
            cost = np.minimum(COST_STEPS * (self.cost + TIE_COST * distance), 2**31 - 1).astype(np.int64)
            np.minimum.at(best, (row * width + column)[inside], (cost << 32 | number)[inside])
        return np.where(best < np.iinfo(np.int64).max, best & (2**32 - 1), -1)


def _squared(vectors: NDArray[np.float32]) -> NDArray[np.float32]:
    return vectors[..., 0] ** 2 + vectors[..., 1] ** 2
