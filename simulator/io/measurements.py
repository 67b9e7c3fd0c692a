"""Reading one measured image (TIFF, OpenEXR, npy, PNG) as the plain numbers that its file holds.

The numbers are taken as linear in light; nothing is decoded or scaled here.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.images import MAX_PIXELS, read_image

MAX_VALUES = 2**31
"""Most values that are read from one file; a header may claim any size."""


def read_measurement(path: Path, channels: tuple[str, ...]) -> NDArray[Any]:
    """Read one image.

    Args:
        path: ``.tif``/``.tiff`` (one page), ``.png``, ``.exr`` or ``.npy`` holding ``(H, W)`` or ``(C, H, W)``.
        channels: the channels' names; an EXR file is searched for them.

    Returns:
        ``(1, H, W)`` for a grey image or ``(C, H, W)``, integer or float, all finite.

    Raises:
        InputError: naming the file, when it is unreadable or holds something else.
    """
    readers = {".tif": _read_tiff, ".tiff": _read_tiff, ".png": read_image, ".npy": read_npy}
    if path.suffix.lower() == ".exr":
        image = _read_exr(path, channels)
    elif path.suffix.lower() in readers:
        image = readers[path.suffix.lower()](path)
        if image.ndim == 3 and path.suffix.lower() != ".npy":
            image = np.moveaxis(image, -1, 0)
    elif not path.exists():
        raise InputError(path, "there is no such file or folder")
    else:
        raise InputError(path, "expected .tif, .tiff, .png, .exr or .npy (linear, without loss)")
    image = image[None] if image.ndim == 2 else image
    if image.ndim != 3 or image.shape[0] not in (1, len(channels)) or 0 in image.shape:
        raise InputError(path, f"got an array {image.shape}; expected one grey image or {', '.join(channels)}")
    return check_numbers(image, path)


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


def _read_tiff(path: Path) -> NDArray[Any]:
    """``(H, W)`` or ``(H, W, C)``."""
    import tifffile

    try:
        with tifffile.TiffFile(path) as file:
            pages = len(file.pages)
            if pages != 1:
                raise InputError(path, f"got {pages} pages; expected one image: save one TIFF per depth, or one .npy")
            page = file.pages.first
            _check_size(page.shape, path)
            image, axes = page.asarray(), page.axes
    except InputError:
        raise
    # tifffile reports damage by many kinds of exceptions; whatever it is, the file cannot be used.
    except Exception as error:
        raise _unreadable(path, error) from error
    return np.moveaxis(image, 0, -1) if axes == "SYX" else image


def _read_exr(path: Path, channels: tuple[str, ...]) -> NDArray[Any]:
    """``(C, H, W)`` by the channels' names, or ``(H, W)`` when there is only one."""
    from simulator.io.exr import read_exr

    found, _ = read_exr(path)
    if set(channels) <= set(found):
        return np.stack([found[name] for name in channels])
    if len(found) == 1:
        return next(iter(found.values()))
    raise InputError(
        path, f"got the channels {', '.join(sorted(found))}; expected {', '.join(channels)}, or a single one"
    )


def _check_size(shape: tuple[int, ...], path: Path) -> None:
    values = int(np.prod([int(n) for n in shape], dtype=object)) if shape else 1
    if values > MAX_VALUES or max(shape, default=0) > MAX_PIXELS:
        raise InputError(path, f"claims {' x '.join(map(str, shape))} values; at most {MAX_VALUES} are read")


def _unreadable(path: Path, error: Exception) -> InputError:
    if isinstance(error, FileNotFoundError):
        return InputError(path, f"cannot be read: {error.strerror}; check its name and folder")
    cure = "check the file or save it again, uncompressed"
    return InputError(path, f"cannot be read ({type(error).__name__}: {error}): {cure}")
