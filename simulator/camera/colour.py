"""Scene colours as the camera's channels see them: a matrix on linear light, before anything else."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError


def to_camera(rgb: NDArray[np.float32], matrix: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return the camera's channels of a linear RGB image; negative results become 0, since no channel sees less than dark.

    Args:
        rgb: ``(H, W, 3)`` linear light.
        matrix: ``(C, 3)``.

    Returns:
        ``(C, H, W)`` float32.

    Raises:
        InputError: for a matrix of another shape.

    Example:
        >>> to_camera(np.float32([[[1, 0, 0], [1, 1, 1]]]), np.array([[0.5, 0.25, 0.25], [-0.5, 1, 0.5]])).tolist()
        [[[0.5, 1.0]], [[0.0, 1.0]]]
    """
    return np.maximum(_mixed(rgb, matrix), 0)


def clipped_share(rgb: NDArray[np.float32], matrix: NDArray[np.floating]) -> float:
    """Return the share of the channels' values that :func:`to_camera` raises to 0.

    Args:
        rgb: ``(H, W, 3)``.
        matrix: ``(C, 3)``.
    """
    return float(np.mean(_mixed(rgb, matrix) < 0))


def _mixed(rgb: NDArray[np.float32], matrix: NDArray[np.floating]) -> NDArray[np.float32]:
    if matrix.ndim != 2 or matrix.shape[1] != 3:
        msg = f"scene_to_camera: got a matrix of shape {matrix.shape}, expected (C, 3): a row per channel of the camera"
        raise InputError(msg)
    rows = matrix.astype(np.float32)[:, :, None, None]
    # Term by term, so that the bytes do not depend on how a library orders a product.
    return np.asarray(rows[:, 0] * rgb[..., 0] + rows[:, 1] * rgb[..., 1] + rows[:, 2] * rgb[..., 2], np.float32)
