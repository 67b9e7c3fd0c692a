"""A picture as a flat scene: a plane across the view that shines as the picture says; nothing is rendered."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scenes.models.resampling import area_mean
from simulator.colour import decode_srgb_picture
from simulator.errors import InputError
from simulator.exr import read_exr
from simulator.pictures import read_shown_picture, upright
from simulator.types import FARTHEST_M, Clip, View

_ORIENTATION = 274  # a tag of TIFF


def plane_depth(view: View, plane_cm: float | None) -> float:
    """Return the plane's depth in metres: as given, else midway between near and far in disparity.

    Raises:
        InputError: when it lies outside near..far.
    """
    if plane_cm is None:
        return min(2 / (1 / view.near_m + 1 / view.far_m), FARTHEST_M) if math.isfinite(view.near_m) else FARTHEST_M
    if not view.near_m <= plane_cm * 1e-2 <= view.far_m:
        msg = (
            f"plane_cm: got {plane_cm:g}, which is outside near..far = {view.near_m * 100:.4g}..{view.far_m * 100:.4g} cm; "
            "choose a depth inside, or set scene.near_cm and scene.far_cm"
        )
        raise InputError(msg)
    return plane_cm * 1e-2


def picture_clip(path: Path, view: View, depth_m: float, outputs: tuple[str, ...], source: dict[str, Any]) -> Clip:
    """Return a picture that fills the view, at one depth: one frame of 1 s.

    The largest centred part of the view's proportions is taken, and averaged to the view's pixels.

    Args:
        path: the picture.
        view: image shape.
        depth_m: of the plane.
        outputs: of the renderer; the plane is shape 0, faces the camera and reflects nothing.
        source: noted with the clip.

    Raises:
        InputError: when it cannot be read, or ``motion`` is asked of it.
    """
    if "motion" in outputs:
        msg = f"render.outputs: motion needs clips of at least 2 frames, and {path} is a still; leave it out"
        raise InputError(msg)
    light = read_light(path)
    factor = min(have / want for have, want in zip(light.shape, view.shape, strict=False))
    margins = [(have - factor * want) / 2 for have, want in zip(light.shape, view.shape, strict=False)]
    window = [(margin, have - margin) for margin, have in zip(margins, light.shape, strict=False)]
    rgb = np.maximum(area_mean(light, view.shape, window), 0)  # differences of sums may round below zero
    frame = (1, *view.shape)
    extras: dict[str, NDArray[Any]] = {}
    if "shape_id" in outputs:
        extras["shape_id"] = np.zeros(frame, np.int32)
    if "normal" in outputs:
        extras["normal"] = np.broadcast_to(np.array([0, 0, -1], np.float32), (*frame, 3)).copy()
    if "albedo" in outputs:
        extras["albedo"] = np.zeros((*frame, 3), np.float32)
    if "hidden" in outputs:
        msg = f"render.outputs: nothing is hidden behind the picture {path}; leave hidden out"
        raise InputError(msg)
    return Clip(
        rgb=rgb[np.newaxis],
        depth_m=np.full(frame, depth_m, np.float32),
        valid=np.ones(frame, bool),
        frame_edges_s=np.array([0.0, 1.0]),
        source=source,
        extras=extras,
    )


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
    for names in ("RGB", "Y"):
        if set(names) <= channels.keys():
            return np.stack([channels[name] for name in names], axis=-1 if len(names) > 1 else 0).squeeze()
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
