"""Images of the page: small WebP files inside it, described in words."""

from __future__ import annotations

import base64
import io
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from simulator.plots.drawing import UNSEEN, centimetres, depth_colours
from simulator.plots.report.markup import Html, shown

if TYPE_CHECKING:
    from PIL import Image

FEW, SOME, MANY = 6_000, 40_000, 60_000
"""Bytes of an image at most: one of some hundreds, of some dozens, and one whose details matter."""
_QUALITIES = (85, 70, 50, 25)
_HOPELESS = 10  # times the bytes that an image may have: no image becomes so much smaller without loss


def shrunk(pixels: NDArray[np.uint8], side: int, *, mix: bool = True) -> NDArray[np.uint8]:
    """Return pixels ``(h, w, 3)`` with at most ``side`` rows and columns; without ``mix`` every pixel is one of them."""
    from PIL import Image

    rows, columns = pixels.shape[:2]
    share = side / max(rows, columns)
    if share >= 1:
        return pixels
    rule = Image.Resampling.BOX if mix else Image.Resampling.NEAREST
    size = (max(1, round(columns * share)), max(1, round(rows * share)))
    return np.asarray(Image.fromarray(pixels).resize(size, rule))


def picture(pixels: NDArray[np.uint8], described: str, most_bytes: int, **attributes: object) -> Html:
    """Return an image element of pixels ``(h, w, 3)``, exact where that takes few bytes.

    Args:
        pixels: sRGB.
        described: what is seen, for those who do not see it.
        most_bytes: of the file; the quality is the best of some with which it takes no more.
        attributes: more of the element; True stands for one without a value, False for none, ``_`` for ``-``.
    """
    from PIL import Image

    rows, columns = pixels.shape[:2]
    more = "".join(
        f" {name.replace('_', '-')}" + ("" if value is True else f'="{shown(value)}"')
        for name, value in attributes.items()
        if value is not False
    )
    source = f"data:image/webp;base64,{base64.b64encode(_webp(Image.fromarray(pixels), most_bytes)).decode()}"
    return Html(f'<img src="{source}" width="{columns}" height="{rows}" alt="{shown(described)}"{more}>')


def _webp(image: Image.Image, most_bytes: int) -> bytes:
    exact = [{"lossless": True}] if 3 * image.width * image.height <= _HOPELESS * most_bytes else []
    for options in (*exact, *({"quality": quality} for quality in _QUALITIES)):
        stream = io.BytesIO()
        image.save(stream, "WEBP", method=4, **options)
        if stream.tell() <= most_bytes:
            return stream.getvalue()
    return _webp(image.reduce(2), most_bytes)  # noise


def depth_legend(near_m: float, far_m: float) -> Html:
    """Return the scale of `depth_colours`, near on the left, and grey for what is not seen."""
    shares = np.linspace(0, 1, 9)  # the anchors of the colours
    depths_m = 1 / ((1 - shares) / near_m + shares / far_m)
    colours = depth_colours(depths_m[None].astype(np.float32), np.ones((1, 9), bool), near_m, far_m)[0]
    stops = "".join(
        f'<stop offset="{share:.3f}" stop-color="rgb{tuple(colour)}"/>'
        for share, colour in zip(shares, colours.tolist(), strict=True)
    )
    marks = "".join(
        f'<text x="{4 + 232 * share:.1f}" y="30" text-anchor="{anchor}">{shown(centimetres(depth_m))}</text>'
        for share, depth_m, anchor in zip(shares[::4], depths_m[::4], ("start", "middle", "end"), strict=True)
    )
    described = (
        f"Colours of depth: yellow is {centimetres(near_m)}, violet {centimetres(far_m)}, even in 1/z; grey: no surface"
    )
    return Html(
        f'<svg class="legend" viewBox="0 0 350 36" role="img" aria-label="{shown(described)}">'
        f'<defs><linearGradient id="depths">{stops}</linearGradient></defs>'
        f'<rect x="4" y="4" width="232" height="12" rx="2" fill="url(#depths)"/>{marks}'
        f'<rect x="260" y="4" width="14" height="12" rx="2" fill="rgb{UNSEEN}"/><text x="280" y="14">no surface</text></svg>'
    )
