"""Reading one measured image (TIFF, OpenEXR, npy, PNG, raw) as the plain numbers that its file holds.

The numbers are taken as linear in light; nothing is decoded. What had to be decided about a file is said in its notes.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeAlias, cast, get_args

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.images import MAX_PIXELS, read_image
from simulator.text import share

MAX_VALUES = 2**31
"""Most values that are read from one file; a header may claim any size."""
RGB = ("R", "G", "B")
GREY = ("grey",)
Cfa: TypeAlias = Literal["RGGB", "BGGR", "GRBG", "GBRG", "none"]
"""Colours of a mosaic's upper left 2 x 2 pixels, as the file has them; none of an image that is no mosaic."""
_ALPHA = "its alpha channel is left out"
_DEPTHS = (
    "PSFs of several depths are a stack's folder: `flatlight calibrate` makes it of pictures, `flatlight psf --output` of "
    "psf: {measured: ..., depths_cm: [...]}"
)
_PALETTE = "holds the numbers of colours in a palette"
_NOT_LIGHT = {
    0: "holds 0 for white",
    3: _PALETTE,
    5: "holds the inks of a print (CMYK)",
}  # PhotometricInterpretation of TIFF 6.0
_JPEG = (6, 7)  # Compression
_EXTRA = "pip install 'flatlight[captures]', or in a clone uv run --extra captures"
_RAW = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".rw2", ".orf", ".pef", ".srw")
READABLE = (".tif", ".tiff", ".png", ".exr", ".npy", *_RAW)
"""Suffixes of the files that can be read."""


@dataclass(frozen=True)
class MeasuredImage:
    """One image as its file holds it.

    Attributes:
        values: ``(1, H, W)`` of a grey image or mosaic, ``(C, H, W)`` of colours; integer or float, all finite. Of raw files
            shares of full scale: without the black level that the file states, over the range that it states.
        notes: what was left out, or taken for granted, in words.
        cfa: the mosaic's colours, where the file states them.
    """

    values: NDArray[Any]
    notes: tuple[str, ...] = ()
    cfa: Cfa | None = None


def read_measured_image(path: Path, channels: tuple[str, ...] = RGB) -> MeasuredImage:
    """Read one image.

    Args:
        path: ``.tif``/``.tiff`` (one page), ``.png``, ``.exr``, ``.npy`` holding ``(H, W)``, ``(C, H, W)`` or ``(H, W, C)``,
            or a camera's raw file (``.dng``, ``.nef``, ...), which needs the extra `captures`.
        channels: the names of the channels, where there are more than one; an EXR file is searched for them.

    Returns:
        The image. An alpha channel is left out, and three equal channels are one.

    Raises:
        InputError: naming the file, when it is unreadable or holds something else.
    """
    suffix = path.suffix.lower()
    if suffix in _RAW:
        return _read_raw(path)
    if suffix == ".exr":
        found = MeasuredImage(_read_exr(path, channels))
    elif suffix == ".npy":
        found = _channels_first(read_npy(path), channels, path)
    elif suffix == ".png":
        found = _read_png(path)
    elif suffix in (".tif", ".tiff"):
        found = _channels_last(read_tiff(path), channels, path)
    elif not path.exists():
        raise InputError(path, "there is no such file or folder")
    else:
        raise InputError(
            path, "expected .tif, .tiff, .png, .exr, .npy (linear, without loss), or a raw file such as .dng"
        )
    values = check_numbers(found.values, path)
    if 0 in values.shape:
        raise InputError(path, f"got an array {values.shape}, which is empty")
    if len(values) == 3 and all(np.array_equal(values[0], other) for other in values[1:]):
        return replace(found, values=values[:1], notes=(*found.notes, "its three channels are equal: grey"))
    return found


def read_measurement(path: Path, channels: tuple[str, ...]) -> NDArray[Any]:
    """Return the values of an image alone, ``(1, H, W)`` or ``(C, H, W)``; see `read_measured_image`."""
    image = read_measured_image(path, channels)
    if len(image.values) not in (1, len(channels)):
        raise InputError(path, f"got {len(image.values)} channels; expected one grey image or {', '.join(channels)}")
    return image.values


def _channels_first(image: NDArray[Any], channels: tuple[str, ...], path: Path) -> MeasuredImage:
    """Return an array of one image, its channels first or last, or a stack of one such image, as ``(C, H, W)``."""
    shape = image.shape
    while image.ndim > 3 and len(image) == 1:
        image = image[0]
    if image.ndim == 3 and len(image) in (1, 3, len(channels)):
        axis, found = "first", MeasuredImage(image)
    else:
        axis, found = "last", _channels_last(image, channels, path)
    if image.ndim == 2 or (axis == "first" and len(image) == 1):
        return found
    names = channels if len(found.values) == len(channels) else RGB if len(found.values) == 3 else GREY
    note = f"{' x '.join(map(str, shape))}: its {axis} axis is taken as {', '.join(names)}"
    return replace(found, notes=(note, *found.notes))


def _channels_last(image: NDArray[Any], channels: tuple[str, ...], path: Path) -> MeasuredImage:
    """Return ``(H, W)`` or ``(H, W, C)`` as ``(C, H, W)``, without alpha."""
    counts = {1, 3, len(channels)}
    if image.ndim == 2:
        return MeasuredImage(image[None])
    if image.ndim == 3 and image.shape[2] in counts:
        return MeasuredImage(np.moveaxis(image, -1, 0))
    if image.ndim == 3 and image.shape[2] - 1 in counts:
        return MeasuredImage(np.moveaxis(image, -1, 0)[:-1], (_ALPHA,))
    wanted = " or ".join(map(str, sorted(counts)))
    cure = f"; {_DEPTHS}" if image.ndim > 2 else ""
    raise InputError(path, f"got an array {image.shape}; expected one image of {wanted} channels{cure}")


def read_npy(path: Path) -> NDArray[Any]:
    """Read an array of any shape; pickled objects are never loaded.

    Raises:
        InputError: naming the file, when it is not such a file, is cut short or too large.
    """
    try:
        mapped = np.load(path, mmap_mode="r", allow_pickle=False)
        if not isinstance(mapped, np.ndarray):
            raise InputError(path, "got an archive of arrays (.npz); expected one array: save it with numpy.save")
        _check_size(mapped.shape, path)
        return np.array(mapped)
    except InputError:
        raise
    except (OSError, ValueError, EOFError) as error:
        raise _unreadable(path, error) from error


def check_numbers(image: NDArray[Any], path: Path) -> NDArray[Any]:
    """Return the array if it holds finite real numbers.

    Raises:
        InputError: naming the file otherwise.
    """
    if image.dtype.kind not in "uif":
        raise InputError(path, f"holds values of type {image.dtype}; expected integers or floats")
    if image.dtype.kind == "f" and not np.all(np.isfinite(image)):
        bad = int(np.count_nonzero(~np.isfinite(image)))
        raise InputError(path, f"holds {bad} non-finite values: repair these pixels first")
    return image


def _read_png(path: Path) -> MeasuredImage:
    image = read_image(path)
    with path.open("rb") as file:
        kind = file.read(26)[25]  # of the header: 3 is a palette, 4 grey with alpha, 6 RGB with alpha
    if kind == 3:
        raise InputError(path, f"{_PALETTE}; save it as grey or RGB")
    notes = (_ALPHA,) if kind in (4, 6) else ()
    return MeasuredImage(image[None] if image.ndim == 2 else np.moveaxis(image, -1, 0), notes)


def read_tiff(path: Path) -> NDArray[Any]:
    """Read the one image of a TIFF file, ``(H, W)`` or ``(H, W, C)``.

    Raises:
        InputError: naming the file, when it is broken, too large, of several pages, or of numbers that are no light (a
            palette's, inks, white as 0, or with the losses of JPEG).
    """
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            pages = len(file.pages)
            if pages != 1:
                raise InputError(path, f"got {pages} pages; expected one image; {_DEPTHS}")
            page = file.pages.first
            _check_size(page.shape, path)
            lossy = "is compressed by JPEG, with loss" if page.compression in _JPEG else None
            if reason := _NOT_LIGHT.get(page.photometric, lossy):
                raise InputError(path, f"{reason}; save it as grey or RGB, black as 0, without loss")
            try:
                image, axes = page.asarray(), page.axes
            except ValueError as error:
                if "imagecodecs" not in str(error):
                    raise
                return _by_pillow(path, page)
    except InputError:
        raise
    # tifffile reports damage by many kinds of exceptions; whatever it is, the file cannot be used.
    except Exception as error:
        raise _unreadable(path, error) from error
    return np.moveaxis(image, 0, -1) if axes == "SYX" else image


def _by_pillow(path: Path, page: Any) -> NDArray[Any]:
    """Read a compressed TIFF (LZW) whose codec tifffile lacks, if Pillow holds its pixels without loss."""
    from PIL import Image

    if page.bitspersample == 8 or (page.samplesperpixel == 1 and page.dtype in (np.uint16, np.float32)):
        with Image.open(path) as image:
            return np.asarray(image)
    kind = f"{page.samplesperpixel} x {page.bitspersample} bits compressed by {page.compression.name}"
    raise InputError(path, f"got {kind}, which the extra `captures` reads: {_EXTRA}; or save it uncompressed")


def _read_exr(path: Path, channels: tuple[str, ...]) -> NDArray[Any]:
    """``(C, H, W)`` by the channels' names, or else red, green and blue, or a single one."""
    from simulator.io.exr import read_exr

    found, _ = read_exr(path)
    for names in (channels, RGB):
        if set(names) <= set(found):
            return np.stack([found[name] for name in names])
    light = {name: values for name, values in found.items() if name != "A"}
    if len(light) == 1:
        return next(iter(light.values()))[None]
    names = ", ".join(sorted(found))
    raise InputError(path, f"got the channels {names}; expected {', '.join(channels)}, or a single one")


def _read_raw(path: Path) -> MeasuredImage:
    """Return the mosaic of a raw file, black subtracted, as shares of the range that the file states."""
    if not path.exists():
        raise InputError(path, "there is no such file or folder")
    try:
        import rawpy
    except ImportError as error:
        raise InputError(path, f"raw files are read by rawpy, which is not installed: {_EXTRA}") from error
    try:
        with rawpy.imread(str(path)) as raw:
            if raw.raw_type != rawpy.RawType.Flat:  # pyright: ignore[reportAttributeAccessIssue]
                raise InputError(
                    path, "got a file of finished colours, expected the sensor's mosaic; convert it to TIFF"
                )
            mosaic, colours = np.array(raw.raw_image_visible), np.array(raw.raw_colors_visible)
            letters, black, white = raw.color_desc.decode(), np.array(raw.black_level_per_channel), raw.white_level
    except rawpy.LibRawError as error:  # pyright: ignore[reportAttributeAccessIssue]
        raise _unreadable(path, error) from error
    pattern = "".join(letters[k] for k in colours[:2, :2].ravel())
    cfa = "none" if len(set(pattern)) == 1 else cast(Cfa, pattern)
    if cfa not in get_args(Cfa):
        raise InputError(path, f"got the mosaic {pattern}, expected one of {', '.join(get_args(Cfa))}")
    levels = black[colours]
    values = (mosaic.astype(np.float32) - levels) / (white - levels)
    stated = ", ".join(f"{level:g}" for level in sorted(set(black.tolist())))
    notes = (f"black level {stated} and full scale {white:g} as its file states them",)
    return MeasuredImage(values[None].astype(np.float32), notes, cfa)


def _check_size(shape: tuple[int, ...], path: Path) -> None:
    values = int(np.prod([int(n) for n in shape], dtype=object)) if shape else 1
    if values > MAX_VALUES or max(shape, default=0) > MAX_PIXELS:
        raise InputError(path, f"claims {' x '.join(map(str, shape))} values; at most {MAX_VALUES} are read")


def _unreadable(path: Path, error: Exception) -> InputError:
    if isinstance(error, FileNotFoundError):
        return InputError(path, f"cannot be read: {error.strerror}; check its name and folder")
    return InputError(path, f"cannot be read ({type(error).__name__}: {error}): check the file or save it again")


def crop_window(crop: str, path: Path, shape: tuple[int, int], option: str = "crop") -> tuple[slice, slice]:
    """Return the rows and columns of a crop of an image of this shape.

    ``crop`` is ``ROWSxCOLUMNS`` about the centre, or ``ROWSxCOLUMNS+TOP+LEFT``; ``path`` and ``option`` are for messages.
    """
    found = re.fullmatch(r"(\d+)x(\d+)(?:\+(\d+)\+(\d+))?", crop.strip())
    if not found:
        wanted = "ROWSxCOLUMNS (about the centre) or ROWSxCOLUMNS+TOP+LEFT, e.g. 1080x1440+60+80"
        raise InputError(option, f"got {crop!r}, expected {wanted}")
    sizes = (int(found[1]), int(found[2]))
    starts = [(whole - size) // 2 for whole, size in zip(shape, sizes, strict=True)]
    if found[3]:
        starts = [int(found[3]), int(found[4])]
    for start, size, whole in zip(starts, sizes, shape, strict=True):
        if size < 1 or start < 0 or start + size > whole:
            beyond = f"reaches beyond {path} of {shape[0]} x {shape[1]} pixels; make it smaller"
            raise InputError(option, f"got {crop}, which {'is empty' if size < 1 else beyond}")
    rows, columns = (slice(start, start + size) for start, size in zip(starts, sizes, strict=True))
    return rows, columns


def check_binning(
    binning: int, path: Path, shape: tuple[int, ...], crop: str | None = "--crop", option: str = "--binning"
) -> None:
    """Refuse a binning of ``(..., H, W)`` that leaves pixels over: dropped in silence, they would shift image against PSF.

    ``path``, ``option`` and ``crop``, the option that cures it, None where there is none, are for messages.
    """
    rows, columns = shape[-2:]
    if not 1 <= binning <= min(rows, columns):
        raise InputError(option, f"got {binning}, expected 1 to {min(rows, columns)} pixels per side for {path}")
    if rows % binning or columns % binning:
        cure = f"add {crop} {rows // binning * binning}x{columns // binning * binning}"
        if crop is None:
            dividing = [str(n) for n in range(1, binning + 1) if not rows % n and not columns % n]
            cure = f"take {' or '.join(dividing[-2:])}, or cut the images first"
        raise InputError(option, f"got {binning}, which does not divide {path} of {rows} x {columns} pixels; {cure}")


# ---- full scale

_MOST_BITS = 32
_MOST_OF_SHARES = 2.0  # noise that was not clipped goes beyond full scale, but not so far
_PLATEAU = 20  # fewer full pixels are hot ones, or the brightest of an image that was divided by it
_BESIDE_PLATEAU = 0.01


@dataclass(frozen=True)
class FullScale:
    """What a file's numbers are shares of.

    Attributes:
        divisor: makes DN / 2^bits of them.
        full: the number of a pixel that is full.
        source: where these are from, in words.
        guessed: whether nothing but the type says so, which holds 16 bits or more whatever the sensor has.
    """

    divisor: float
    full: float
    source: str
    guessed: bool = False


def full_scale(image: MeasuredImage, bits: int | None, path: Path, option: str = "--bits") -> FullScale:
    """Return what full scale is in an image's numbers.

    Args:
        image: what was read from ``path``.
        bits: the sensor's bit depth, as the user says; None takes unsigned integers of up to 32 bits by their type, and
            floats as shares.
        path: for messages.
        option: what ``bits`` is called.

    Raises:
        InputError: no bit depth where the numbers do not tell it, or one that they contradict.
    """
    kind, top = image.values.dtype, float(image.values.max())
    if bits is None:
        if kind.kind == "f":
            if top > _MOST_OF_SHARES:
                wanted = f"shares of full scale, 0 to 1; or give {option}, which divides numbers by 2^bits"
                raise InputError(path, f"got floats up to {top:g}, expected {wanted}")
            return FullScale(1.0, 1.0, "floats, taken as DN / 2^bits")
        if kind.kind == "i" or 8 * kind.itemsize > _MOST_BITS:
            raise InputError(path, f"got numbers of type {kind}, which has no full scale; give {option}, the bit depth")
        bits, source = 8 * kind.itemsize, f"assumed from the file's type, {kind}"
        return FullScale(2.0**bits, 2.0**bits - 1, source, guessed=bits > 8)
    if not 1 <= bits <= _MOST_BITS:
        raise InputError(option, f"got {bits}, expected 1 to {_MOST_BITS}, the sensor's bit depth")
    if image.cfa is not None:
        raise InputError(option, f"got {bits}, but {path} states its own range; leave it out")
    if kind.kind == "u" and bits > 8 * kind.itemsize:
        raise InputError(option, f"got {bits}, but {path} has numbers of type {kind}; leave it out")
    if kind.kind == "f" and 0 < top <= 1 < bits:
        shown = f"holds floats that reach only {top / 2**bits:.2g} of 2^{bits}"
        raise InputError(option, f"got {bits}, but {path} {shown}, and seem to be shares of full scale; leave it out")
    if top >= 2.0**bits:
        raise InputError(path, f"got numbers up to {top:g}, expected at most {2.0**bits - 1:g} ({option} {bits})")
    return FullScale(2.0**bits, 2.0**bits - 1, "as told")


def full_pixels(values: NDArray[Any], full: float) -> tuple[NDArray[np.bool_], float]:
    """Return which pixels ``(H, W)`` of an image ``(C, H, W)`` are full in any channel, and from what number on.

    That is ``full``, or the brightest value where more pixels share it than are one per cent darker: 12 bits in 16, or
    a capture that was scaled, end somewhere below.
    """
    brightest = float(values.max())
    shared = np.count_nonzero(values == brightest)
    beside = np.count_nonzero(values >= (1 - _BESIDE_PLATEAU) * brightest) - shared
    if shared >= _PLATEAU and shared > beside and brightest > float(values.min()):
        full = min(full, brightest)
    return np.asarray((values >= full).any(axis=0)), full


def note_of_full(values: NDArray[Any], full: float) -> tuple[str, ...]:
    """Return what there is to say of an image ``(C, H, W)`` that is to be reconstructed, or is a PSF, if pixels are full."""
    filled, level = full_pixels(values, full)
    if np.count_nonzero(filled) < _PLATEAU:
        return ()
    at = "" if level == full else f" (at {level:g}, which so many share)"
    return (f"{share(float(filled.mean()))} of its pixels are full{at}: the linear model does not hold there",)


# ---- a mosaic's colours


def superpixels(mosaic: NDArray[Any], cfa: Cfa) -> NDArray[np.float64]:
    """Return red, green and blue ``(3, H // 2, W // 2)`` of a mosaic ``(1, H, W)``: a pixel for each of its 2 x 2.

    Green is the mean of its two. Nothing is interpolated: in a PSF that is read alike every colour has the same places, so
    the red image is the scene through the red PSF, as far as neither has detail finer than 2 pixels.
    """
    rows, columns = (size // 2 * 2 for size in mosaic.shape[-2:])
    phases = [mosaic[0, i:rows:2, j:columns:2].astype(np.float64) for i in (0, 1) for j in (0, 1)]
    return np.stack([np.mean([phases[k] for k in range(4) if cfa[k] == colour], axis=0) for colour in "RGB"])


def in_colours(
    image: MeasuredImage, cfa: Cfa | None, path: Path, option: str = "cfa", *, judge: bool = True
) -> NDArray[Any]:
    """Return an image with a mosaic's colours apart, ``(3, H // 2, W // 2)``, and any other image as it is.

    Args:
        image: what was read from ``path``.
        cfa: what the user says of a mosaic; None believes the file, and otherwise, with ``judge``, looks.
        path: for messages, as ``option`` is.
        option: what ``cfa`` is called.
        judge: whether a grey image that seems to be a mosaic is refused.

    Raises:
        InputError: it seems to be a mosaic, and nothing says of which colours; or it is too small for one.
    """
    told = cfa or image.cfa
    if len(image.values) > 1 or told == "none":
        return image.values
    if told is not None:
        if told not in get_args(Cfa):
            raise InputError(option, f"got {told!r}, expected one of {', '.join(get_args(Cfa))}")
        if min(image.values.shape[-2:]) < 2:
            raise InputError(path, f"got {image.values.shape[-2:]} pixels, too few for a mosaic of 2 x 2")
        return superpixels(image.values, told)
    if judge and looks_like_a_mosaic(image.values):
        wanted = "give its upper left 2 x 2 pixels, row by row: RGGB, BGGR, GRBG or GBRG; or none for a grey sensor"
        raise InputError(option, f"missing; {path} looks like the mosaic of a colour sensor; {wanted}")
    return image.values


_BLOCK = 16  # pixels each way
_APART = 0.01  # of the light; a grey sensor's converters differ by less, and DiffuserCam's hand by 0.0014
_LIKE, _SURE = 0.3, 4.0  # correlation, and the same over what chance makes of it


def looks_like_a_mosaic(image: NDArray[Any]) -> bool:
    """Return whether a grey image ``(1, H, W)`` seems to be the mosaic of a colour sensor.

    In a Bayer mosaic (red - blue) / 4 changes its sign from column to column and, as much, from row to row, for the greens
    lie on one diagonal; and (2 green - red - blue) / 4 changes as on a chessboard, by much the same share of the light
    everywhere (Alleysson, Suesstrunk and Herault, Linear demosaicing inspired by the human visual system, IEEE TIP 2005). Of
    a grey sensor the parts of these frequencies in blocks of the image are noise and detail, which know nothing of each
    other, or those of columns alone, which two converters read. Noise lowers the correlations, but does not shift them. Light
    to which a mosaic's colours respond alike looks grey, and is.
    """
    rows, columns = (size // _BLOCK for size in image.shape[-2:])
    part = image[0, : rows * _BLOCK, : columns * _BLOCK].astype(np.float64).reshape(rows, _BLOCK, columns, _BLOCK)
    if part.size == 0 or np.ptp(part) == 0:
        return False
    mean = np.hanning(_BLOCK + 2)[1:-1]  # without steps, or slopes of the image would look like changes
    windows = np.stack([mean, mean * (-1.0) ** np.arange(_BLOCK)]) / mean.sum()
    found = np.einsum("iajb,pa,qb->pqij", part, windows, windows, optimize=True).reshape(4, -1)
    light, by_columns, by_rows, chessboard = found - np.percentile(part, 1) * np.eye(4, 1)
    power = np.sum(light**2)
    pairs = ((by_columns, by_rows, _APART**2 * power), (chessboard, light, _APART * power))
    return any(_related(one, other, least) for one, other, least in pairs)


def _related(one: NDArray[np.float64], other: NDArray[np.float64], least: float) -> bool:
    """Return whether two values of many blocks are related, and their products add up to more than the least."""
    products = one * other
    total, chance = abs(products.sum()), np.sqrt(np.sum(products**2))
    return bool(total > max(least, _SURE * chance, _LIKE * np.sqrt(np.sum(one**2) * np.sum(other**2))))
