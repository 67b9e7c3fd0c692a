"""The sRGB transfer curve: the one place where encoded images become linear light and linear light becomes an image.

Source: IEC 61966-2-1:1999 with amendment 1, the piecewise curve with thresholds 0.04045 and 0.0031308.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError


def srgb_to_linear(encoded: NDArray[np.floating]) -> NDArray[np.float32]:
    """Remove the sRGB gamma.

    Args:
        encoded: any shape, floats, nominally 0..1; values outside continue the curve (nothing is clipped).

    Returns:
        Linear values, float32, same shape. Worked out in float64 and rounded once, so that all processors agree.

    Raises:
        InputError: when integers are given, whose full scale cannot be known here.

    Example:
        >>> srgb_to_linear(np.array([0.0, 0.5, 1.0])).round(4).tolist()
        [0.0, 0.21400000154972076, 1.0]
    """
    values = _floats(encoded, "encoded")
    curved = ((np.maximum(values, 0.04045) + 0.055) / 1.055) ** 2.4
    return np.where(values <= 0.04045, values / 12.92, curved).astype(np.float32)


def linear_to_srgb(linear: NDArray[np.floating]) -> NDArray[np.float32]:
    """Apply the sRGB gamma: the inverse of :func:`srgb_to_linear`.

    Args:
        linear: any shape, floats, nominally 0..1; values outside continue the curve (nothing is clipped).

    Returns:
        Encoded values, float32, same shape.

    Raises:
        InputError: when integers are given, whose full scale cannot be known here.
    """
    values = _floats(linear, "linear")
    curved = 1.055 * np.maximum(values, 0.0031308) ** (1 / 2.4) - 0.055
    return np.where(values <= 0.0031308, values * 12.92, curved).astype(np.float32)


def decode_srgb_image(image: NDArray[np.uint8] | NDArray[np.uint16]) -> NDArray[np.float32]:
    """Linear light of an 8 or 16 bit sRGB image, 1.0 at its full scale.

    Args:
        image: any shape, uint8 or uint16.

    Returns:
        Linear values 0..1, float32, same shape.

    Raises:
        InputError: for any other type.
    """
    if image.dtype not in (np.uint8, np.uint16):
        raise InputError("image", f"expected uint8 or uint16 (its full scale follows from that), got {image.dtype}")
    full_scale = int(np.iinfo(image.dtype).max)
    if image.size < full_scale:
        return srgb_to_linear(image / np.float64(full_scale))
    # Looking up is exact and, for images with more pixels than levels, many times faster.
    return srgb_to_linear(np.arange(full_scale + 1) / np.float64(full_scale))[image]


def _floats(values: NDArray[np.floating], name: str) -> NDArray[np.float64]:
    array = np.asarray(values)
    if not np.issubdtype(array.dtype, np.floating):
        raise InputError(
            name, f"must hold floats with 1.0 as full scale, got {array.dtype}: divide by the full scale first"
        )
    return array.astype(np.float64)
