"""Dense optical flow by OpenCV's DIS, and pictures looked up along it.

Source: T. Kroeger, R. Timofte, D. Dai and L. Van Gool, "Fast optical flow using dense inverse search", ECCV 2016. OpenCV
splits its work into parts of a fixed number, so the same frames give the same bytes on any number of threads: its setting,
which all of a process shares, is left alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.colour import linear_to_srgb
from simulator.errors import InputError

ENLARGED = 2
"""DIS sees the frames this many times as large: it starts from a fixed size of patches, so that motion may be longer."""

SMALLEST = 32
"""Rows and columns that DIS is given at least, pixels: four of its patches."""


def opencv() -> Any:
    """Return OpenCV.

    Raises:
        InputError: when it is not installed.
    """
    try:
        import cv2
    except ImportError as error:
        msg = "raise_with: optical_flow needs OpenCV, which is not installed; pip install 'flatlight[import]'"
        raise InputError(msg) from error
    return cv2


def both_flows(first: NDArray[np.float32], second: NDArray[np.float32]) -> tuple[NDArray[np.float32], ...]:
    """Return the flow from the first frame to the second, and back.

    Args:
        first: ``(H, W, 3)`` linear light.
        second: the same, one frame later.

    Returns:
        Twice ``(H, W, 2)`` float32, pixels to the right and down: what the frame shows at ``x`` is at ``x + flow[x]`` in the
        other one.
    """
    cv2 = opencv()
    height, width = first.shape[:2]
    dis = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    grey = _grey(first), _grey(second)
    flows = []
    for here, there in (grey, grey[::-1]):
        flow = dis.calc(here, there, None)[: ENLARGED * height, : ENLARGED * width]
        flows.append(cv2.resize(flow, (width, height), interpolation=cv2.INTER_AREA) / np.float32(ENLARGED))
    return tuple(flows)


def _grey(frame: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return a frame as DIS takes it: 8 bit, encoded so that shadows count, light beyond 1 white."""
    cv2 = opencv()
    encoded = (255 * linear_to_srgb(frame.clip(0, 1)) + 0.5).astype(np.uint8)
    grey = cv2.cvtColor(encoded, cv2.COLOR_RGB2GRAY)
    large = cv2.resize(grey, None, fx=ENLARGED, fy=ENLARGED, interpolation=cv2.INTER_CUBIC)
    rows, columns = (max(0, SMALLEST - size) for size in large.shape)
    return cv2.copyMakeBorder(large, 0, rows, 0, columns, cv2.BORDER_REPLICATE)


def look_up(picture: NDArray[np.float32], places: NDArray[np.floating]) -> NDArray[np.float32]:
    """Return a picture at other places, bicubically; beyond its edges the edge goes on.

    OpenCV rounds places to 1/32 pixel, so a flow that is nearly zero changes nothing.

    Args:
        picture: ``(H, W)`` or ``(H, W, channels)``.
        places: ``(H, W, 2)``, column and row, pixels.
    """
    cv2 = opencv()
    x, y = (np.ascontiguousarray(places[..., axis], np.float32) for axis in (0, 1))
    return cv2.remap(picture, x, y, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


def pixel_places(shape: tuple[int, int]) -> NDArray[np.float32]:
    """Return column and row of each pixel, ``(H, W, 2)``."""
    rows, columns = np.indices(shape, dtype=np.float32)
    return np.stack((columns, rows), -1)
