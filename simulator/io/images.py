"""Images of any kind: the integers that they hold, and linear light; the one place that knows which files hold sRGB codes."""

from __future__ import annotations

import struct
import warnings
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from simulator.colour import decode_srgb_image
from simulator.errors import InputError
from simulator.io.deep_png import decode_deep_png, is_deep_png
from simulator.io.exr import read_exr
from simulator.io.files import read_errors

if TYPE_CHECKING:
    from PIL.Image import Image

MAX_PIXELS = 178_956_970
"""Largest image that is decoded, Pillow's own limit; a few bytes may claim any size, so headers are judged first."""

_BROKEN = (OSError, SyntaxError, ValueError, EOFError, struct.error, zlib.error)
_ORIENTATION = 274  # the tag of EXIF and of TIFF
# Pillow's modes whose pixels are exactly what the file holds, or a palette's colours; alpha is dropped.
_CONVERT = dict.fromkeys(("1", "L", "LA", "La"), "L") | dict.fromkeys(("RGB", "RGBA", "RGBX", "P", "PA"), "RGB")


Codes: TypeAlias = NDArray[np.uint8] | NDArray[np.uint16]


def read_image(path: Path) -> Codes:
    """Read one image without loss; an alpha channel is ignored, not multiplied in.

    Args:
        path: a file that Pillow reads.

    Returns:
        ``(H, W)`` for grey or ``(H, W, 3)`` for colour, row 0 at the top, uint8, or uint16 of 16 bit grey and of PNG.

    Raises:
        InputError: when the file is missing, broken, too large, or of a kind that would lose bits.
    """
    with _open(path) as image:
        if (deep := _deep(image, path)) is not None:
            return deep[0]
        mode = image.mode
        if mode.startswith("I;16"):
            return np.asarray(_load(image, path)).astype(np.uint16)
        if mode not in _CONVERT:
            raise InputError(path, f"got pixels of kind {mode!r}; expected grey or RGB of 8 bits, or of 16")
        loaded = _load(image, path)
        return np.asarray(loaded if loaded.mode == _CONVERT[mode] else loaded.convert(_CONVERT[mode]))


def read_shown_image(path: Path) -> tuple[Codes, Codes | None]:
    """Read one image as it is meant to be seen: rotated as its EXIF data say, and with its transparency.

    Args:
        path: a file that Pillow reads.

    Returns:
        The image as :func:`read_image` gives it, but upright; and its straight alpha ``(H, W)``, of which the type's largest
        number is opaque, or None where it has none.

    Raises:
        InputError: as for :func:`read_image`; when its EXIF data are damaged, or 16 bit grey has a transparent value.
    """
    with _open(path) as image:
        values, alpha = _deep(image, path) or (read_image(path), None)
        loaded = _load(image, path)
        if alpha is None and loaded.has_transparency_data:
            if values.dtype == np.uint16:
                raise InputError(path, "got 16 bit grey with a transparent value; save it without transparency")
            alpha = np.asarray(loaded.convert("RGBA"))[..., 3]
        try:
            orientation = loaded.getexif().get(_ORIENTATION, 1)
        except _BROKEN as error:
            raise InputError(path, f"has damaged EXIF data ({error}): save it again without them") from error
    return upright(values, orientation), None if alpha is None else upright(alpha, orientation)


def upright(values: NDArray[Any], orientation: int) -> NDArray[Any]:
    """Return an image ``(H, W)`` or ``(H, W, C)`` rotated and mirrored as EXIF and TIFF number it; 1 is upright already.

    Example:
        >>> upright(np.array([[1, 2], [3, 4]]), 6).tolist()
        [[3, 1], [4, 2]]
    """
    if orientation in (5, 6, 7, 8):
        values = values.swapaxes(0, 1)
    if orientation in (2, 3, 6, 7):
        values = values[:, ::-1]
    return values[::-1] if orientation in (3, 4, 7, 8) else values


def image_shape(path: Path) -> tuple[int, int]:
    """Rows and columns of an image, from its header alone.

    Raises:
        InputError: as for :func:`read_image`.
    """
    with _open(path) as image:
        return image.height, image.width


def _open(path: Path) -> Image:
    # Pillow is a dependency of the core, but listing sources and `flatlight --help` need none of it.
    from PIL import Image, UnidentifiedImageError

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # from half the limit on
            image = Image.open(path)
    except UnidentifiedImageError:
        raise InputError(path, "not an image that can be read (PNG, WebP, JPEG): fetch it again") from None
    except Image.DecompressionBombError as error:
        raise InputError(path, f"claims too many pixels; at most {MAX_PIXELS} are read") from error
    except _BROKEN as error:
        raise InputError(path, f"cannot be opened as an image: {error}") from error
    if image.width * image.height > MAX_PIXELS:
        image.close()
        raise InputError(path, f"claims {image.height} x {image.width} pixels; at most {MAX_PIXELS} are read")
    return image


def _load(image: Image, path: Path) -> Image:
    try:
        image.load()
    except _BROKEN as error:
        raise InputError(path, f"damaged or cut short ({error}): fetch it again") from error
    return image


def _deep(image: Image, path: Path) -> tuple[NDArray[np.uint16], NDArray[np.uint16] | None] | None:
    """Return image and alpha of an open PNG of 16 bits with several channels; None for every other file."""
    if image.format != "PNG":
        return None
    with read_errors(path):
        data = path.read_bytes()
    if not is_deep_png(data):
        return None
    try:
        pixels = decode_deep_png(data)
    except _BROKEN as error:
        raise InputError(path, f"damaged, cut short or of a rare kind ({error}): fetch it again") from error
    values = pixels[..., 0] if pixels.shape[2] == 2 else pixels[..., :3]
    return values, pixels[..., -1] if pixels.shape[2] in (2, 4) else None


def read_light(path: Path) -> NDArray[np.float32]:
    """Return an image's linear light ``(H, W, 3)``: integers are sRGB with full scale 1, floating point is linear already.

    It is upright (EXIF and TIFF orientation), and before black: what is transparent shines the less. The colours of EXR are
    before black by its standard, whatever its alpha.

    Raises:
        InputError: when it is missing, damaged, of an unknown kind, or holds negative light.
    """
    suffix = path.suffix.lower()
    if suffix == ".exr":
        light = _exr_light(path)
    elif suffix in (".tif", ".tiff"):
        light = _tiff_light(path)
    else:
        codes, alpha = read_shown_image(path)
        light = _before_black(decode_srgb_image(codes), alpha)
    if light.ndim == 2:
        light = np.repeat(light[..., np.newaxis], 3, axis=2)
    if not np.all(light >= 0):  # also catches NaN
        raise InputError(path, f"holds {np.count_nonzero(~(light >= 0))} negative values or NaN; set them to 0")
    return light


def _exr_light(path: Path) -> NDArray[np.float32]:
    channels, _ = read_exr(path)
    if set("RGB") <= channels.keys():
        return np.stack([channels[name] for name in "RGB"], axis=-1)
    if "Y" in channels:
        return channels["Y"]
    raise InputError(path, f"its channels are {', '.join(channels)}; expected R, G and B, or Y")


def _before_black(light: NDArray[np.float32], alpha: NDArray[Any] | None) -> NDArray[np.float32]:
    """Weight light by its straight alpha, whole numbers of full scale or 0..1."""
    if alpha is None:
        return light
    full = np.iinfo(alpha.dtype).max if np.issubdtype(alpha.dtype, np.integer) else 1
    share = (alpha / full).astype(np.float32)
    return light * (share if light.ndim == 2 else share[..., np.newaxis])


def _tiff_light(path: Path) -> NDArray[np.float32]:
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            values, page = file.asarray(), file.pages.first
            orientation = page.tags.valueof(_ORIENTATION, 1)
            straight = tuple(page.extrasamples) == (tifffile.EXTRASAMPLE.UNASSALPHA,)
    except Exception as error:  # tifffile raises whatever the broken bytes lead to
        raise InputError(path, f"cannot be read as a TIFF image ({error}): fetch it again") from error
    if values.ndim != 2 and not (values.ndim == 3 and values.shape[2] in (3, 4)):
        raise InputError(path, f"got an array {values.shape}; expected one image, grey or RGB")
    values, alpha = upright(values, orientation), None
    if values.ndim == 3 and values.shape[2] == 4:
        values, alpha = values[..., :3], values[..., 3]
        if not straight and np.ptp(alpha):
            raise InputError(path, "its fourth channel is not straight alpha (ExtraSamples 2); save it as RGB")
        alpha = alpha if straight else None
    if values.dtype in (np.uint8, np.uint16):
        return _before_black(decode_srgb_image(values), alpha)
    if values.dtype in (np.float16, np.float32, np.float64):
        if not np.isfinite(values).all():
            raise InputError(path, "holds NaN or inf; set them to finite values")
        return _before_black(values.astype(np.float32), alpha)
    raise InputError(path, f"holds {values.dtype}; expected 8 or 16 bit sRGB, or floating point linear light")


def filled(light: NDArray[np.floating], shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return linear light ``(H, W, 3)`` on so many rows and columns: the largest centred part of their proportions."""
    factor = min(have / want for have, want in zip(light.shape, shape, strict=False))
    margins = [(have - factor * want) / 2 for have, want in zip(light.shape, shape, strict=False)]
    window = [(margin, have - margin) for margin, have in zip(margins, light.shape, strict=False)]
    return np.maximum(area_mean(light, shape, window), 0)  # differences of sums may round below zero


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
