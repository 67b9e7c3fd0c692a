"""Object masks of video data sets: palette PNGs whose indices are object numbers, and binary PNGs.

DAVIS and YouTube-VOS store one number per pixel as a palette index; the palette's colours are for the eye only. DAVIS 2016
stores 0 and 255; the common readers of DAVIS take the first channel should a file have several. Index 255 of a palette is
void: the evaluation of DAVIS 2017 (Pont-Tuset et al., arXiv 1704.00675; its code davis2017-evaluation, ``get_all_masks``)
sets it to background and keeps it apart, for comparisons to leave it out.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.images import image_shape

VOID = 255
"""The palette index of pixels that nobody has judged, such as an object's blurred edge."""


def read_object_numbers(path: Path) -> NDArray[np.uint8]:
    """Read a mask's object numbers.

    Args:
        path: a PNG of one of these kinds: palette, where the index is the number; grey with 0 and one other value, 1 or 255;
            one bit; colour with equal channels of 0 and 255.

    Returns:
        ``(H, W)``: 0 for background, ``VOID`` for void, else the object's number; the object of a binary mask is 1.

    Raises:
        InputError: naming the file, when it is missing, broken, or of another kind: colours do not tell object numbers.
    """
    from PIL import Image

    image_shape(path)  # a file that is not an image, or claims too many pixels, is refused by its header
    try:
        with Image.open(path) as image:
            mode, values = image.mode, np.asarray(image)
    except (OSError, SyntaxError, ValueError, EOFError) as error:
        raise InputError(path, f"damaged or cut short ({error}): fetch it again") from error
    if mode == "P":
        return values.astype(np.uint8, copy=False)
    if mode in ("1", "L"):
        return _binary(values.astype(np.uint8) * (255 if mode == "1" else 1), path)
    if mode in ("RGB", "RGBA") and np.all(values[..., :3] == values[..., :1]):
        return _binary(values[..., 0], path)
    raise InputError(
        path,
        f"got colours (kind {mode!r}), expected a palette PNG or a grey one with 0 and 255: fetch the originals",
    )


def object_pixels(numbers: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return where any object is: the union of all numbers but background and void, same shape."""
    return (numbers != 0) & (numbers != VOID)


def fit_mask(numbers: NDArray[np.uint8], shape: tuple[int, int], mask: Path, image: Path) -> NDArray[np.uint8]:
    """Return a mask in its image's size; one that is a pixel larger or smaller is resized, by nearest neighbour.

    Raises:
        InputError: when the sizes differ by more than a pixel.
    """
    found = numbers.shape
    if found == shape:
        return numbers
    if max(abs(found[0] - shape[0]), abs(found[1] - shape[1])) > 1:
        raise InputError(
            mask,
            f"got {found}, but its image {image} is {shape}; at most one pixel off is mended: fetch both again",
        )
    rows, columns = (
        ((np.arange(wanted) + 0.5) * had / wanted).astype(int) for wanted, had in zip(shape, found, strict=True)
    )
    return numbers[np.ix_(rows, columns)]


def _binary(values: NDArray[np.uint8], path: Path) -> NDArray[np.uint8]:
    found = np.unique(values).tolist()
    if not (set(found) <= {0, 255} or set(found) <= {0, 1}):
        shown = ", ".join(map(str, found[:5])) + (", ..." if len(found) > 5 else "")
        raise InputError(
            path,
            f"got grey values {shown}, expected 0 and 255, or a palette PNG with the objects' numbers; save it so",
        )
    return (values != 0).astype(np.uint8)
