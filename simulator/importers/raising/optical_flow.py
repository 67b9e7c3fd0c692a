"""Frames in between by dense optical flow: what Flatlight can do without any weights."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from simulator.importers.raising._between import raise_pairs
from simulator.importers.raising._dis import look_up, opencv, pixel_places
from simulator.importers.raising._motion import Motion

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

    Where the flow loses what moves far, such as a small thing on black that moves by more than its own width, light would
    vanish or double; there frames are cross-faded, see :func:`_keep_light`. Before a bright background a loss so small
    beside it goes unnoticed.

    Light beyond 1 is carried through (the flow sees it as white). Nothing in between is darker than black or brighter than
    the brightest pixel of its two frames.
    """

    packages: ClassVar[tuple[str, ...]] = ("opencv-python-headless",)

    @classmethod
    def checked(cls) -> OpticalFlow:
        """Return it where OpenCV is installed.

        Raises:
            InputError: when OpenCV is not installed.
        """
        opencv()
        return cls()

    @property
    def inputs(self) -> tuple[Path, ...]:
        """No files."""
        return ()

    def raise_frames(self, frames: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
        """Return the frames with ``factor - 1`` new ones between each two; see ``Raiser``."""
        return raise_pairs(frames, factor, _between)

    def record(self) -> dict[str, Any]:
        """Return the name, the flow and the version of what computes it."""
        return {"name": "optical_flow", "flow": "DIS medium, both directions", "opencv": opencv().__version__}


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
        opencv().GaussianBlur(picture.mean(2), (0, 0), sigma, borderType=opencv().BORDER_REPLICATE)
        for picture in (moved, faded)
    )
    off = np.abs(here - expected) / np.maximum(np.maximum(here, expected), TINY)
    share = ((off - SAME_LIGHT) / (OTHER_LIGHT - SAME_LIGHT)).clip(0, 1)[..., None]
    share = share**2 * (3 - 2 * share)
    return (1 - share) * moved + share * faded


def _inside(places: NDArray[np.floating]) -> NDArray[np.floating]:
    """Return 1 for places in the picture, falling to 0 within a pixel outside of it; ``(H, W, 1)``."""
    height, width = places.shape[:2]
    x, y = places[..., :1], places[..., 1:]
    beyond = np.maximum(np.maximum(-x, x - (width - 1)), np.maximum(-y, y - (height - 1)))
    return (1 - beyond).clip(0, 1)
