"""Temporal frame interpolation by dense optical flow (OpenCV's DIS): what Flatlight can do without any weights.

Sources: T. Kroeger, R. Timofte, D. Dai and L. Van Gool, "Fast optical flow using dense inverse search", ECCV 2016. S. Baker
et al., "A database and evaluation methodology for optical flow", IJCV 92 (2011), section 3.3.2: flow is carried along itself
to the time in between; what the flow of the other direction does not confirm is hidden there. OpenCV splits its work into
parts of a fixed number, so the same frames give the same bytes on any number of threads: its setting, which all of a process
shares, is left alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from simulator.colour import linear_to_srgb
from simulator.importers.frame_interpolation import interpolate_pairs
from simulator.importers.video_decoding import load_extra

cv2 = load_extra("cv2", "OpenCV")

ENLARGED = 2
"""DIS sees the frames this many times as large: it starts from a fixed size of patches, so that motion may be longer."""

SMALLEST = 32
"""Rows and columns that DIS is given at least, pixels: four of its patches."""

CONFIRMED_PIXELS = 2.0
"""Disagreement of the two flows, pixels, at which a point counts as seen by both frames with a weight of 1/e."""

TIE_COST = 0.1
"""Squared pixels of disagreement that one pixel of distance costs: of equally well confirmed flows the nearest one lands."""

COST_STEPS = 1024
"""Steps to a squared pixel in which costs are compared."""

FAINT = 1e-4
"""Visibility of what neither frame shows: it keeps the weights apart from zero, so that such a pixel is a plain blend."""

SURROUNDING = 0.25
"""Standard deviation of the Gaussian window in which light is compared, of the frame's shorter side."""

SAME_LIGHT, OTHER_LIGHT = 0.12, 0.25
"""Relative difference of light up to which the moved frame counts, and from which the cross-faded one does: new
things that a turning camera shows change it by 0.1."""

TINY = 1e-12
"""Light that is as good as none: it keeps black divided by black apart from NaN."""


@dataclass(frozen=True)
class OpticalFlow:
    """Looks both frames up along the flow and blends them by time and visibility.

    Where the flow loses what moves far, such as a small thing on black that moves by more than its width, light would vanish
    or double; there frames are cross-faded, see :func:`_keep_light`. Before a bright background so small a loss goes
    unnoticed.

    Light beyond 1 is carried through (the flow sees it as white). Nothing in between is darker than black or brighter than
    the brightest pixel of its two frames.
    """

    packages: ClassVar[tuple[str, ...]] = ("opencv-python-headless",)

    @property
    def inputs(self) -> tuple[Path, ...]:
        """No files."""
        return ()

    def interpolate(self, frames: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
        """Return the frames with ``factor - 1`` new ones between each two; see :func:`interpolate_pairs`."""
        return interpolate_pairs(frames, factor, _between)

    def record(self) -> dict[str, Any]:
        """Return the name, the flow and the version of what computes it."""
        return {"name": "optical_flow", "flow": "DIS medium, both directions", "opencv": cv2.__version__}


def _between(first: NDArray[np.float32], second: NDArray[np.float32], times: list[float]) -> NDArray[np.float32]:
    """Blend as equation 5 of Super SloMo (H. Jiang et al., CVPR 2018) does, with visibilities from the two flows."""
    motion = Motion.of(first, second)
    places = pixel_places(first.shape[:2])
    brightest = max(first.max(), second.max())
    frames = np.empty((len(times), *first.shape), np.float32)
    for index, time in enumerate(times):
        velocity, visible = motion.at(time)
        before, after = places - time * velocity, places + (1 - time) * velocity
        weight_first = (1 - time) * (visible[..., :1] * _inside(before) + FAINT)
        weight_second = time * (visible[..., 1:] * _inside(after) + FAINT)
        blended = weight_first * look_up(first, before) + weight_second * look_up(second, after)
        moved = (blended / (weight_first + weight_second)).clip(0, brightest)
        frames[index] = _keep_light(moved, (1 - time) * first + time * second)
    return frames


def _keep_light(moved: NDArray[np.float32], faded: NDArray[np.floating]) -> NDArray[np.floating]:
    """Go over to the cross-faded frame where the moved one does not hold as much light as that does in a wide surrounding.

    Of what moves by less than the surrounding's width both hold the same light there, though at other places.
    """
    sigma = SURROUNDING * min(moved.shape[:2])
    here, expected = (
        cv2.GaussianBlur(frame.mean(2), (0, 0), sigma, borderType=cv2.BORDER_REPLICATE) for frame in (moved, faded)
    )
    off = np.abs(here - expected) / np.maximum(np.maximum(here, expected), TINY)
    share = ((off - SAME_LIGHT) / (OTHER_LIGHT - SAME_LIGHT)).clip(0, 1)[..., None]
    share = share**2 * (3 - 2 * share)
    return (1 - share) * moved + share * faded


def _inside(places: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return 1 for places in the image, falling to 0 within a pixel outside of it; ``(H, W, 1)``."""
    height, width = places.shape[:2]
    x, y = places[..., :1], places[..., 1:]
    beyond = np.maximum(np.maximum(-x, x - (width - 1)), np.maximum(-y, y - (height - 1)))
    return (1 - beyond).clip(0, 1)


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

        Returns:
            Velocity ``(H, W, 2)`` in pixels per frame, and visibility ``(H, W, 2)`` in the first and in the second frame.
        """
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


def both_flows(first: NDArray[np.float32], second: NDArray[np.float32]) -> tuple[NDArray[np.float32], ...]:
    """Return the flow from the first frame ``(H, W, 3)`` of linear light to the second, and back.

    Returns:
        Twice ``(H, W, 2)`` float32, pixels to the right and down: what the frame shows at ``x`` is at ``x + flow[x]`` in the
        other one.
    """
    height, width = first.shape[:2]
    dis = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    grey = _grey(first), _grey(second)
    flows = []
    for here, there in (grey, grey[::-1]):
        flow = dis.calc(here, there, None)[: ENLARGED * height, : ENLARGED * width]
        flows.append(cv2.resize(flow, (width, height), interpolation=cv2.INTER_AREA) / np.float32(ENLARGED))
    return tuple(flows)


def _grey(frame: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return a frame as DIS takes it: 8 bit, encoded so that shadows count, light beyond 1 white."""
    encoded = (255 * linear_to_srgb(frame.clip(0, 1)) + 0.5).astype(np.uint8)
    grey = cv2.cvtColor(encoded, cv2.COLOR_RGB2GRAY)
    large = cv2.resize(grey, None, fx=ENLARGED, fy=ENLARGED, interpolation=cv2.INTER_CUBIC)
    rows, columns = (max(0, SMALLEST - size) for size in large.shape)
    return cv2.copyMakeBorder(large, 0, rows, 0, columns, cv2.BORDER_REPLICATE)


def look_up(image: NDArray[np.float32], places: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return an image ``(H, W[, channels])`` at other places ``(H, W, 2)``, column and row in pixels, bicubically.

    Beyond its edges the edge goes on. OpenCV rounds places to 1/32 pixel, so a flow that is nearly zero changes nothing.
    """
    x, y = (np.ascontiguousarray(places[..., axis], np.float32) for axis in (0, 1))
    return cv2.remap(image, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


def pixel_places(shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return column and row of each pixel, ``(H, W, 2)``."""
    rows, columns = np.indices(shape, dtype=np.float32)
    return np.stack((columns, rows), -1)
