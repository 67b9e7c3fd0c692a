"""Pictures and textures at another size, by averaging areas: no light is lost and nothing aliases."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def area_mean(
    values: NDArray[np.floating], shape: Sequence[int], window: Sequence[tuple[float, float]] | None = None
) -> NDArray[np.float32]:
    """Return the mean over the area of each new pixel; where pixels agree they keep their values.

    Args:
        values: ``(H, W, ...)`` linear light.
        shape: rows and columns of the result.
        window: first and last edge along rows and columns, in pixels of ``values`` and inside them; None is all of it.

    Returns:
        float32 ``(*shape, ...)``.

    Example:
        >>> area_mean(np.array([[1.0, 2.0, 3.0]]), (1, 2)).tolist()
        [[1.3333333730697632, 2.6666667461395264]]
    """
    result = np.asarray(values, dtype=np.float64)
    for axis, size in enumerate(shape):
        first, last = (0.0, float(values.shape[axis])) if window is None else window[axis]
        if size == values.shape[axis] and (first, last) == (0.0, float(size)):
            continue
        result = np.moveaxis(_along_rows(np.moveaxis(result, axis, 0), np.linspace(first, last, size + 1)), 0, axis)
    return result.astype(np.float32)


def _along_rows(values: NDArray[np.float64], edges: NDArray[np.float64]) -> NDArray[np.float64]:
    """Take means between edges by differences of the running sum, which is linear within a pixel."""
    running = np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])
    below = np.minimum(edges.astype(int), len(values) - 1)
    share = (edges - below).reshape(-1, *([1] * (values.ndim - 1)))
    return np.diff(running[below] + share * values[below], axis=0) / (edges[1] - edges[0])
