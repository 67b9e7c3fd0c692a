"""Temporal frame interpolation: frames between those of a film, so that a shutter of many rows sees motion.

Two ways, one interface: `simulator.importers.optical_flow` needs no files, `simulator.importers.superslomo` runs the
published network with weights that the user has. Every frame that was given stays as it is; only those in between are made.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError

Between = Callable[[NDArray[np.float32], NDArray[np.float32], list[float]], NDArray[np.float32]]
"""Two frames (H, W, 3) and N times in 0..1 -> the N frames (N, H, W, 3) at these times."""


class FrameInterpolator(Protocol):
    """Makes frames in between. Cheap to hold and to pickle; the same frames give the same bytes, in any process.

    Attributes:
        packages: what computes them, as pip knows it; its version counts in the data set's fingerprint.
    """

    packages: ClassVar[tuple[str, ...]]

    @property
    def inputs(self) -> tuple[Path, ...]:
        """Files whose contents decide what comes out; they are hashed into the data set's fingerprint."""
        ...

    def interpolate(self, frames: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
        """Return the frames with ``factor - 1`` new ones between each two; see :func:`interpolate_pairs`."""
        ...

    def record(self) -> dict[str, Any]:
        """Return what the frames are made by, JSON-serialisable; it is stored with each sample."""
        ...


def interpolate_pairs(frames: NDArray[np.float32], factor: int, between: Between) -> NDArray[np.float32]:
    """Put ``factor - 1`` frames between each two.

    Two equal frames have equal frames in between, which are copied: films repeat frames, and a still scene stays still.

    Args:
        frames: linear light ``(T, H, W, 3)``, float32, finite and not negative; 1 is white of the film. Brighter light is
            carried through.
        factor: frames that one becomes, 1 or more.
        between: makes the frames between two different ones.

    Returns:
        ``((T - 1) * factor + 1, H, W, 3)``, float32, finite and not negative; frame ``i * factor`` is frame ``i``, bit for
        bit.

    Raises:
        InputError: when shape, type, values or the factor break these rules.
    """
    if isinstance(factor, bool) or not isinstance(factor, int | np.integer) or factor < 1:
        raise InputError("factor", f"got {factor!r}, expected a whole number from 1, which changes nothing")
    if frames.ndim != 4 or frames.shape[-1] != 3 or 0 in frames.shape or frames.dtype != np.float32:
        raise InputError("frames", f"got {frames.dtype} {frames.shape}, expected float32 (T, H, W, 3), not empty")
    if not np.all(np.isfinite(frames)) or frames.min() < 0:
        raise InputError("frames", "got NaN, inf or negative values, expected linear light: leave the clip out")
    count, height, width, _ = frames.shape
    interpolated = np.empty(((count - 1) * factor + 1, height, width, 3), np.float32)
    interpolated[::factor] = frames
    times = [step / factor for step in range(1, factor)]
    for index, (first, second) in enumerate(pairwise(frames) if times else ()):
        inner = interpolated[index * factor + 1 : (index + 1) * factor]
        inner[:] = first if np.array_equal(first, second) else between(first, second, times)
    return interpolated
