"""How often each depth code occurs in a data set, and which depths that makes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simulator.importers.rgbd.depth_decoding import DepthAlong, DepthDecoding
from simulator.importers.rgbd.depth_limit import MOSTLY


class Depths:
    """Counts of all codes, by the bits of a code, exact for any number of charts.

    Attributes:
        all_beyond: the reason why a chart that lies beyond the limit everywhere cannot be used.
    """

    def __init__(self, decoding: DepthDecoding | None, max_m: float, along: DepthAlong) -> None:
        """Begin with no chart.

        Args:
            decoding: what codes mean; None counts codes alone.
            max_m: deepest valid depth, metres.
            along: whether charts hold depths or distances along rays, which may lie beyond the limit while depths do not.
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
