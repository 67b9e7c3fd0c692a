"""The ``psf`` section: a stack computed by wave optics, measured with a real camera, or read from a folder."""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator

from simulator.config.base import Range, Section, refusal
from simulator.config.captured import AsCaptured
from simulator.config.planes import Depths, InterpolatedPlanes, Planes, check_increasing

_PLANES = "other planes than the measured ones, interpolated between them"


class ComputedPsf(Planes):
    """A stack computed from the mask: its depths as near, far and count, or as a list."""

    model: Literal["scaled_distance", "scaled_psf", "exact"] = Field(
        default="scaled_distance",
        description="how the PSF changes with depth: with diffraction, by magnification, or by spherical waves",
    )
    wavelengths_per_channel: Annotated[int, Range(1, 100)] = Field(
        default=3, description="wavelengths that stand for a channel"
    )
    oversampling: Annotated[int, Range(1, 16)] = Field(default=1, description="samples per mask pixel and axis")
    accept_error: Annotated[float, Range(1e-6, 10)] | None = Field(
        default=None, description="sampling error up to which the stack is accepted (0.05 when left out)"
    )
    check: Literal["quick", "full"] = Field(
        default="quick",
        description="errors that are measured: on crops, in seconds, or against direct sums and exact PSFs, in minutes",
    )
    as_captured: AsCaptured | None = Field(
        default=None, description="errors of a calibration: such a stack lies beside the true one, in psf_captured/"
    )


class MeasuredPsf(Section):
    """A stack of measured pictures of a point source: a file per depth, or one .npy file with all of them."""

    measured: Annotated[tuple[str, ...], Field(min_length=1)] = Field(
        description="picture files (TIFF, EXR, npy), nearest depth first; relative to the YAML file"
    )
    depths_cm: Depths = Field(description="distance of the point source from the mask for each file, centimetres")
    frame: Literal["physical", "stored"] = Field(
        description="orientation of the files: physical as the sensor saw it, stored if rotated by 180 degrees"
    )
    binning: Annotated[int, Range(1, 64)] = Field(default=1, description="pixels per side that become one")
    background: Literal["border", "none"] | Annotated[float, Range(0, 1e9)] | str = Field(
        default="border",
        description="what is taken off first: the median of the border, nothing, a number, or a dark picture's file",
    )
    throughput_mm2: Annotated[float, Range(1e-9, 1e4, "mm2")] = Field(
        description="light that reaches the sensor: the mask's transmittance times its open area, square millimetres"
    )
    planes: InterpolatedPlanes | None = Field(default=None, description=_PLANES)

    @model_validator(mode="after")
    def _one_depth_per_file(self) -> Self:
        one_array = len(self.measured) == 1 and self.measured[0].lower().endswith(".npy")
        if len(self.measured) != len(self.depths_cm) and not one_array:
            text = f"got {len(self.depths_cm)} depths for {len(self.measured)} files; each picture has one depth"
            raise refusal(text, "depths_cm")
        check_increasing(self.depths_cm)
        return self


class StoredPsf(Section):
    """A stack in a folder that ``flatlight psf --output`` or a data set wrote; the folder says all about it."""

    measured: str = Field(description="the folder (of a stack, or of a data set); relative to the YAML file")
    planes: InterpolatedPlanes | None = Field(default=None, description=_PLANES)


def _kind(data: Any) -> str:
    measured = data.get("measured") if isinstance(data, dict) else getattr(data, "measured", None)
    if measured is None:
        return "a computed PSF"
    return "a stored PSF" if isinstance(measured, str) else "a measured PSF"


# The tags hold spaces, so that they cannot be mistaken for keys in a message's path.
PsfConfig = Annotated[
    Annotated[ComputedPsf, Tag("a computed PSF")]
    | Annotated[MeasuredPsf, Tag("a measured PSF")]
    | Annotated[StoredPsf, Tag("a stored PSF")],
    Discriminator(_kind),
]
