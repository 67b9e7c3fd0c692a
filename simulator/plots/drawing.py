"""What all our images share: paper, ink, letters, colours for what has none, and what the colours mean."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.colour import linear_to_srgb
from simulator.types import FARTHEST_M

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from PIL import Image

PAPER, INK, UNSEEN = (250, 250, 250), (25, 25, 25), (120, 120, 120)
_WHITE_PERCENTILE = 99.5  # of the lit values: a lamp in the image or a highlight must not darken all the rest


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


def wrapped(text: str, size: int, width: int) -> list[str]:
    """Return a text in lines of at most ``width`` pixels, broken between words; a longer word is shortened."""
    lines: list[str] = []
    for word in text.split():
        longer = f"{lines[-1]} {word}" if lines else ""
        if longer and font(size).getlength(longer) <= width:
            lines[-1] = longer
        else:
            lines.append(fitted(word, size, width))
    return lines


def white_level(images: Iterable[NDArray[np.float32]]) -> float:
    """Return the radiance that a set of images shows as white; 1 where all is black."""
    lit = np.concatenate([image[image > 0] for image in images])
    return float(np.percentile(lit, _WHITE_PERCENTILE)) if lit.size else 1.0


def encoded(linear: NDArray[np.float32], white: float = 1.0) -> NDArray[np.uint8]:
    """Return linear light as sRGB of 8 bits, ``white`` and what is brighter at 255."""
    return (linear_to_srgb(np.clip(linear / np.float32(white), 0, 1)) * 255).round().astype(np.uint8)


def three_channels(planes: NDArray[np.float32], names: Sequence[str]) -> NDArray[np.float32]:
    """Return channels ``(C, H, W)`` as ``(H, W, 3)``: R, G, B where they exist, else the first three, else their mean."""
    if {"R", "G", "B"} <= set(names):
        return np.stack([planes[names.index(name)] for name in "RGB"], axis=-1)
    if len(planes) >= 3:
        return np.moveaxis(planes[:3], 0, -1)
    return np.repeat(planes.mean(axis=0)[..., None], 3, axis=-1)


def resized(pixels: NDArray[np.uint8], height: int) -> Image.Image:
    """Return pixels ``(h, w, 3)`` as an image of that height; enlarged pixels stay visible."""
    from PIL import Image

    rows, columns = pixels.shape[:2]
    rule = Image.Resampling.BOX if rows > height else Image.Resampling.NEAREST
    return Image.fromarray(pixels).resize((max(1, round(columns * height / rows)), height), rule)


def png_bytes(image: Image.Image) -> bytes:
    """Return an image as PNG, without clock times: the same image gives the same bytes."""
    stream = io.BytesIO()
    image.save(stream, "PNG", optimize=True)
    return stream.getvalue()


FRAMES_PER_SECOND = 5
"""Of animations."""


def animation_webp(frames: Sequence[Image.Image], milliseconds: int = 1000 // FRAMES_PER_SECOND) -> bytes:
    """Return images of one size as an endless animation; each shown for the same time."""
    stream = io.BytesIO()
    first, *others = frames
    first.save(stream, "WEBP", save_all=True, append_images=others, duration=milliseconds, loop=0, quality=90, method=4)
    return stream.getvalue()


def new_figure(size_inch: tuple[float, float], dpi: int, layout: Any = "constrained") -> Figure:
    """Return an empty white figure; pyplot, which keeps a global state, is not involved."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size_inch, dpi=dpi, facecolor="white", layout=layout)
    FigureCanvasAgg(figure)
    return figure


def figure_png(figure: Figure) -> bytes:
    """Return a figure as PNG; the same figure gives the same bytes."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", metadata={"Software": "flatlight"})
    return stream.getvalue()


def time_span(edges_s: NDArray[np.float64]) -> str:
    """Return the time from the first to the last of some edges in words.

    Example:
        >>> time_span(np.array([0.0015, 0.002, 0.003]))
        '1.5 to 3 ms'
    """
    return f"{edges_s[0] * 1e3:.4g} to {edges_s[-1] * 1e3:.4g} ms"


def seen_range_m(images: Sequence[tuple[NDArray[np.float32], NDArray[np.bool_]]]) -> tuple[float, float]:
    """Return the nearest and the farthest depth of (depth, valid) images where something was seen, or of all of them."""
    seen = np.concatenate([depth_m[valid] for depth_m, valid in images])
    if seen.size == 0:
        seen = np.concatenate([depth_m.ravel() for depth_m, _ in images])
    return float(seen.min()), float(seen.max())


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
    """Colour depths ``(..., h, w)`` evenly in disparity (1/z) from near (yellow) to far (violet), uint8; grey is unseen."""
    range_per_m = max(1 / near_m - 1 / far_m, 1e-12)
    share = np.clip((1 / near_m - 1 / depth_m.astype(np.float64)) / range_per_m, 0, 1)
    colours = _between(share, np.linspace(0, 1, len(_DEPTH)), _DEPTH)
    return seen_colours(colours, valid)


def id_colours(shape_id: NDArray[np.int32]) -> NDArray[np.uint8]:
    """Give each shape's number ``(h, w)``, -1 for unseen, its colour, the same in every image; neighbours differ much."""
    number = shape_id.astype(np.float64)
    # Steps of the golden section never come close to an earlier hue; the first number is often a background's, so it is pale.
    colours = _between(np.mod(0.6 + number * 0.618034, 1), _WHEEL_PLACES, _WHEEL)
    brightness = 1 - 0.2 * np.mod(number, 3)[..., None]
    paleness = 0.55 - 0.4 * np.mod(number, 2)[..., None]
    return seen_colours(255 * brightness * (paleness + (1 - paleness) * colours), shape_id >= 0)


def normal_colours(normal: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Colour normals ``(h, w, 3)`` in world axes as normal maps are: red right, green up, blue towards the camera.

    Components of -1 to 1 become 0 to 255; grey is a normal of zero: nothing was seen.
    """
    towards = normal.astype(np.float64) * (1, -1, -1)
    return seen_colours((towards + 1) * 127.5, np.any(normal != 0, axis=-1))


def motion_colours(
    motion: NDArray[np.float32], seen: NDArray[np.bool_], in_next: NDArray[np.bool_], largest_px: float
) -> NDArray[np.uint8]:
    """Colour motion ``(h, w, n)``, of which the first two are pixels to the right and down per frame.

    Hue is the direction (red is right, yellow down), white is rest; ``largest_px`` has the full colours, what is faster is
    darker. Points that the next frame does not show (``in_next``) are dark, grey is unseen.
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


LEGEND_WIDTH = 96
_DISC = 72  # pixels across


def draw_depth_legend(
    draw: Any, left: int, top: int, height: int, near_m: float, far_m: float, *, unseen: str | None = "no surface"
) -> None:
    """Draw the scale of `depth_colours` with five depths (one where all are alike), and below it what grey means.

    The scale is ``height`` pixels high; the grey takes 24 more, none where ``unseen`` is None.
    """
    width = 16
    steps = (1 / np.linspace(1 / near_m, 1 / far_m, height))[:, None].astype(np.float32)
    for row, colour in enumerate(depth_colours(steps, np.ones_like(steps, dtype=bool), near_m, far_m)[:, 0]):
        draw.line([(left, top + row), (left + width, top + row)], fill=tuple(colour.tolist()))
    for share in (0.0, 0.25, 0.5, 0.75, 1.0) if far_m > near_m else (0.5,):
        depth_m = 1 / ((1 - share) / near_m + share / far_m)
        place = (left + width + 6, top + share * (height - 1))
        draw.text(place, centimetres(depth_m), fill=INK, font=font(12), anchor="lm")
    if unseen is not None:
        draw.rectangle([(left, top + height + 8), (left + width, top + height + 24)], fill=UNSEEN)
        draw.text((left + width + 6, top + height + 16), unseen, fill=INK, font=font(12), anchor="lm")


def draw_normal_legend(sheet: Any, draw: Any, left: int, top: int) -> int:
    """Draw a ball in the colours of `normal_colours`; returns where it ends."""
    x, y, inside = _disc()
    towards = -np.sqrt(np.maximum(1 - x**2 - y**2, 0))
    normals = np.stack([x, y, towards], axis=-1).astype(np.float32)
    return _draw_disc(sheet, draw, left, top, normal_colours(normals), inside, ("normals:", "as on a ball"))


def draw_motion_legend(sheet: Any, draw: Any, left: int, top: int, largest_px: float) -> int:
    """Draw the wheel of `motion_colours` with the speed at its rim; returns where it ends."""
    x, y, inside = _disc()
    motion = np.stack([x, y], axis=-1).astype(np.float32) * np.float32(largest_px)
    colours = motion_colours(motion, inside, inside, largest_px * (1 + 1e-6))
    words = ("motion: at rim", f"{largest_px:.3g} px/frame", "dark: not in", "the next frame")
    return _draw_disc(sheet, draw, left, top, colours, inside, words)


def _disc() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    steps = (np.arange(_DISC) + 0.5) * 2 / _DISC - 1
    x, y = np.meshgrid(steps, steps)
    return x, y, np.hypot(x, y) <= 1


def _draw_disc(
    sheet: Any, draw: Any, left: int, top: int, colours: np.ndarray, inside: np.ndarray, words: tuple[str, ...]
) -> int:
    from PIL import Image

    image = np.where(inside[..., None], colours, np.array(PAPER, np.uint8)).astype(np.uint8)
    sheet.paste(Image.fromarray(image), (left, top))
    for line, text in enumerate(words):
        draw.text((left, top + _DISC + 4 + 14 * line), text, fill=INK, font=font(12))
    return top + _DISC + 4 + 14 * len(words)
