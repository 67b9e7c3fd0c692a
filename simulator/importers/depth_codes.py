"""Depth charts as integers: how often each code occurs; and depths beyond the limit.

A clip that has no other depths is refused, one that mostly has such is warned of.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.importers.depth_coding import DepthAlong, RangeDepth
from simulator.importers.depth_files import one_channel
from simulator.io.images import read_image


def read_codes(path: Path) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Read a depth chart without loss; of a colour image all three channels must be the same, alpha is ignored.

    Returns:
        ``(H, W)``, uint8 or uint16.

    Raises:
        InputError: naming the file, when it is broken, is zero everywhere, or its channels differ.
    """
    codes = one_channel(read_image(path), path)
    if not codes.any():
        raise InputError(path, "it is zero everywhere, so it says nothing about depth: leave this frame out")
    return codes


MOSTLY = 0.5
"""Share of pixels beyond the limit from which the limit or the decoding is likely to be wrong."""

_WARNED: set[Path] = set()  # data sets that were warned of: once for each, not for every clip


def check_depths(
    root: Path, chart: Path, seen_m: NDArray[np.float64], beyond: NDArray[np.bool_], limit: str, cure: str
) -> None:
    """Refuse a clip without any valid depth, and warn, once for each data set, of one that mostly lies beyond the limit.

    Args:
        root: the data set.
        chart: the clip's first depth chart.
        seen_m: metres of the clip's pixels that are seen, any shape; infinite where there is no depth.
        beyond: where they lie beyond the limit.
        limit: the parameter that sets it, with its value.
        cure: which parameters to check.

    Raises:
        InputError: naming the chart, when there is no depth within the limit.
    """
    known_m = seen_m[np.isfinite(seen_m)]
    if known_m.size == 0:
        raise InputError(root / chart, f"no depth where its image is seen: {cure}, or leave it out")
    nowhere = int(beyond.sum()) == known_m.size
    if beyond.mean() <= MOSTLY and not nowhere:
        return
    depths = f"depths of {known_m.min() * 100:.4g} to {known_m.max() * 100:.4g} cm, with {limit}): {cure}"
    if nowhere:
        raise InputError(root / chart, f"the first of a clip in which no pixel is valid ({depths}")
    if root not in _WARNED:
        _WARNED.add(root)
        text = (
            f"{root / chart} is the first of a clip in which {beyond.mean():.0%} of the pixels are not valid ({depths}"
        )
        warnings.warn(f"{text}; others of this data set may be alike", stacklevel=4)


class DepthCounts:
    """Counts of all codes, by the bits of a code, exact for any number of charts.

    Attributes:
        all_beyond: the reason why a chart that lies beyond the limit everywhere cannot be used.
    """

    def __init__(self, decoding: RangeDepth | None, max_m: float, along: DepthAlong) -> None:
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
