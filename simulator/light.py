"""Pictures of any kind as linear light: the one place that knows which files hold sRGB codes and which linear numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.colour import decode_srgb_picture
from simulator.errors import InputError
from simulator.exr import read_exr
from simulator.pictures import read_shown_picture, upright

_ORIENTATION = 274  # a tag of TIFF


def read_light(path: Path) -> NDArray[np.float32]:
    """Return a picture's linear light ``(H, W, 3)``: integers are sRGB with full scale 1, floating point is linear already.

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
        codes, alpha = read_shown_picture(path)
        light = _before_black(decode_srgb_picture(codes), alpha)
    if light.ndim == 2:
        light = np.repeat(light[..., np.newaxis], 3, axis=2)
    if not np.all(light >= 0):  # also catches NaN
        msg = f"{path}: {np.count_nonzero(~(light >= 0))} of its values are negative or NaN, and light is not; set them to 0"
        raise InputError(msg)
    return light


def _exr_light(path: Path) -> NDArray[np.float32]:
    channels, _ = read_exr(path)
    if set("RGB") <= channels.keys():
        return np.stack([channels[name] for name in "RGB"], axis=-1)
    if "Y" in channels:
        return channels["Y"]
    msg = f"{path}: its channels are {', '.join(channels)}; expected R, G and B, or Y"
    raise InputError(msg)


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
        msg = f"{path} cannot be read as a TIFF picture ({error}): check the file or fetch it again"
        raise InputError(msg) from error
    if values.ndim != 2 and not (values.ndim == 3 and values.shape[2] in (3, 4)):
        msg = f"{path} has an array of {' x '.join(map(str, values.shape))}; expected one picture, grey or RGB"
        raise InputError(msg)
    values, alpha = upright(values, orientation), None
    if values.ndim == 3 and values.shape[2] == 4:
        values, alpha = values[..., :3], values[..., 3]
        if not straight and np.ptp(alpha):
            msg = f"{path} has a fourth channel that is no straight alpha (its ExtraSamples are not 2); save it as RGB"
            raise InputError(msg)
        alpha = alpha if straight else None
    if values.dtype in (np.uint8, np.uint16):
        return _before_black(decode_srgb_picture(values), alpha)
    if values.dtype in (np.float16, np.float32, np.float64):
        if not np.isfinite(values).all():
            msg = f"{path} holds NaN or inf; set them to finite values"
            raise InputError(msg)
        return _before_black(values.astype(np.float32), alpha)
    msg = f"{path} holds {values.dtype}; expected 8 or 16 bit sRGB, or floating point linear light"
    raise InputError(msg)
