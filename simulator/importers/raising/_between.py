"""What all raisers share: the frames that came stay, and a pair of frames gives those in between."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError

Between = Callable[[NDArray[np.float32], NDArray[np.float32], list[float]], NDArray[np.float32]]
"""Two frames (H, W, 3) and N times in 0..1 -> the N frames (N, H, W, 3) at these times."""


def raise_pairs(frames: NDArray[np.float32], factor: int, between: Between) -> NDArray[np.float32]:
    """Put ``factor - 1`` frames between each two; see ``Raiser.raise_frames`` for what comes in and what goes out.

    Two equal frames have equal frames in between, which are copied: film repeats frames, and a still scene stays still.

    Args:
        frames: ``(T, H, W, 3)`` float32, linear.
        factor: 1 or more.
        between: makes the frames between two different ones.

    Raises:
        InputError: when shape, type, values or the factor are wrong.
    """
    check_frames(frames, factor)
    count, height, width, _ = frames.shape
    raised = np.empty(((count - 1) * factor + 1, height, width, 3), np.float32)
    raised[::factor] = frames
    if factor == 1:
        return raised
    times = [step / factor for step in range(1, factor)]
    for index, (first, second) in enumerate(pairwise(frames)):
        inner = raised[index * factor + 1 : (index + 1) * factor]
        inner[:] = first if np.array_equal(first, second) else between(first, second, times)
    return raised


def check_frames(frames: NDArray[np.float32], factor: int) -> None:
    """Refuse what cannot be raised.

    Raises:
        InputError: when shape, type, values or the factor are wrong.
    """
    if isinstance(factor, bool) or not isinstance(factor, int | np.integer) or factor < 1:
        msg = f"factor: got {factor!r}, expected a whole number, 1 or more (1 leaves the frames as they are)"
        raise InputError(msg)
    if frames.ndim != 4 or frames.shape[-1] != 3 or 0 in frames.shape or frames.dtype != np.float32:
        msg = f"frames: got {frames.dtype} {frames.shape}, expected float32 (T, H, W, 3) with at least one frame and pixel"
        raise InputError(msg)
    if not np.all(np.isfinite(frames)) or frames.min() < 0:
        msg = "frames: got NaN, inf or negative values, expected linear light: mend the film or leave the clip out"
        raise InputError(msg)
