"""Depth charts as integers: what their codes mean in metres, how often each occurs, and depths beyond the limit.

A clip that has no other depths is refused, one that mostly has such is warned of.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.images import read_image

DepthCode: TypeAlias = Literal["linear", "inverse"]
DepthAlong: TypeAlias = Literal["axis", "ray"]


def read_codes(path: Path) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Read a depth chart without loss; of a colour image all three channels must be the same, alpha is ignored.

    Returns:
        ``(H, W)``, uint8 or uint16.

    Raises:
        InputError: naming the file, when it is broken, is zero everywhere, or its channels differ.
    """
    codes = read_image(path)
    if codes.ndim == 3:
        if not np.array_equal(codes[..., 0], codes[..., 1]) or not np.array_equal(codes[..., 0], codes[..., 2]):
            raise InputError(path, "it has coloured pixels; expected a depth chart in grey, with red = green = blue")
        codes = codes[..., 0]
    if not codes.any():
        raise InputError(path, "it is zero everywhere, so it says nothing about depth: leave this frame out")
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

    @classmethod
    def of_cm(cls, code: DepthCode, full_cm: float, zero_cm: float | None, full_code: int | None) -> DepthDecoding:
        """Return the decoding of a configuration's centimetres."""
        return cls(code, full_cm * 1e-2, None if zero_cm is None else zero_cm * 1e-2, full_code)

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


MOSTLY = 0.5
"""Share of pixels beyond the limit from which the limit or the decoding is likely to be wrong."""

_WARNED: set[Path] = set()  # data sets that were warned of: once for each, not for every clip


def check_depths(root: Path, chart: Path, seen_m: NDArray[np.float64], decoding: DepthDecoding, max_m: float) -> None:
    """Refuse a clip without any valid depth, and warn, once for each data set, of one that mostly lies beyond the limit.

    ``seen_m``: metres of the clip's pixels that are seen, any shape; infinite where there is no depth.

    Raises:
        InputError: naming the chart, when no depth is at most ``max_m``.
    """
    known_m = seen_m[np.isfinite(seen_m)]
    if known_m.size == 0:
        raise InputError(root / chart, "no depth where its image is seen: check border and field, or leave it out")
    beyond = float((known_m > max_m).sum() / seen_m.size)
    if beyond <= MOSTLY and known_m.min() <= max_m:
        return
    depths = f"depths of {known_m.min() * 100:.4g} to {known_m.max() * 100:.4g} cm, with max_cm {max_m * 100:g}"
    cure = f"check depth_scale_cm ({decoding.full_m * 100:g}) and depth_code ({decoding.code}), or raise max_cm"
    if known_m.min() > max_m:
        raise InputError(root / chart, f"the first of a clip in which no pixel is valid ({depths}): {cure}")
    if root not in _WARNED:
        _WARNED.add(root)
        text = f"{root / chart} is the first of a clip in which {beyond:.0%} of the pixels are not valid ({depths})"
        warnings.warn(f"{text}; others of this data set may be alike: {cure}", stacklevel=3)


class DepthCounts:
    """Counts of all codes, by the bits of a code, exact for any number of charts.

    Attributes:
        all_beyond: the reason why a chart that lies beyond the limit everywhere cannot be used.
    """

    def __init__(self, decoding: DepthDecoding | None, max_m: float, along: DepthAlong) -> None:
        """Begin with no chart.

        ``along``: whether charts hold depths or distances along rays, which may lie beyond the limit while depths do not.
        """
        self._decoding, self._max_m, self._along = decoding, max_m, along
        self._counts: dict[np.dtype[np.unsignedinteger], NDArray[np.int64]] = {}
        self.all_beyond = (
            f"has no depth of at most max_cm ({max_m * 100:g}): check depth_scale_cm and depth_code, or raise max_cm"
        )

    def add(self, codes: NDArray[np.uint8] | NDArray[np.uint16]) -> bool:
        """Count a chart's codes; return whether any of them is a valid depth, as far as is known."""
        counts = np.bincount(codes.ravel(), minlength=np.iinfo(codes.dtype).max + 1)
        self._counts[codes.dtype] = self._counts.get(codes.dtype, 0) + counts
        metres = self._metres(codes.dtype)
        return metres is None or self._along == "ray" or bool(np.any(metres[counts > 0] <= self._max_m))

    def facts(self) -> dict[str, str]:
        """Return ranges of codes and, where their meaning is known, of depths."""
        used = {dtype: np.flatnonzero(counts) for dtype, counts in self._counts.items()}
        texts = (f"{8 * dtype.itemsize} bit, {found[0]} to {found[-1]}" for dtype, found in used.items())
        facts = {"depth codes": ", ".join(texts)}
        holes = sum(int(counts[0]) for counts in self._counts.values())
        if holes:
            facts["code zero"] = f"{holes} pixels"
        metres, counts = self._depths()
        if metres.size:
            facts["depths"] = (
                f"{metres.min() * 100:.4g} to {metres.max() * 100:.4g} cm, {self._beyond(metres, counts):.1%} of pixels "
                f"beyond max_cm ({self._max_m * 100:g}){', along each ray' if self._along == 'ray' else ''}"
            )
        return facts

    def notes(self) -> list[str]:
        """Return a note when most depths lie beyond the limit."""
        metres, counts = self._depths()
        if not metres.size or self._beyond(metres, counts) <= MOSTLY:
            return []
        return ["more than half of all depths lie beyond max_cm: check depth_scale_cm and depth_code, or raise max_cm"]

    def _metres(self, dtype: np.dtype[np.unsignedinteger]) -> NDArray[np.float64] | None:
        """The depth of each code."""
        return (
            None if self._decoding is None else self._decoding.depth_m(np.arange(np.iinfo(dtype).max + 1, dtype=dtype))
        )

    def _depths(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """All finite depths that occur, and how often."""
        metres, counts = [np.empty(0)], [np.empty(0, np.int64)]
        for dtype, number in self._counts.items():
            of_codes = self._metres(dtype)
            if of_codes is not None:
                used = (number > 0) & np.isfinite(of_codes)
                metres.append(of_codes[used])
                counts.append(number[used])
        return np.concatenate(metres), np.concatenate(counts)

    def _beyond(self, metres: NDArray[np.float64], counts: NDArray[np.int64]) -> float:
        return float(counts[metres > self._max_m].sum() / counts.sum())
