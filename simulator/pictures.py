"""Lossless reading of picture files (PNG, WebP, JPEG, 8 bit or 16 bit grey) as the integers that they hold.

No gamma is removed here and no value scaled: the caller knows whether the numbers are sRGB codes or linear counts.

Data sets and measurements are read as they are stored, pixel by pixel beside their depths and masks (`read_picture`); the
user's own photographs as a viewer shows them, upright and with their transparency (`read_shown_picture`).
"""

from __future__ import annotations

import struct
import warnings
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError

if TYPE_CHECKING:
    from PIL.Image import Image

MAX_PIXELS = 178_956_970
"""Largest picture that is decoded, Pillow's own limit; a few bytes may claim any size, so headers are judged first."""

_BROKEN = (OSError, SyntaxError, ValueError, EOFError, struct.error, zlib.error)
_ORIENTATION = 274  # the tag of EXIF and of TIFF
# Pillow's modes whose pixels are exactly what the file holds, or a palette's colours; alpha is dropped.
_CONVERT = {
    "1": "L",
    "L": "L",
    "LA": "L",
    "La": "L",
    "RGB": "RGB",
    "RGBA": "RGB",
    "RGBX": "RGB",
    "P": "RGB",
    "PA": "RGB",
}


def read_picture(path: Path) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Read one picture without loss; an alpha channel is ignored, not multiplied in.

    Args:
        path: a file that Pillow reads.

    Returns:
        ``(H, W)`` for grey or ``(H, W, 3)`` for colour, row 0 at the top, uint8, or uint16 for 16 bit grey.

    Raises:
        InputError: when the file is missing, broken, too large, or of a kind that would lose bits (16 bit colour).
    """
    with _open(path) as image:
        mode = image.mode
        if mode.startswith("I;16"):
            return np.asarray(_load(image, path)).astype(np.uint16)
        if mode not in _CONVERT:
            msg = f"{path} has pixels of kind {mode!r}; expected 8 bit grey or RGB, or 16 bit grey: convert it"
            raise InputError(msg)
        loaded = _load(image, path)
        return np.asarray(loaded if loaded.mode == _CONVERT[mode] else loaded.convert(_CONVERT[mode]))


def read_shown_picture(path: Path) -> tuple[NDArray[np.uint8] | NDArray[np.uint16], NDArray[np.uint8] | None]:
    """Read one picture as it is meant to be seen: turned as its EXIF data say, and with its transparency.

    Args:
        path: a file that Pillow reads.

    Returns:
        The picture as :func:`read_picture` gives it, but upright; and its straight alpha ``(H, W)``, 255 for opaque, or None
        where it has none.

    Raises:
        InputError: as for :func:`read_picture`; when its EXIF data are damaged, or 16 bit grey has a transparent value.
    """
    values = read_picture(path)
    alpha = None
    with _open(path) as image:
        loaded = _load(image, path)
        if loaded.has_transparency_data:
            if values.dtype == np.uint16:
                msg = (
                    f"{path} has 16 bit grey with a transparent value, which is not read; save it without transparency"
                )
                raise InputError(msg)
            alpha = np.asarray(loaded.convert("RGBA"))[..., 3]
        try:
            orientation = loaded.getexif().get(_ORIENTATION, 1)
        except _BROKEN as error:
            msg = f"{path} has damaged EXIF data ({error}): save it again without them"
            raise InputError(msg) from error
    return upright(values, orientation), None if alpha is None else upright(alpha, orientation)


def upright(values: NDArray[Any], orientation: int) -> NDArray[Any]:
    """Return a picture ``(H, W)`` or ``(H, W, C)`` turned and mirrored as EXIF and TIFF number it; 1 is upright already.

    Example:
        >>> upright(np.array([[1, 2], [3, 4]]), 6).tolist()
        [[3, 1], [4, 2]]
    """
    if orientation in (5, 6, 7, 8):
        values = values.swapaxes(0, 1)
    if orientation in (2, 3, 6, 7):
        values = values[:, ::-1]
    return values[::-1] if orientation in (3, 4, 7, 8) else values


def picture_shape(path: Path) -> tuple[int, int]:
    """Rows and columns of a picture, from its header alone.

    Raises:
        InputError: as for :func:`read_picture`.
    """
    with _open(path) as image:
        return image.height, image.width


def _open(path: Path) -> Image:
    # Pillow is a dependency of the core, but listing sources and `flatlight --help` need none of it.
    from PIL import Image, UnidentifiedImageError

    _refuse_deep_colour(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # from half the limit on
            image = Image.open(path)
    except UnidentifiedImageError:
        msg = f"{path} is not a picture that can be read (PNG, WebP, JPEG): check the file or fetch it again"
        raise InputError(msg) from None
    except Image.DecompressionBombError as error:
        msg = f"{path} claims too many pixels; at most {MAX_PIXELS} are read"
        raise InputError(msg) from error
    except _BROKEN as error:
        msg = f"{path} cannot be opened as a picture: {error}"
        raise InputError(msg) from error
    if image.width * image.height > MAX_PIXELS:
        image.close()
        msg = f"{path} claims {image.height} x {image.width} pixels; at most {MAX_PIXELS} are read"
        raise InputError(msg)
    return image


def _load(image: Image, path: Path) -> Image:
    try:
        image.load()
    except _BROKEN as error:
        msg = f"{path} is damaged or cut short ({error}): fetch it again"
        raise InputError(msg) from error
    return image


def _refuse_deep_colour(path: Path) -> None:
    """Pillow silently keeps the upper byte of 16 bit colour; better to refuse than to lose half of the bits."""
    try:
        with path.open("rb") as file:
            head = file.read(26)
    except OSError as error:
        msg = f"{path} cannot be read: {error.strerror or error}"
        raise InputError(msg) from error
    grey = 0
    if head[:8] == b"\x89PNG\r\n\x1a\n" and len(head) == 26 and head[24] == 16 and head[25] != grey:
        msg = (
            f"{path} is a 16 bit colour PNG, which cannot be read here without losing bits: "
            "save it as a TIFF, an .npy or one grey 16 bit PNG per channel"
        )
        raise InputError(msg)
