"""The ``psf`` section: a stack computed by wave optics, or one that was measured with a real camera."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Any, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator

from simulator.config.base import Range, Section, refusal

_IN_FRONT = "depths are measured from the mask into the scene, so they are positive"
Depth = Annotated[float, Range(0.01, 1e7, "cm", infinite=True, below=_IN_FRONT)]
Depths = Annotated[tuple[Depth, ...], Field(min_length=1)]


class ComputedPsf(Section):
    """A stack computed from the mask: its depths as near, far and count, or as a list."""

    near_cm: Annotated[float, Range(0.01, 1e7, "cm", below=_IN_FRONT)] | None = Field(
        default=None, description="nearest plane, centimetres from the mask"
    )
    far_cm: Depth | None = Field(default=None, description="farthest plane, centimetres from the mask, or inf")
    depths: Annotated[int, Range(1, 1000, below="a stack has at least one plane")] | None = Field(
        default=None, description="number of planes"
    )
    spacing: Literal["disparity", "log", "linear"] = Field(
        default="disparity", description="planes at even steps of 1/z (disparity), log z or z"
    )
    depths_cm: Depths | None = Field(
        default=None, description="the planes themselves, in place of near, far and depths"
    )
    model: Literal["scaled_distance", "scaled_psf"] = Field(
        default="scaled_distance",
        description="how the PSF changes with depth: with diffraction, or by magnification alone",
    )
    wavelengths_per_channel: Annotated[int, Range(1, 100)] = Field(
        default=3, description="wavelengths that stand for a channel"
    )
    oversampling: Annotated[int, Range(1, 16)] = Field(default=1, description="samples per mask pixel and axis")
    accept_error: Annotated[float, Range(1e-6, 10)] | None = Field(
        default=None, description="sampling error up to which the stack is accepted (0.05 when left out)"
    )

    @model_validator(mode="after")
    def _sensible_depths(self) -> Self:
        if self.depths_cm is not None:
            for key, unset in (("near_cm", None), ("far_cm", None), ("depths", None), ("spacing", "disparity")):
                if getattr(self, key) != unset:
                    text = f"got {getattr(self, key)!r} beside depths_cm, which already lists the planes; keep one"
                    raise refusal(text, key)
            check_increasing(self.depths_cm)
            return self
        near, far = self.near_cm, self.far_cm
        if near is None or far is None or self.depths is None:
            text = "the planes are not given: needs near_cm, far_cm and depths, or depths_cm: [...]"
            raise refusal(text)
        if near > far or (near == far and self.depths > 1):
            text = f"got {near:g}, which is not nearer than far_cm = {far:g}; swap them?"
            raise refusal(text, "near_cm")
        if self.depths == 1 and near < far:
            text = "got 1 plane for a range; one plane is written depths_cm: [z] without near_cm, far_cm and depths"
            raise refusal(text, "depths")
        if math.isinf(far) and self.spacing != "disparity":
            text = f"got {self.spacing!r}, whose even steps never reach far_cm = inf; use disparity"
            raise refusal(text, "spacing")
        return self

    @property
    def nearest_cm(self) -> float:
        """The nearest plane, centimetres."""
        return self.depths_cm[0] if self.depths_cm is not None else self.near_cm  # pyright: ignore[reportReturnType]


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

    @model_validator(mode="after")
    def _one_depth_per_file(self) -> Self:
        one_array = len(self.measured) == 1 and self.measured[0].lower().endswith(".npy")
        if len(self.measured) != len(self.depths_cm) and not one_array:
            text = f"got {len(self.depths_cm)} depths for {len(self.measured)} files; each picture has one depth"
            raise refusal(text, "depths_cm")
        check_increasing(self.depths_cm)
        return self


def _kind(data: Any) -> str:
    measured = isinstance(data, MeasuredPsf) or (isinstance(data, dict) and data.get("measured") is not None)
    return "a measured PSF" if measured else "a computed PSF"


# The tags hold spaces, so that they cannot be mistaken for keys in a message's path.
PsfConfig = Annotated[
    Annotated[ComputedPsf, Tag("a computed PSF")] | Annotated[MeasuredPsf, Tag("a measured PSF")],
    Discriminator(_kind),
]


def check_increasing(depths_cm: Sequence[float]) -> None:
    """Raise pydantic's error at the first depth that is not beyond the one before it."""
    for index, (before, depth) in enumerate(pairwise(depths_cm), start=1):
        if not depth > before:
            text = f"got {depth:g} after {before:g}; depths must increase strictly, nearest first"
            raise refusal(text, "depths_cm", index)
