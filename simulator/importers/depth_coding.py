"""What the numbers of a depth chart mean in metres: depths in a unit, disparities of a stereo camera, or codes of a range."""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from simulator.errors import InputError

DepthCode: TypeAlias = Literal["linear", "inverse"]
DepthAlong: TypeAlias = Literal["axis", "ray"]
Positive: TypeAlias = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite: TypeAlias = Annotated[float, Field(allow_inf_nan=False)]

_UNITS_M = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}


class _Coding(BaseModel, frozen=True):
    model_config = ConfigDict(strict=True, extra="forbid")

    @property
    def zero_is_a_depth(self) -> bool:
        """Whether the number 0 means a depth, unlike in most charts, where it means that there is none."""
        return False


class MetricDepth(_Coding, frozen=True):
    """Depths in a unit of length.

    Attributes:
        unit: of length.
        codes_per_unit: by how much the numbers were multiplied to keep fractions in whole numbers: TUM's are 5000 per m.
    """

    type: Literal["metric"] = "metric"
    unit: Literal["m", "cm", "mm"]
    codes_per_unit: Positive = 1.0

    def depth_m(self, values: NDArray[Any]) -> NDArray[np.float64]:
        """Return metres, same shape; infinite where the number is no depth."""
        return _known(values.astype(np.float64) * (_UNITS_M[self.unit] / self.codes_per_unit))

    def record(self) -> dict[str, Any]:
        """The coding in plain data."""
        return {"depth": self.model_dump(mode="json")}


class DisparityDepth(_Coding, frozen=True):
    """Disparities of a rectified stereo camera: z = f B / (d + doffs).

    Attributes:
        focal_px: focal length in pixels; null takes fx of the intrinsics.
        baseline_mm: distance of the two cameras; null takes that of Middlebury's calib.txt.
        doffs_px: column of the right camera's principal point minus that of the left; null takes calib.txt's, else 0.
        codes_per_px: by how much the numbers were multiplied to keep fractions in whole numbers: KITTI's are 256 per pixel.
    """

    type: Literal["disparity"] = "disparity"
    focal_px: Positive | None = None
    baseline_mm: Positive | None = None
    doffs_px: Finite | None = None
    codes_per_px: Positive = 1.0

    @property
    def zero_is_a_depth(self) -> bool:
        """Whether a disparity of 0 is nearer than infinity."""
        return bool(self.doffs_px)

    def completed(self, focal_px: float | None, baseline_mm: float | None, doffs_px: float) -> DisparityDepth:
        """Return the same with a camera's numbers where none are given.

        Raises:
            InputError: focal length or baseline are in neither.
        """
        focal, baseline = self.focal_px or focal_px, self.baseline_mm or baseline_mm
        for name, value in (("focal_px", focal), ("baseline_mm", baseline)):
            if value is None:
                raise InputError(
                    f"depth.{name}", "missing: neither given nor in a file of intrinsics such as calib.txt"
                )
        doffs = doffs_px if self.doffs_px is None else self.doffs_px
        return self.model_copy(update={"focal_px": focal, "baseline_mm": baseline, "doffs_px": doffs})

    def depth_m(self, values: NDArray[Any]) -> NDArray[np.float64]:
        """Return metres, same shape; infinite where the disparity belongs to no point before the camera.

        What :meth:`completed` fills in must be there.
        """
        assert self.focal_px is not None
        assert self.baseline_mm is not None
        shift_px = values.astype(np.float64) / self.codes_per_px + (self.doffs_px or 0.0)
        with np.errstate(divide="ignore"):
            return _known(self.focal_px * self.baseline_mm * 1e-3 / shift_px)

    def record(self) -> dict[str, Any]:
        """The coding in plain data."""
        return {"depth": self.model_dump(mode="json")}


class RangeDepth(_Coding, frozen=True):
    """Codes of a range: depth is affine in the code, or one over depth is.

    ``linear``: z = z0 + c (z1 - z0); ``inverse``: 1/z = 1/z0 + c (1/z1 - 1/z0), with c = code / ``full_code``. A graphics
    card's reversed depth buffer is the latter, with z1 its near and z0 its far plane.

    Attributes:
        type: what is affine.
        full_cm: z1, depth at the full code.
        zero_cm: z0, depth at code zero; None is 0 for ``linear`` and infinity for ``inverse``, where zero means no depth.
        full_code: the full code; None is the largest number of the file's type, 255 or 65535, and 1 of floating point.
    """

    type: DepthCode
    full_cm: Positive
    zero_cm: Positive | None = None
    full_code: Positive | None = None

    @property
    def zero_is_a_depth(self) -> bool:
        """Whether code zero has a depth."""
        return self.zero_cm is not None

    def depth_m(self, values: NDArray[Any]) -> NDArray[np.float64]:
        """Return metres, same shape; infinite where the code is no depth.

        Raises:
            InputError: the file's type has no full code, and none is given.
        """
        if self.full_code is None and values.dtype.kind != "f" and values.dtype not in (np.uint8, np.uint16):
            raise InputError(
                "depth.full_code", f"missing: the charts hold {values.dtype}, whose largest number says nothing"
            )
        full_code = self.full_code or (1 if values.dtype.kind == "f" else np.iinfo(values.dtype).max)
        share = values.astype(np.float64) / full_code
        full_m, zero_m = self.full_cm * 1e-2, None if self.zero_cm is None else self.zero_cm * 1e-2
        if self.type == "linear":
            return _known((zero_m or 0.0) + share * (full_m - (zero_m or 0.0)))
        inverse_zero = 0.0 if zero_m is None else 1 / zero_m
        with np.errstate(divide="ignore"):
            return _known(1 / (inverse_zero + share * (1 / full_m - inverse_zero)))

    def record(self) -> dict[str, Any]:
        """The coding in plain data."""
        return {
            "depth_code": self.type,
            "depth_scale_cm": self.full_cm,
            "depth_at_zero_cm": self.zero_cm,
            "depth_full_code": self.full_code,
        }


DepthCoding = Annotated[MetricDepth | DisparityDepth | RangeDepth, Field(discriminator="type")]


def _known(depth_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return depths with infinity for all that lies not before the camera."""
    with np.errstate(invalid="ignore"):  # NaN is no depth
        return np.where(depth_m > 0, depth_m, np.inf)
