"""``psf.as_captured``: the calibration of a real camera, in which PSFs are measured with errors."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from simulator.config.base import Range, Section
from simulator.config.light import IlluminantConfig, Led

Tilt = Annotated[float, Range(-10, 10, "deg (degrees)")]
Percent = Annotated[float, Range(0, 50, "percent of full scale")]


class AsCaptured(Section):
    """What differs between the true PSFs and those that a laboratory measures. The defaults are a careful one's."""

    source_um: Annotated[float, Range(0, 5000, "um")] = Field(
        default=25.0, description="diameter of the point source (a pinhole before a light), micrometres"
    )
    illuminant: IlluminantConfig = Field(
        default=(Led(led_nm=630, fwhm_nm=18), Led(led_nm=530, fwhm_nm=33), Led(led_nm=465, fwhm_nm=22)),
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
        description="what is subtracted: pictures with the source covered, the median of the picture's border, nothing",
    )
    noise: Literal["physical", "none"] = Field(default="physical", description="noise of the sensor, or none")
    peak_percent: Annotated[float, Range(0.1, 100, "percent of full scale")] = Field(
        default=70.0, description="where each depth's exposure puts the brightest pixel, percent of full scale"
    )
    frames: Annotated[int, Range(1, 10000)] = Field(default=10, description="pictures that are averaged")
