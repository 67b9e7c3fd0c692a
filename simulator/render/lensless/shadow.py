"""PSFs of geometric optics: the mask's shadow in the light of a point, or of a scene pixel, with exact shares of area."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError

Source = Literal["point", "pixel"]


def shadow_psfs(
    mask_amplitude: NDArray[np.floating],
    mask_pitch_m: float,
    distance_m: float,
    depths_m: Sequence[float] | NDArray[np.floating],
    pixel_pitch_m: float,
    *,
    source: Source = "point",
) -> NDArray[np.float64]:
    """Return the shadows of an amplitude mask, in the units and the frame of ``PsfStack.values``.

    A point on the axis at depth z magnifies the mask by m = 1 + d / z; a pixel of irradiance 1 / m^2 behind an opening
    receives the share of its area that the magnified opening covers.

    Args:
        mask_amplitude: ``(rows, columns)`` amplitude transmission of the mask's cells, in world axes; light passes as its
            square.
        mask_pitch_m: pitch of the cells, metres.
        distance_m: mask to sensor, metres.
        depths_m: z of the sources, metres; may be ``inf``.
        pixel_pitch_m: pitch of the sensor's pixels, metres.
        source: ``point``, as PSFs are made and measured; or ``pixel``, an even patch of the size of one scene pixel: with
            these, a scene that is even over each of its pixels is convolved without any error of sampling.

    Returns:
        ``(K, size, size)`` irradiance per irradiance at the mask, turned by 180 degrees, with the origin on sample
        ``size // 2``; an odd size that holds the largest shadow.

    Raises:
        InputError: for another word than these.
    """
    if source not in get_args(Source):
        msg = f"source: got {source!r}, expected one of {', '.join(get_args(Source))}"
        raise InputError(msg)
    depths = np.asarray(depths_m, np.float64)
    magnifications = 1 + distance_m / depths
    half_width = 0.5 * max(mask_amplitude.shape) * mask_pitch_m * magnifications.max() / pixel_pitch_m
    reach = 1 + int(np.ceil(half_width))
    transmittance = np.asarray(mask_amplitude, np.float64) ** 2
    shadows = []
    for magnification in magnifications:
        pitch = mask_pitch_m * magnification / pixel_pitch_m
        rows, columns = (_shares(count, pitch, reach, source) for count in transmittance.shape)
        shadows.append(rows @ transmittance @ columns.T / magnification**2)
    return np.flip(np.stack(shadows), (-2, -1))


def _shares(cells: int, pitch: float, reach: int, source: Source) -> NDArray[np.float64]:
    """Return how much of each pixel -reach .. reach every cell covers, ``(pixels, cells)``; ``pitch`` in pixels."""
    edges = (np.arange(cells + 1) - cells / 2) * pitch
    offsets = edges - np.arange(-reach, reach + 1)[:, np.newaxis]
    if source == "point":
        covered = np.clip(offsets, -0.5, 0.5)
    else:  # the even patch of one pixel, seen by the even pixel: a triangle
        near = np.clip(offsets, -1, 1)
        covered = near - 0.5 * np.sign(near) * near**2
    return np.asarray(np.diff(covered, axis=1), np.float64)
