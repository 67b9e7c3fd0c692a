"""Line patterns for a mask to cast: contours of Perlin noise, or of the user's own picture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.optics.noise import perlin

# A picture's edge begins where its contrast exceeds this share of the picture's range and goes on down to half of it.
_EDGE_CONTRAST = 0.2
# Up to this reach, in samples, a disc is drawn at every edge; above it that costs more than the distance from the edges.
_DISC_REACH = 8


def contours(samples: int, cell: float, line: float, seed: int) -> NDArray[np.float32]:
    """Return contour lines of Perlin noise, float32 ``(samples, samples)`` of 0 and 1.

    Args:
        samples: side of the image.
        cell: cell of the noise, in samples.
        line: width of the lines, in samples.
        seed: of the noise.
    """
    from skimage.feature import canny

    noise = perlin((samples, samples), cell, seed)
    # The thresholds follow the gradients' quantiles, as the original Canny implementation chooses them.
    edges = canny(noise, sigma=cell / 60, low_threshold=0.28, high_threshold=0.7, use_quantiles=True)
    if not edges.any():
        edges[samples // 2] = True  # a mask smaller than a cell may hold no contour: one line keeps it a camera
    return _widened(edges, line)


def contours_of_image(path: Path, samples: int, line: float) -> NDArray[np.float32]:
    """Return the line pattern of a picture, stretched to the mask, float32 ``(samples, samples)`` of 0 and 1.

    A picture of two grey levels is a pattern already: what is brighter is light. Any other gives its edges of at least a
    fifth of its contrast (Canny, blurred by a third of a line first), widened to lines.

    Args:
        path: square grey or colour picture (PNG, TIFF, EXR, npy); its top row is the mask's top as seen from behind the
            sensor.
        samples: side of the pattern.
        line: width of the lines drawn along edges, in samples.

    Raises:
        InputError: for a picture that is unreadable, not square, or without an edge.
    """
    from skimage.feature import canny
    from skimage.transform import resize

    from simulator.io.measurements import read_measurement

    image = np.asarray(read_measurement(path, ("R", "G", "B")), np.float64).mean(0)
    rows, columns = image.shape
    if abs(rows - columns) > 1:
        msg = f"image: {path} has {rows} x {columns} pixels, but the mask is square; crop the picture to a square first"
        raise InputError(msg)
    low, high = image.min(), image.max()
    if low == high:
        msg = (
            f"image: {path} is of one grey level everywhere; expected a picture with edges or a black and white pattern"
        )
        raise InputError(msg)
    fitted = resize((image - low) / (high - low), (samples, samples), order=1, anti_aliasing=rows > samples)
    if np.all((image == low) | (image == high)):
        return np.asarray(fitted >= 0.5, np.float32)
    sigma = line / 3
    # A step of contrast 1, blurred by sigma, in the units of the Sobel filter, which sums over 8 samples.
    steepest = 8 / (sigma * np.sqrt(2 * np.pi))
    low, high = (contrast * steepest for contrast in (_EDGE_CONTRAST / 2, _EDGE_CONTRAST))
    edges = canny(fitted, sigma=sigma, low_threshold=low, high_threshold=high)
    if not edges.any():
        msg = (
            f"image: {path} shows no edge at lines {line:.3g} mask pixels wide; use a narrower line_um or more contrast"
        )
        raise InputError(msg)
    return _widened(edges, line)


def _widened(edges: NDArray[np.bool_], line: float) -> NDArray[np.float32]:
    from scipy.ndimage import binary_dilation, distance_transform_edt

    reach = int(line / 2)
    if reach > _DISC_REACH:
        return (np.asarray(distance_transform_edt(~edges)) <= line / 2).astype(np.float32)
    y, x = np.ogrid[-reach : reach + 1, -reach : reach + 1]
    return binary_dilation(edges, x**2 + y**2 <= (line / 2) ** 2).astype(np.float32)
