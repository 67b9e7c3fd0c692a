"""Pixels of a rendered picture that stand out falsely, mended from their neighbours: broken ones, and fireflies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# More broken pixels than this mean a broken scene, not a path tracer's rare accident.
_MAX_BROKEN_SHARE = 1e-3
_FIREFLY_RATIO = np.float32(2)


def repair(rgb: NDArray[np.float32]) -> tuple[NDArray[np.float32], int]:
    """Replace pixels that are not finite or are negative by the median of their sound neighbours.

    A path tracer divides by probabilities and now and then yields a NaN; one such pixel would spread over the whole
    measurement. Bright pixels are left alone: clamping them would bias the light.

    Args:
        rgb: ``(H, W, n)``, colour and any bands.

    Returns:
        The repaired picture and the number of pixels that were replaced.

    Raises:
        RuntimeError: when more than 0.1 % of the pixels (and more than one) are broken.
    """
    broken = ~np.all(np.isfinite(rgb) & (rgb >= 0), axis=-1)
    count = int(np.count_nonzero(broken))
    if count == 0:
        return rgb, 0
    if count > max(1, _MAX_BROKEN_SHARE * broken.size):
        msg = f"{count} of {broken.size} rendered pixels are not finite or negative: the scene holds broken values"
        raise RuntimeError(msg)
    repaired = rgb.copy()
    for row, column in np.argwhere(broken):
        window = (slice(max(row - 1, 0), row + 2), slice(max(column - 1, 0), column + 2))
        sound = rgb[window][~broken[window]]
        repaired[row, column] = np.median(sound, axis=0) if len(sound) else 0.0
    return repaired, count


def firefly_dimming(rgb: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the factors ``(H, W)`` in 0..1 that dim lone bright pixels to twice their second brightest neighbour.

    Where small lamps light wet walls, one path in thousands finds a lamp's mirror image by way of another wall; its pixel
    glares for want of the other paths that would share its light. Highlights of 2 x 2 pixels and more stay, and lines but
    for their ends.

    Args:
        rgb: ``(H, W, 3)``; pictures of one row or column are left as they are.
    """
    light = rgb.mean(axis=-1)
    rows, columns = light.shape
    if min(rows, columns) < 2:
        return np.ones_like(light)
    around = np.pad(light, 1, constant_values=-np.inf)
    places = [(row, column) for row in range(3) for column in range(3) if (row, column) != (1, 1)]
    neighbours = np.stack([around[row : row + rows, column : column + columns] for row, column in places])
    limit = _FIREFLY_RATIO * np.partition(neighbours, -2, axis=0)[-2]
    glaring = light > limit
    return np.divide(limit, light, out=np.ones_like(light), where=glaring)
