"""Frames in between by dense optical flow, without any weights."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.colour import linear_to_srgb
from simulator.errors import InputError
from simulator.importers.raising._between import raise_pairs


@dataclass(frozen=True)
class OpticalFlow:
    """Warps both frames along DIS flow and blends them (T. Kroeger et al., ECCV 2016; S. Baker et al., IJCV 2011)."""

    @classmethod
    def checked(cls) -> OpticalFlow:
        """Return it where OpenCV is installed.

        Raises:
            InputError: when OpenCV is not installed.
        """
        _opencv()
        return cls()

    @property
    def inputs(self) -> tuple[Path, ...]:
        """No files."""
        return ()

    def raise_frames(self, frames: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
        """Return the frames with ``factor - 1`` new ones between each two; see ``Raiser``."""
        return raise_pairs(frames, factor, _between)

    def record(self) -> dict[str, Any]:
        """Return the name and what computes the flow."""
        return {"name": "optical_flow", "flow": "DIS medium", "opencv": _opencv().__version__}


def _between(first: NDArray[np.float32], second: NDArray[np.float32], times: list[float]) -> NDArray[np.float32]:
    cv2 = _opencv()
    least = 32
    height, width = first.shape[:2]
    rows, columns = max(0, least - height), max(0, least - width)
    grey = [
        cv2.copyMakeBorder(
            cv2.cvtColor(np.uint8(255 * linear_to_srgb(frame.clip(0, 1)) + 0.5), cv2.COLOR_RGB2GRAY),
            0, rows, 0, columns, cv2.BORDER_REPLICATE,
        )
        for frame in (first, second)
    ]  # fmt: skip
    dis = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    there = dis.calc(grey[0], grey[1], None)[:height, :width]
    back = dis.calc(grey[1], grey[0], None)[:height, :width]
    grid = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).astype(np.float32)
    out = np.empty((len(times), *first.shape), np.float32)
    for frame, t in zip(out, times, strict=True):
        to_first = -(1 - t) * t * there + t * t * back
        to_second = (1 - t) ** 2 * there - t * (1 - t) * back
        a = cv2.remap(first, grid + to_first, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        b = cv2.remap(second, grid + to_second, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        frame[:] = (1 - t) * a + t * b
    return out


def _opencv() -> Any:
    try:
        import cv2
    except ImportError as error:
        msg = "raise_with: optical_flow needs OpenCV, which is not installed; pip install 'flatlight[import]'"
        raise InputError(msg) from error
    return cv2
