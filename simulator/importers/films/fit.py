"""From a picture's size to the view's: the largest part of the view's proportions, resampled in linear light."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.importers.extra import load_extra


@dataclass(frozen=True)
class Window:
    """A part of a picture, in its pixels: the first row and column, and how many of each."""

    row: int
    column: int
    rows: int
    columns: int

    @property
    def cut(self) -> tuple[slice, slice]:
        """The part as an index of ``(H, W, ...)``."""
        return slice(self.row, self.row + self.rows), slice(self.column, self.column + self.columns)

    def record(self) -> dict[str, Any]:
        """Where it lies, for a sample's record."""
        return {"corner_px": [self.row, self.column], "size_px": [self.rows, self.columns]}


def largest_window(
    size: tuple[int, int], shape: tuple[int, int], crop: Literal["centre", "random"], rng: np.random.Generator
) -> Window:
    """Return the largest window with the view's proportions, to the nearest whole pixel.

    Args:
        size: rows and columns of the picture.
        shape: rows and columns of the view.
        crop: in the ``centre`` or at a ``random`` place along the side on which something is cut off.
        rng: the sample's; drawn from only for ``random``.

    Example:
        >>> largest_window((240, 427), (160, 160), "centre", np.random.default_rng(0))
        Window(row=0, column=93, rows=240, columns=240)
    """
    scale = min(have / want for have, want in zip(size, shape, strict=True))
    rows, columns = (min(max(round(scale * want), 1), have) for have, want in zip(size, shape, strict=True))
    spare = size[0] - rows, size[1] - columns
    if crop == "centre":
        return Window(spare[0] // 2, spare[1] // 2, rows, columns)
    return Window(int(rng.integers(spare[0] + 1)), int(rng.integers(spare[1] + 1)), rows, columns)


def fit(picture: NDArray[np.float32], window: Window, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Cut a window out of a picture and resample it.

    Where the window is larger than the view, each new pixel is the mean over its area, so the mean light stays what it was;
    where it is smaller, values are interpolated bilinearly, so none is brighter or darker than its neighbours.

    Args:
        picture: linear light ``(H, W, 3)``.
        window: part of the picture.
        shape: rows and columns of the result.

    Returns:
        float32 ``(*shape, 3)``, a copy.

    Raises:
        InputError: OpenCV is not installed.
    """
    part = np.ascontiguousarray(picture[window.cut])
    if part.shape[:2] == shape:
        return part.copy() if np.shares_memory(part, picture) else part
    cv2 = load_extra("cv2", "OpenCV")
    shrinks = part.shape[0] >= shape[0] and part.shape[1] >= shape[1]
    return cv2.resize(part, shape[::-1], interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)


def fit_frames(
    frames: Iterable[NDArray[np.float32]],
    name: str,
    shape: tuple[int, int],
    crop: Literal["centre", "random"],
    rng: np.random.Generator,
) -> tuple[NDArray[np.float32], Window]:
    """Fit frames one after the other, all through the same window; only one frame at a time is held in its own size.

    Args:
        frames: linear light, each ``(H, W, 3)``.
        name: what they are called in messages.
        shape: rows and columns of the view.
        crop: see :func:`largest_window`.
        rng: the sample's.

    Returns:
        ``(T, *shape, 3)`` float32, and the window.

    Raises:
        InputError: there are none, or they differ in size.
    """
    fitted: list[NDArray[np.float32]] = []
    window, size = Window(0, 0, 0, 0), (0, 0)
    for frame in frames:
        if not fitted:
            size = frame.shape[:2]
            window = largest_window(size, shape, crop, rng)
        elif frame.shape[:2] != size:
            msg = (
                f"{name} changes its size from {size[0]} x {size[1]} to {frame.shape[0]} x {frame.shape[1]} pixels: "
                "split it where that happens"
            )
            raise InputError(msg)
        fitted.append(fit(frame, window, shape))
    if not fitted:
        msg = f"{name} gave no frames"
        raise InputError(msg)
    return np.stack(fitted), window
