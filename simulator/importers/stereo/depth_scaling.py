"""From a stereo data set's disparity to metres before the mask: the three ways of bringing foreign depths into range.

Depth and disparity are reciprocal (z = f B / d), so an affine map of one is not an affine map of the other; which was
used is part of a sample's record.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError

AffineKind: TypeAlias = Literal["affine_depth", "affine_disparity"]


@dataclass(frozen=True)
class AffineDisparity:
    """1/z is affine in the disparity: ``lowest`` falls on the far depth and ``highest`` on the near one.

    Attributes:
        lowest: smallest disparity of the image or set, pixels.
        highest: largest disparity, pixels.
        near_m: nearest depth, metres.
        far_m: farthest depth, metres; may be ``inf``.
    """

    lowest: float
    highest: float
    near_m: float
    far_m: float

    def depth_m(self, disparity: NDArray[np.float64]) -> NDArray[np.float64]:
        """Depths in metres, within near..far; any shape of positive disparities."""
        share = (disparity - self.lowest) / (self.highest - self.lowest)
        with np.errstate(divide="ignore"):  # the lowest disparity lies at an infinite far depth
            depth = 1.0 / ((1.0 - share) / self.far_m + share / self.near_m)
        return np.clip(depth, self.near_m, self.far_m)

    def record(self) -> dict[str, Any]:
        """The map in numbers: 1/z = slope x disparity + offset."""
        slope = (1.0 / self.near_m - 1.0 / self.far_m) / (self.highest - self.lowest)
        return {
            "depth_scaling": "affine_disparity",
            "disparity_range_px": [self.lowest, self.highest],
            "inverse_depth_slope_per_m_px": slope,
            "inverse_depth_offset_per_m": 1.0 / self.far_m - slope * self.lowest,
        }


@dataclass(frozen=True)
class AffineDepth:
    """z is affine in 1/disparity, that is in the data set's own depth; attributes as for :class:`AffineDisparity`."""

    lowest: float
    highest: float
    near_m: float
    far_m: float

    def depth_m(self, disparity: NDArray[np.float64]) -> NDArray[np.float64]:
        """Depths in metres, within near..far; any shape of positive disparities."""
        share = (1.0 / disparity - 1.0 / self.highest) / (1.0 / self.lowest - 1.0 / self.highest)
        return np.clip(self.near_m + share * (self.far_m - self.near_m), self.near_m, self.far_m)

    def record(self) -> dict[str, Any]:
        """The map in numbers: z = slope / disparity + offset."""
        slope = (self.far_m - self.near_m) / (1.0 / self.lowest - 1.0 / self.highest)
        return {
            "depth_scaling": "affine_depth",
            "disparity_range_px": [self.lowest, self.highest],
            "depth_slope_m_px": slope,
            "depth_offset_m": self.near_m - slope / self.highest,
        }


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


DepthMap: TypeAlias = AffineDisparity | AffineDepth | FixedDepth


def affine_map(
    kind: AffineKind,
    lowest: float,
    highest: float,
    near_m: float,
    far_m: float,
    name: str,
) -> AffineDisparity | AffineDepth:
    """The affine map of one image or set.

    Args:
        kind: what is affine.
        lowest: smallest positive disparity, pixels.
        highest: largest disparity, pixels.
        near_m: nearest depth, metres.
        far_m: farthest depth, metres; ``inf`` only for ``affine_disparity``.
        name: the image or set, for the message.

    Raises:
        InputError: when the range is empty, so that no affine map exists.
    """
    if not highest > lowest:
        msg = (
            f"{name} has one single disparity ({lowest:g} px), which cannot be spread over {near_m:g}..{far_m:g} m: "
            "use depth_scaling: fixed, or per: set"
        )
        raise InputError(msg)
    return (AffineDisparity if kind == "affine_disparity" else AffineDepth)(lowest, highest, near_m, far_m)


def check_fixed_depths(depth_m: NDArray[np.float64], disparity: NDArray[np.float64], path: Path) -> None:
    """Refuse disparities so small or large that single precision cannot hold their depth.

    Args:
        depth_m: by :class:`FixedDepth`, metres, any shape.
        disparity: what they come from, pixels, same shape.
        path: the file, for the message.

    Raises:
        InputError: naming the file.
    """
    with np.errstate(over="ignore", under="ignore"):
        single = depth_m.astype(np.float32)
    bad = ~((single > 0) & np.isfinite(single))
    if bad.any():
        msg = (
            f"{path} has a disparity of {disparity[bad][0]:g} px, that is a depth of {depth_m[bad][0]:g} m, which cannot be "
            "used: fetch it again, or check metres_per_unit"
        )
        raise InputError(msg)
