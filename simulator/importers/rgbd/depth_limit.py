"""Depths beyond the limit: a clip that has no others is refused, one that mostly has such is warned of."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.importers.rgbd.depth_decoding import DepthDecoding

MOSTLY = 0.5
"""Share of pixels beyond the limit from which the limit or the decoding is likely to be wrong."""

_WARNED: set[Path] = set()  # data sets that were warned of: once for each, not for every clip


def check_depths(root: Path, chart: Path, seen_m: NDArray[np.float64], decoding: DepthDecoding, max_m: float) -> None:
    """Refuse a clip without any valid depth, and warn, once for each data set, of one that mostly lies beyond the limit.

    Args:
        root: the data set's folder.
        chart: the clip's first chart, relative to ``root``.
        seen_m: metres of the clip's pixels that are seen, any shape; infinite where there is no depth.
        decoding: what its codes mean, for the message.
        max_m: deepest valid depth, metres.

    Raises:
        InputError: naming the chart, when no depth is at most ``max_m``.
    """
    known_m = seen_m[np.isfinite(seen_m)]
    if known_m.size == 0:
        msg = f"{root / chart} gives no depth where its picture is seen: check border and field, or leave this clip out"
        raise InputError(msg)
    beyond = float((known_m > max_m).sum() / seen_m.size)
    if beyond <= MOSTLY and known_m.min() <= max_m:
        return
    depths = f"depths of {known_m.min() * 100:.4g} to {known_m.max() * 100:.4g} cm, with max_cm {max_m * 100:g}"
    cure = f"check depth_scale_cm ({decoding.full_m * 100:g}) and depth_code ({decoding.code}), or raise max_cm"
    if known_m.min() > max_m:
        msg = f"{root / chart} is the first of a clip in which no pixel is valid ({depths}): {cure}"
        raise InputError(msg)
    if root not in _WARNED:
        _WARNED.add(root)
        text = f"{root / chart} is the first of a clip in which {beyond:.0%} of the pixels are not valid ({depths})"
        warnings.warn(f"{text}; others of this data set may be alike: {cure}", stacklevel=3)
