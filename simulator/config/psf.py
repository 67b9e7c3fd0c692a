"""Depth planes in a configuration: a range and a count, or a list; shared by computed and interpolated stacks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Any, Literal, Self

from pydantic import Discriminator, Field, Tag, model_validator

from simulator.config.camera import IlluminantConfig
from simulator.io.measurements import Cfa
from simulator.io.tables import NM
from simulator.optics.spectra import Led
from simulator.optics.stack import depth_planes
from simulator.settings import Range
from simulator.validation import PathText, Section, refusal

_IN_FRONT = "depths are measured from the mask into the scene, so they are positive"
Depth = Annotated[float, Range(0.01, 1e7, "cm", infinite=True, below=_IN_FRONT)]
Depths = Annotated[tuple[Depth, ...], Field(min_length=1)]


class Planes(Section):
    """Depth planes as near, far and count, or as a list."""

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

    @property
    def depths_m(self) -> tuple[float, ...]:
        """The planes, metres from the mask, nearest first; the last may be ``inf``."""
        if self.depths_cm is not None:
            return tuple(depth * 1e-2 for depth in self.depths_cm)
        assert self.near_cm is not None
        assert self.far_cm is not None
        assert self.depths is not None
        if self.depths == 1:
            return (self.near_cm * 1e-2,)
        planes = depth_planes(self.near_cm * 1e-2, self.far_cm * 1e-2, self.depths, self.spacing)
        return tuple(float(depth) for depth in planes)


class InterpolatedPlanes(Planes):
    """Planes that a measured stack is interpolated to, by magnification and disparity."""

    extrapolate: bool = Field(
        default=False, description="whether planes outside the measured range are allowed: the outermost one, rescaled"
    )
    registration: bool = Field(
        default=True,
        description="whether the lateral shifts between measured planes (the source was moved by hand) are found and removed",
    )
    equal_exposure: bool = Field(
        default=True, description="whether differences in exposure between measured planes are found and removed"
    )
    accept_error: Annotated[float, Range(1e-6, 100)] = Field(
        default=1.0, description="greatest stated error (relative L2) of a plane; a stack with a worse one is refused"
    )


def check_increasing(depths_cm: Sequence[float]) -> None:
    """Raise pydantic's error at the first depth that is not beyond the one before it."""
    for index, (before, depth) in enumerate(pairwise(depths_cm), start=1):
        if not depth > before:
            text = f"got {depth:g} after {before:g}; depths must increase strictly, nearest first"
            raise refusal(text, "depths_cm", index)


Tilt = Annotated[float, Range(-10, 10, "deg (degrees)")]
Percent = Annotated[float, Range(0, 50, "percent of full scale")]
_LEDS_NM = ((630, 18), (530, 33), (465, 22))  # centre and full width at half maximum


class AsCaptured(Section):
    """What differs between the true PSFs and those that a laboratory measures. The defaults are a careful one's."""

    source_um: Annotated[float, Range(0, 5000, "um")] = Field(
        default=25.0, description="diameter of the point source (a pinhole before a light), micrometres"
    )
    illuminant: IlluminantConfig = Field(
        default_factory=lambda: tuple(Led(centre * NM, fwhm * NM) for centre, fwhm in _LEDS_NM),
        json_schema_extra={"default": [{"led_nm": centre, "fwhm_nm": fwhm} for centre, fwhm in _LEDS_NM]},
        description="light of the source, as in camera.illuminant, or the word camera for the same as there",
    )
    depth_offset_mm: Annotated[float, Range(-1e3, 1e3, "mm")] = Field(
        default=0.2, description="how much farther than stated every source is (the zero of the scale), millimetres"
    )
    depth_std_mm: Annotated[float, Range(0, 1e3, "mm")] = Field(
        default=0.05, description="standard deviation of every depth on top of that, millimetres"
    )
    shift_std_um: Annotated[float, Range(0, 1e5, "um")] = Field(
        default=20.0, description="standard deviation of the source's place across the axis, x and y, micrometres"
    )
    tilt_deg: tuple[Tilt, Tilt] = Field(
        default=(0.1, -0.05),
        description="angles of the depth stage to the axis, x and y, degrees: aligned at the nearest plane, off beyond",
    )
    pedestal_percent: Percent = Field(default=0.5, description="stray light, everywhere alike, percent of full scale")
    glow_percent: Percent = Field(
        default=0.3, description="glow of the sensor's left edge, where it is brightest, percent of full scale"
    )
    background: Literal["dark", "border", "none"] = Field(
        default="dark",
        description="what is subtracted: images with the source covered, the median of the image's border, nothing",
    )
    noise: Literal["physical", "none"] = Field(default="physical", description="noise of the sensor, or none")
    peak_percent: Annotated[float, Range(0.1, 100, "percent of full scale")] = Field(
        default=70.0, description="where each depth's exposure puts the brightest pixel, percent of full scale"
    )
    frames: Annotated[int, Range(1, 10000)] = Field(default=10, description="images that are averaged")


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
    shared_wavelengths: Annotated[int, Range(1, 100)] | None = Field(
        default=None,
        description="wavelengths that all channels share, each with its own weights, in place of wavelengths_per_channel: "
        "5 of them err less than 3 for each of three channels, at 5/9 of the cost",
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
    """A stack of measured images of a point source: a file per depth, or one .npy file with all of them."""

    measured: Annotated[tuple[PathText, ...], Field(min_length=1)] = Field(
        description="image files (TIFF, PNG, EXR, npy, raw), nearest depth first; relative to the YAML file"
    )
    depths_cm: Depths = Field(description="distance of the point source from the mask for each file, centimetres")
    frame: Literal["physical", "stored"] = Field(
        description="orientation of the files: physical as the sensor saw it, stored if rotated by 180 degrees"
    )
    cfa: Cfa | None = Field(
        default=None,
        description="of files that are a colour sensor's mosaic: colours of the upper left 2 x 2 pixels, which become one; "
        "none insists on grey",
    )
    crop: Annotated[str, Field(min_length=1)] | None = Field(
        default=None,
        description="the part that is taken, ROWSxCOLUMNS about the centre or ROWSxCOLUMNS+TOP+LEFT: after cfa, before "
        "binning",
    )
    binning: Annotated[int, Range(1, 64)] = Field(default=1, description="pixels per side that become one")
    background: Literal["border", "none"] | Annotated[float, Range(0, 1e9)] | str = Field(
        default="border",
        description="what is taken off first: the median of the border, nothing, a number, or a dark image's file",
    )
    throughput_mm2: Annotated[float, Range(1e-9, 1e4, "mm2")] = Field(
        description="light that reaches the sensor: the mask's transmittance times its open area, square millimetres"
    )
    planes: InterpolatedPlanes | None = Field(default=None, description=_PLANES)

    @model_validator(mode="after")
    def _one_depth_per_file(self) -> Self:
        one_array = len(self.measured) == 1 and self.measured[0].lower().endswith(".npy")
        if len(self.measured) != len(self.depths_cm) and not one_array:
            text = f"got {len(self.depths_cm)} depths for {len(self.measured)} files; each image has one depth"
            raise refusal(text, "depths_cm")
        check_increasing(self.depths_cm)
        return self


class StoredPsf(Section):
    """A stack in a folder that ``flatlight psf --output`` or a data set wrote; the folder says all about it."""

    measured: PathText = Field(description="the folder (of a stack, or of a data set); relative to the YAML file")
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
