"""What all our pictures share: paper, ink, letters, the way from linear light to a tile."""

from __future__ import annotations

import io
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.colour import linear_to_srgb
from simulator.types import FARTHEST_M

if TYPE_CHECKING:
    from PIL import Image

PAPER, INK, UNSEEN = (250, 250, 250), (25, 25, 25), (120, 120, 120)
_WHITE_PERCENTILE = 99.5  # of the lit values: a lamp in the picture or a highlight must not darken all the rest


def font(size: int) -> Any:
    """Return Pillow's own font, which is the same on every machine."""
    from PIL import ImageFont

    return ImageFont.load_default(size)


def fitted(text: str, size: int, width: int) -> str:
    """Return a text, shortened with an ellipsis where it is wider than ``width`` pixels."""
    letters = font(size)
    if letters.getlength(text) <= width:
        return text
    while text and letters.getlength(f"{text}…") > width:
        text = text[:-1]
    return f"{text.rstrip()}…"


def white_level(pictures: Iterable[NDArray[np.float32]]) -> float:
    """Return the radiance that a set of pictures shows as white; 1 where all is black."""
    lit = np.concatenate([picture[picture > 0] for picture in pictures])
    return float(np.percentile(lit, _WHITE_PERCENTILE)) if lit.size else 1.0


def encoded(linear: NDArray[np.float32], white: float = 1.0) -> NDArray[np.uint8]:
    """Return linear light as sRGB of 8 bits, ``white`` and what is brighter at 255."""
    return (linear_to_srgb(np.clip(linear / np.float32(white), 0, 1)) * 255).round().astype(np.uint8)


def resized(pixels: NDArray[np.uint8], height: int) -> Image.Image:
    """Return pixels ``(h, w, 3)`` as a picture of that height; enlarged pixels stay visible."""
    from PIL import Image

    rows, columns = pixels.shape[:2]
    rule = Image.Resampling.BOX if rows > height else Image.Resampling.NEAREST
    return Image.fromarray(pixels).resize((max(1, round(columns * height / rows)), height), rule)


def png_bytes(picture: Image.Image) -> bytes:
    """Return a picture as PNG, without clock times: the same picture gives the same bytes."""
    stream = io.BytesIO()
    picture.save(stream, "PNG", optimize=True)
    return stream.getvalue()


def depth_range(near_m: float, far_m: float) -> str:
    """Return a range of depths in words; one depth where both are alike.

    Example:
        >>> depth_range(0.036, 0.2), depth_range(0.3, 0.3)
        ('3.6 cm to 20 cm', '30 cm')
    """
    near, far = centimetres(near_m), centimetres(far_m)
    return near if near == far else f"{near} to {far}"


def centimetres(depth_m: float) -> str:
    """Return a depth in words."""
    return "infinity" if depth_m >= FARTHEST_M * (1 - 1e-6) else f"{depth_m * 100:.3g} cm"
