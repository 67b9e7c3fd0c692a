"""From an RGB-D frame to depth planes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError


def plane_weights(
    depth_m: NDArray[np.floating], depths_m: NDArray[np.float64], method: str = "linear"
) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
    """Say how each pixel is shared between two neighbouring planes.

    Args:
        depth_m: ``(h, w)`` z in metres; values outside the planes' range are clamped to it.
        depths_m: ``(K,)`` planes, increasing; the last may be ``inf``.
        method: ``linear`` in disparity 1/z, or ``nearest`` in disparity (the thesis).

    Returns:
        ``(h, w)`` index of the nearer plane (at most K - 2, or 0 for K = 1), and ``(h, w)`` weight of the next farther
        plane, 0..1; the nearer one takes the rest.
    """
    if method not in ("linear", "nearest"):
        raise InputError("depth_assignment", f"got {method!r}, expected 'linear' or 'nearest'")
    if len(depths_m) == 1:
        return np.zeros(depth_m.shape, np.intp), np.zeros(depth_m.shape, np.float32)
    disparities = 1 / np.asarray(depths_m, np.float64)
    disparity = np.clip(1 / depth_m.astype(np.float64), disparities[-1], disparities[0])
    lower = np.clip(np.searchsorted(-disparities, -disparity, side="right") - 1, 0, len(depths_m) - 2)
    farther = (disparities[lower] - disparity) / (disparities[lower] - disparities[lower + 1])
    if method == "nearest":
        farther = np.round(farther)
    return lower, farther.astype(np.float32)


def split_planes(
    image: NDArray[np.float32], depth_m: NDArray[np.floating], depths_m: NDArray[np.float64], method: str = "linear"
) -> NDArray[np.float32]:
    """Distribute an image over depth planes; the planes add up to the image.

    Args:
        image: ``(C, h, w)``.
        depth_m: ``(h, w)`` z in metres.
        depths_m: ``(K,)`` planes, increasing.
        method: see ``plane_weights``.

    Returns:
        ``(K, C, h, w)`` float32.
    """
    lower, farther = plane_weights(depth_m, depths_m, method)
    volume = np.zeros((len(depths_m), *image.shape), np.float32)
    i, j = np.indices(depth_m.shape)
    volume[lower, :, i, j] = np.moveaxis(image * (1 - farther), 0, -1)
    if len(depths_m) > 1:
        volume[lower + 1, :, i, j] += np.moveaxis(image * farther, 0, -1)
    return volume


def outside_planes(depth_m: NDArray[np.floating], depths_m: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return where depths lie outside the planes' range; a single plane clamps nothing.

    A relative 1e-6 is forgiven: float32 depths of a surface exactly at the range's end.
    """
    if len(depths_m) == 1:
        return np.zeros(depth_m.shape, bool)
    return (depth_m < depths_m[0] * (1 - 1e-6)) | (depth_m > depths_m[-1] * (1 + 1e-6))


def clamped_share(depth_m: NDArray[np.floating], valid: NDArray[np.bool_], depths_m: NDArray[np.float64]) -> float:
    """Return the share of valid pixels whose depth lies outside the planes' range."""
    frames = zip(*(values.reshape(-1, *values.shape[-2:]) for values in (depth_m, valid)), strict=True)
    outside = sum(np.count_nonzero(seen & outside_planes(z, depths_m)) for z, seen in frames)  # one frame's memory
    return outside / max(np.count_nonzero(valid), 1)
