"""Depth charts as integers, and what their codes mean in metres."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.images import read_picture

DepthCode: TypeAlias = Literal["linear", "inverse"]
DepthAlong: TypeAlias = Literal["axis", "ray"]


def read_codes(path: Path) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Read a depth chart without loss; of a colour picture all three channels must be the same, alpha is ignored.

    Returns:
        ``(H, W)``, uint8 or uint16.

    Raises:
        InputError: naming the file, when it is broken, is zero everywhere, or its channels differ.
    """
    codes = read_picture(path)
    if codes.ndim == 3:
        if not np.array_equal(codes[..., 0], codes[..., 1]) or not np.array_equal(codes[..., 0], codes[..., 2]):
            msg = f"{path} has coloured pixels; expected a depth chart in grey, with red = green = blue"
            raise InputError(msg)
        codes = codes[..., 0]
    if not codes.any():
        msg = f"{path} is zero everywhere, so it says nothing about depth: leave this frame out"
        raise InputError(msg)
    return codes


@dataclass(frozen=True)
class DepthDecoding:
    """Depth is affine in the code, or one over depth is.

    ``linear``: z = z0 + c (z1 - z0); ``inverse``: 1/z = 1/z0 + c (1/z1 - 1/z0), with c = code / ``full_code``. A graphics
    card's reversed depth buffer is the latter, with z1 its near and z0 its far plane.

    Attributes:
        code: what is affine.
        full_m: z1, metres at the full code.
        zero_m: z0, metres at code zero; None is 0 for ``linear`` and infinity for ``inverse``, where zero means no depth.
        full_code: the full code; None is the largest number of the file's type, 255 or 65535.
    """

    code: DepthCode
    full_m: float
    zero_m: float | None
    full_code: int | None

    def depth_m(self, codes: NDArray[np.uint8] | NDArray[np.uint16]) -> NDArray[np.float64]:
        """Return metres, same shape; infinite where the chart gives no depth."""
        share = codes / np.float64(self.full_code or np.iinfo(codes.dtype).max)
        with np.errstate(divide="ignore"):
            if self.code == "linear":
                zero_m = self.zero_m or 0.0
                depth = zero_m + share * (self.full_m - zero_m)
            else:
                inverse_zero = 0.0 if self.zero_m is None else 1 / self.zero_m
                depth = 1 / (inverse_zero + share * (1 / self.full_m - inverse_zero))
        return np.where(depth > 0, depth, np.inf)

    def record(self) -> dict[str, Any]:
        """The decoding in numbers."""
        return {
            "depth_code": self.code,
            "depth_scale_cm": self.full_m * 100,
            "depth_at_zero_cm": None if self.zero_m is None else self.zero_m * 100,
            "depth_full_code": self.full_code,
        }
