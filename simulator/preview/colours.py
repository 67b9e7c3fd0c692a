"""Colours for what has none: depths, shape numbers, normals and motion. Grey is where nothing was seen, always."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.preview.drawing import UNSEEN

# Nine anchors from near (light) to far (dark), even in lightness so that depth also reads in greyscale.
_DEPTH = np.array(
    [
        (253, 231, 37),
        (173, 220, 48),
        (94, 201, 98),
        (40, 174, 128),
        (33, 145, 140),
        (44, 114, 142),
        (59, 82, 139),
        (71, 45, 123),
        (68, 1, 84),
    ],
    np.float64,
)
# Red, yellow, green, cyan, blue, magenta and red again, at distances that look alike: the wheel of Baker et al.,
# A Database and Evaluation Methodology for Optical Flow, IJCV 92, 2011.
_WHEEL = np.array([(1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 1, 1), (0, 0, 1), (1, 0, 1), (1, 0, 0)], np.float64)
_WHEEL_PLACES = np.array([0, 15, 21, 25, 36, 49, 55]) / 55
_BEYOND = 0.75  # brightness of motion that is faster than the scale's end
_HIDDEN = 0.6  # brightness of points that the next frame does not show: what rests there stays lighter than unseen grey


def depth_colours(
    depth_m: NDArray[np.float32], valid: NDArray[np.bool_], near_m: float, far_m: float
) -> NDArray[np.uint8]:
    """Colour depths evenly in disparity (1/z, what a camera resolves) from near (yellow) to far (violet); grey is unseen.

    Args:
        depth_m: ``(h, w)`` metres.
        valid: ``(h, w)``.
        near_m: depth of the first colour.
        far_m: depth of the last colour.

    Returns:
        ``(h, w, 3)`` uint8.
    """
    range_per_m = max(1 / near_m - 1 / far_m, 1e-12)
    share = np.clip((1 / near_m - 1 / depth_m.astype(np.float64)) / range_per_m, 0, 1)
    colours = _between(share, np.linspace(0, 1, len(_DEPTH)), _DEPTH)
    return seen_colours(colours, valid)


def id_colours(shape_id: NDArray[np.int32]) -> NDArray[np.uint8]:
    """Give each shape's number a colour of its own, the same in every picture; neighbours differ much.

    Args:
        shape_id: ``(h, w)``, -1 where nothing was seen.

    Returns:
        ``(h, w, 3)`` uint8.
    """
    number = shape_id.astype(np.float64)
    # Steps of the golden section never come close to an earlier hue; the first number is often a background's, so it is pale.
    colours = _between(np.mod(0.6 + number * 0.618034, 1), _WHEEL_PLACES, _WHEEL)
    brightness = 1 - 0.2 * np.mod(number, 3)[..., None]
    paleness = 0.55 - 0.4 * np.mod(number, 2)[..., None]
    return seen_colours(255 * brightness * (paleness + (1 - paleness) * colours), shape_id >= 0)


def normal_colours(normal: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Colour normals as normal maps are: red to the right, green upwards, blue towards the camera, from -1 to 1.

    Args:
        normal: ``(h, w, 3)`` in world axes (x right, y down, z into the scene); zero where nothing was seen.

    Returns:
        ``(h, w, 3)`` uint8.
    """
    towards = normal.astype(np.float64) * (1, -1, -1)
    return seen_colours((towards + 1) * 127.5, np.any(normal != 0, axis=-1))


def motion_colours(
    motion: NDArray[np.float32], seen: NDArray[np.bool_], in_next: NDArray[np.bool_], largest_px: float
) -> NDArray[np.uint8]:
    """Colour motion in the picture by direction (hue: red is right, yellow down) and speed (white is rest).

    Args:
        motion: ``(h, w, n)``, of which the first two are pixels to the right and down per frame.
        seen: ``(h, w)``, where there is a surface.
        in_next: ``(h, w)``, where the next frame shows the point too; elsewhere colours are dark.
        largest_px: speed of the full colours; what is faster has them darker.

    Returns:
        ``(h, w, 3)`` uint8.
    """
    right, down = (motion[..., axis].astype(np.float64) / largest_px for axis in (0, 1))
    speed = np.hypot(right, down)[..., None]
    hue = _between((np.arctan2(-down, -right) / np.pi + 1) / 2, _WHEEL_PLACES, _WHEEL)
    colours = np.where(speed <= 1, 1 - speed * (1 - hue), _BEYOND * hue)
    colours = np.where(in_next[..., None], colours, _HIDDEN * colours)
    return seen_colours(255 * colours, seen)


def seen_colours(colours: NDArray[np.floating] | NDArray[np.uint8], seen: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return colours ``(h, w, 3)`` of 0 to 255 as whole numbers, grey where nothing was seen."""
    return np.where(seen[..., None], np.round(colours), np.array(UNSEEN)).astype(np.uint8)


def _between(share: NDArray[np.float64], places: NDArray[np.float64], colours: NDArray[np.float64]) -> NDArray:
    """Interpolate colours ``(n, 3)`` that lie at ``places``."""
    return np.stack([np.interp(share, places, colours[:, channel]) for channel in range(3)], axis=-1)
