"""Disparity maps of stereo data sets: the PFM files that hold them, and the three ways from disparity to depth.

Depth and disparity are reciprocal (z = f B / d), so an affine map of one is not an affine map of the other; which was used is
part of a sample's record.

Source: Paul Debevec's PFM description: ``Pf`` (one channel) or ``PF`` (three), width and height, scale (negative means little
endian), then float32 rows from the bottom up.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.files import read_errors

MAX_PIXELS = 200_000_000
"""Largest map that is read; the header is judged before anything is allocated."""

_HEADER = re.compile(rb"(P[fF])\s+(\S+)\s+(\S+)\s+(\S+)\s")
_HEADER_BYTES = 256

AffineKind: TypeAlias = Literal["affine_depth", "affine_disparity"]


def read_pfm(path: Path) -> NDArray[np.float32]:
    """Read one PFM file.

    The scale's sign gives the byte order; its magnitude, a display hint, is not applied.

    Returns:
        float32 ``(H, W)`` for ``Pf`` or ``(H, W, 3)`` for ``PF``, row 0 at the top; inf and NaN, which stand for unknown in
        Middlebury's files, as they are.

    Raises:
        InputError: naming the file, when it is missing, not a PFM file, has a bad header or the wrong length.
    """
    with read_errors(path), path.open("rb") as file:
        (height, width, channels, order), start = _parse_header(file.read(_HEADER_BYTES), path)
        size, expected = path.stat().st_size - start, 4 * height * width * channels
        if size != expected:
            raise InputError(
                path,
                f"got {size} bytes of data for {height} x {width} x {channels}, expected {expected}",
            )
        file.seek(start)
        data = file.read(expected)
    values = np.frombuffer(data, dtype=f"{order}f4").astype(np.float32).reshape(height, width, channels)
    upright = np.ascontiguousarray(values[::-1])
    return upright[..., 0] if channels == 1 else upright


def _parse_header(head: bytes, path: Path) -> tuple[tuple[int, int, int, str], int]:
    """``(height, width, channels, byte order)`` and the offset of the data."""
    match = _HEADER.match(head)
    if match is None:
        raise InputError(path, f"not a PFM file: got {head[:24]!r}, expected 'Pf' or 'PF', width, height and scale")
    magic, *numbers = (part.decode("ascii", "replace") for part in match.groups())
    try:
        width, height, scale = int(numbers[0]), int(numbers[1]), float(numbers[2])
    except ValueError:
        raise InputError(path, f"bad PFM header {' '.join(numbers)!r}: expected width, height and scale") from None
    if width <= 0 or height <= 0 or width * height > MAX_PIXELS:
        raise InputError(path, f"claims {height} x {width} pixels; expected 1 to {MAX_PIXELS}")
    if scale == 0 or not math.isfinite(scale):
        raise InputError(path, f"got a PFM scale of {numbers[2]}; expected a finite number, not 0")
    return (height, width, 3 if magic == "PF" else 1, "<" if scale < 0 else ">"), match.end()


def read_disparity(path: Path) -> NDArray[np.float32]:
    """Read disparity without its sign; releases of the data sets differ in the sign, but never within a file.

    Returns:
        Pixels, ``(H, W)``, row 0 at the top; zero where no surface is seen.

    Raises:
        InputError: naming the file, when it is broken, has three channels, non-finite values, which these data sets do not
            have, or mixes both signs.
    """
    disparity = read_pfm(path)
    if disparity.ndim != 2:
        raise InputError(path, "has three channels ('PF'); expected a disparity map with one ('Pf')")
    if bad := int(np.count_nonzero(~np.isfinite(disparity))):
        raise InputError(path, f"holds {bad} non-finite values: leave this frame out, or read it by source: rgb_depth")
    if disparity.min() < 0 < disparity.max():
        raise InputError(path, f"mixes both signs ({disparity.min():g}..{disparity.max():g} px): expected one")
    return np.abs(disparity)


def disparity_range(disparity: NDArray[np.float32], path: Path) -> tuple[float, float]:
    """Return the smallest and largest disparity that is not zero (zero means infinitely far: no surface).

    Raises:
        InputError: naming the file, when it is zero everywhere.
    """
    seen = disparity[disparity > 0]
    if seen.size == 0:
        raise InputError(path, "it is zero everywhere, so it says nothing about depth: leave this frame out")
    return float(seen.min()), float(seen.max())


@dataclass(frozen=True)
class AffineMap:
    """Depth or one over depth is affine: ``lowest`` falls on the far depth and ``highest`` on the near one.

    Attributes:
        kind: ``affine_disparity``: 1/z is affine in the disparity; ``affine_depth``: z is affine in 1/disparity, that is in
            the data set's own depth.
        lowest: smallest disparity of the image or set, pixels.
        highest: largest disparity, pixels.
        near_m: nearest depth, metres.
        far_m: farthest depth, metres; may be ``inf`` for ``affine_disparity``.
    """

    kind: AffineKind
    lowest: float
    highest: float
    near_m: float
    far_m: float

    def depth_m(self, disparity: NDArray[np.float64]) -> NDArray[np.float64]:
        """Depths in metres, within near..far; any shape of positive disparities."""
        if self.kind == "affine_disparity":
            share = (disparity - self.lowest) / (self.highest - self.lowest)
            with np.errstate(divide="ignore"):  # the lowest disparity lies at an infinite far depth
                depth = 1.0 / ((1.0 - share) / self.far_m + share / self.near_m)
        else:
            share = (1.0 / disparity - 1.0 / self.highest) / (1.0 / self.lowest - 1.0 / self.highest)
            depth = self.near_m + share * (self.far_m - self.near_m)
        return np.clip(depth, self.near_m, self.far_m)

    def record(self) -> dict[str, Any]:
        """The map in numbers: 1/z = slope x disparity + offset, or z = slope / disparity + offset."""
        found = {"depth_scaling": self.kind, "disparity_range_px": [self.lowest, self.highest]}
        if self.kind == "affine_disparity":
            slope = (1.0 / self.near_m - 1.0 / self.far_m) / (self.highest - self.lowest)
            offset = 1.0 / self.far_m - slope * self.lowest
            return found | {"inverse_depth_slope_per_m_px": slope, "inverse_depth_offset_per_m": offset}
        slope = (self.far_m - self.near_m) / (1.0 / self.lowest - 1.0 / self.highest)
        return found | {"depth_slope_m_px": slope, "depth_offset_m": self.near_m - slope / self.highest}

    @classmethod
    def over(
        cls, kind: AffineKind, ranges: list[tuple[float, float]], near_m: float, far_m: float, name: str
    ) -> AffineMap:
        """Return the map of one image, clip or set from the disparity ranges of its images.

        Raises:
            InputError: naming it, when the range is empty, so that no affine map exists.
        """
        lowest, highest = min(low for low, _ in ranges), max(high for _, high in ranges)
        if not highest > lowest:
            raise InputError(
                name,
                f"has one single disparity ({lowest:g} px): use depth_scaling: fixed, or per: set",
            )
        return cls(kind, lowest, highest, near_m, far_m)


@dataclass(frozen=True)
class FixedDepth:
    """z = f B / disparity x metres per unit: the data set's own geometry; nothing is clamped here.

    Attributes:
        focal_px: focal length, pixels.
        baseline_units: distance of the two cameras in the data set's units.
        metres_per_unit: metres that stand for one unit.
    """

    focal_px: float
    baseline_units: float
    metres_per_unit: float

    def depth_m(self, disparity: NDArray[np.float64]) -> NDArray[np.float64]:
        """Depths in metres; any shape of positive disparities."""
        return self.focal_px * self.baseline_units * self.metres_per_unit / disparity

    def record(self) -> dict[str, Any]:
        """The map in numbers."""
        return {
            "depth_scaling": "fixed",
            "focal_px": self.focal_px,
            "baseline_units": self.baseline_units,
            "metres_per_unit": self.metres_per_unit,
        }


DepthMap: TypeAlias = AffineMap | FixedDepth


def check_fixed_depths(depth_m: NDArray[np.float64], disparity: NDArray[np.float64], path: Path) -> None:
    """Refuse disparities (pixels) so small or large that single precision cannot hold their depth by :class:`FixedDepth`.

    Raises:
        InputError: naming the file.
    """
    with np.errstate(over="ignore", under="ignore"):
        single = depth_m.astype(np.float32)
    bad = ~((single > 0) & np.isfinite(single))
    if bad.any():
        raise InputError(
            path,
            f"got a disparity of {disparity[bad][0]:g} px, a depth of {depth_m[bad][0]:g} m: check metres_per_unit",
        )
