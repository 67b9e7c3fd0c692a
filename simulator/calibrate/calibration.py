"""A calibration from its folder to its stack: planes on one axis, of one exposure, each with what speaks against it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from simulator.calibrate.geometry import Distance, Geometry, find_geometry
from simulator.calibrate.pictures import Picture, find_groups, left_out, read_picture
from simulator.errors import InputError
from simulator.io.files import sha256_file
from simulator.io.json import parse_json
from simulator.io.measurements import GREY, RGB, Cfa
from simulator.optics.measured import centre_of_mass, check_settings, cut_edges, rotated, shown_edges
from simulator.optics.registration import FOUND, Registration, relative_exposures
from simulator.optics.resample import magnified
from simulator.optics.stack import PsfStack, check_depths
from simulator.text import length, share

_FORMAT = "flatlight calibration"
DARK_PEAK = 0.1
"""Share of full scale below which a plane's brightest pixel is too dark: rounding and read noise show."""
FEW_NOISE = 20.0
"""Brightest pixel over noise below which a plane is too noisy: that is 26 dB."""
OTHER_LIGHT = 0.15
"""Share by which a plane may be brighter than distance and exposure say before it is noted."""
_OTHER_BITS = 0.25
"""Share of what the files' type holds below which all numbers may as well be those of a sensor with fewer bits."""
_NOISY = 0.01
"""Share of a plane that is noise below zero from which on it is worth a word."""
_FINE_PX, _WIDE_PX = 2.0, 8.0
_SEEN = 3.0  # light is seen where its mean over a few pixels exceeds so many of its errors


@dataclass(frozen=True)
class Plane:
    """What is known of one distance.

    Attributes:
        depth_m: from the mask as stated, the offset included.
        exposure_s: as stated; None where it is not.
        files: names of the averaged files.
        peak: brightest value, share of full scale.
        saturated: share of pixels that are full.
        signal_to_noise: brightest pixel of the light over the noise where it is dark.
        negative_share: share of the light's absolute values that is noise below zero.
        background: what was taken off.
        centroid_px: ``(x, y)`` of the light in the stored frame, pixels from the grid's origin, before it was moved.
        exposure: factor by which the plane was brighter than the stack's mean, taken out.
        lamp: the same, divided by what stated exposure and distance explain; None where no exposures are stated.
        faults: why it should be measured again.
        notes: what else is worth knowing.
    """

    depth_m: float
    exposure_s: float | None
    files: tuple[str, ...]
    peak: float
    saturated: float
    signal_to_noise: float
    negative_share: float
    background: str
    centroid_px: tuple[float, float]
    exposure: float
    lamp: float | None
    faults: tuple[str, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Calibration:
    """The stack, where everything was, and the planes one by one.

    Attributes:
        stack: registered, of one exposure.
        geometry: where mask and sources were.
        planes: what is known of each distance.
        offset_m: that was added to the stated distances.
        notes: on the pictures altogether.
    """

    stack: PsfStack
    geometry: Geometry
    planes: tuple[Plane, ...]
    offset_m: float = 0.0
    notes: tuple[str, ...] = ()

    def record(self) -> dict[str, Any]:
        """Return all numbers, for calibration.json; unknown ones are null."""
        g = self.geometry
        return {
            "format": _FORMAT,
            "offset_m": self.offset_m,
            "mask_to_sensor": _distance(g.distance),
            "mask_to_sensor_with_free_offset": _distance(g.with_offset),
            "depth_scatter_m": _number(g.depth_std_m),
            "rail_meets_sensor_px": None if g.centre_px is None else g.centre_px.round(4).tolist(),
            "rail_meets_sensor_std_px": _number(g.centre_std_px),
            "shift_std_px": g.shift_std_px,
            "planes": [
                {
                    "depth_m": plane.depth_m,
                    "files": list(plane.files),
                    "exposure_s": plane.exposure_s,
                    "peak": round(plane.peak, 5),
                    "saturated": plane.saturated,
                    "signal_to_noise": round(plane.signal_to_noise, 2),
                    "negative_share": round(plane.negative_share, 5),
                    "background": plane.background,
                    "centroid_px": [round(value, 4) for value in plane.centroid_px],
                    "shift_px": g.shifts_px[k].round(4).tolist(),
                    "magnification": round(float(g.magnifications[k]), 7),
                    "depth_error_m": _number(g.depth_errors_m[k]),
                    "off_rail_m": [_number(value) for value in g.off_line_m[k]],
                    "exposure": round(plane.exposure, 5),
                    "lamp": plane.lamp,
                    "measure_again": list(plane.faults),
                    "notes": list(plane.notes),
                }
                for k, plane in enumerate(self.planes)
            ],
            "notes": list(self.notes),
        }


def is_record(path: Path) -> bool:
    """Return whether a file is the `record` of a calibration."""
    try:
        return parse_json(path.read_bytes()).get("format") == _FORMAT
    except (OSError, ValueError, AttributeError):
        return False


def calibrate(
    folder: Path,
    pixel_pitch_m: float,
    *,
    table: Path | None = None,
    frame: Literal["physical", "stored"] = "physical",
    bits: int | None = None,
    cfa: Cfa | None = None,
    binning: int = 1,
    nominal_m: float | None = None,
    offset_m: float = 0.0,
    throughput_m2: float | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Calibration:
    """Turn a folder of pictures into a registered stack of one exposure.

    Args:
        folder: see ``find_groups``, as ``table``.
        pixel_pitch_m: of the pixels as they are read, metres; of a mosaic, of its single pixels.
        table: CSV of files and distances.
        frame: ``physical`` as read from the sensor (rotated here by 180 degrees), or ``stored``.
        bits: bit depth of the files' numbers.
        cfa: colours of a mosaic's upper left 2 x 2 pixels.
        binning: pixels (of one colour) per side that become one.
        nominal_m: roughly the distance from mask to sensor, metres; None searches for it.
        offset_m: added to the stated distances so that they count from the mask, metres: they were taken from the housing.
        throughput_m2: light that reaches the sensor, see ``load_measured_psf``; None lets each PSF add up to 1 on average.
        progress: called with stage, done and total.

    Raises:
        InputError: for settings that make no sense, and pictures that cannot be read, do not belong together or hold no
            light.
    """
    check_settings(pixel_pitch_m, pixel_pitch_m**2 if throughput_m2 is None else throughput_m2, binning, frame)
    groups, dark = find_groups(folder, table)
    pictures = []
    for k, group in enumerate(groups):
        pictures.append(read_picture(group, dark, bits=bits, cfa=cfa, binning=binning))
        if progress is not None:
            progress("pictures", k + 1, len(groups))
    depths = np.array([picture.distance_m + offset_m for picture in pictures])
    check_depths(depths)
    planes = _planes(pictures, frame)
    pitch_m = pixel_pitch_m * pictures[0].pixels
    grey = planes.mean(axis=1, dtype=np.float64)
    geometry = find_geometry(grey, depths, pitch_m, nominal_m=nominal_m)
    totals = np.array([picture.light.mean(axis=0).sum() for picture in pictures])
    exposures = relative_exposures(grey, geometry.shifts_px, geometry.magnifications, depths, pitch_m, totals)
    told = tuple(_plane(*one, geometry, exposures, pictures, depths, grey) for one in enumerate(pictures))
    registration = Registration(geometry.shifts_px, exposures, geometry.matches)
    stack = _stack(folder, planes, depths, pitch_m, registration, told, pictures, throughput_m2, frame, binning, cfa)
    files = [file for group in (*groups, *dark) for file in group.files]
    notes = [f"left out: {others}"] if (others := left_out(folder, files)) else []
    if _of_other_bits(pictures):
        top = max(picture.brightest for picture in pictures)
        notes.append(f"the numbers end at {top:g}: give --bits, if the sensor has fewer bits than its files")
    return Calibration(stack, geometry, told, offset_m, tuple(notes))


def _of_other_bits(pictures: list[Picture]) -> bool:
    return all(picture.guessed and picture.peak < _OTHER_BITS for picture in pictures)


def _planes(pictures: list[Picture], frame: str) -> NDArray[np.float32]:
    first = pictures[0].light
    for picture in pictures:
        if picture.light.shape != first.shape:
            wanted = f"{first.shape}, as {pictures[0].files[0].name} has"
            raise InputError(
                picture.files[0], f"got {picture.light.shape} (channels, rows, columns), expected {wanted}"
            )
        if not picture.light.sum() > 0:
            raise InputError(picture.files[0], "holds no light beyond darkness: was the source covered?")
    planes = [_not_negative(picture.light, picture.noise) for picture in pictures]
    return np.stack([rotated(plane) if frame == "physical" else plane for plane in planes]).astype(np.float32)


def _not_negative(light: NDArray[np.float64], noise: float) -> NDArray[np.float64]:
    """Return light ``(C, H, W)`` without values below zero: its local mean where it does not stand out of the noise.

    Noise that is cut off at zero is light, 0.4 of its standard deviation in every pixel: over a whole sensor a tenth of a PSF
    whose brightest pixel is 50 times the noise. Its mean is none, and keeps what glows more faintly than the noise.
    """
    from scipy.ndimage import gaussian_filter

    def blurred(values: NDArray[np.float64], width: float) -> NDArray[np.float64]:
        return gaussian_filter(values, (0, width, width))

    faint = blurred(light, _FINE_PX) < _SEEN * noise / (2 * np.sqrt(np.pi) * _FINE_PX)
    there = blurred(faint.astype(np.float64), _WIDE_PX)
    mean = np.divide(blurred(np.where(faint, light, 0), _WIDE_PX), there, out=np.zeros_like(light), where=faint)
    return np.maximum(np.where(faint, mean, light), 0)


def _plane(
    k: int,
    picture: Picture,
    geometry: Geometry,
    exposures: NDArray[np.float64],
    pictures: list[Picture],
    depths: NDArray[np.float64],
    grey: NDArray[np.float64],
) -> Plane:
    faults, notes = [], list(picture.notes)
    snr = float(picture.light.max()) / max(picture.noise, 1e-12)
    if picture.saturated > 0:
        faults.append(f"{share(picture.saturated)} of its pixels are full: expose it for less time")
    elif picture.peak < DARK_PEAK and not _of_other_bits(pictures):
        faults.append(f"its brightest pixel is at {share(picture.peak)} of full scale: expose it for longer")
    if snr < FEW_NOISE:
        faults.append(
            f"its brightest pixel is only {snr:.0f} times the noise: expose it for longer, or take more frames"
        )
    unlike = [j for j in (k - 1, k) if 0 <= j < len(geometry.matches) and not geometry.matches[j].found]
    if unlike and len(unlike) == (k > 0) + (k < len(depths) - 1):
        least = max(geometry.matches[j].correlation for j in unlike)
        faults.append(f"it does not look like its neighbours (correlation {least:.2f}, expected {FOUND:g} at least)")
    if k in geometry.misplaced:
        true = depths[k] + geometry.depth_errors_m[k]
        faults.append(f"its magnification is that of {length(true)}: is the distance right?")
    if k in geometry.off_the_line:
        x, y = geometry.off_line_m[k].round(6) * 1e3 + 0.0  # no minus zero
        notes.append(f"the source was {x:+.3f}, {y:+.3f} mm off the others' line; that is taken out")
    edges = cut_edges(picture.light.mean(axis=0))  # as the sensor saw it, noise below zero included
    if edges:
        notes.append(f"the PSF is cut: {shown_edges(edges)}")
    negative = -float(np.minimum(picture.light, 0).sum()) / float(np.abs(picture.light).sum())
    if negative > _NOISY:
        notes.append("where its light does not stand out of the noise, the local mean of light and noise is taken")
    lamp = None
    if all(other.exposure_s for other in pictures):
        brightness = exposures * depths**2 / np.array([other.exposure_s for other in pictures])
        lamp = float(brightness[k] / np.median(brightness))
        if abs(lamp - 1) > OTHER_LIGHT:
            notes.append(
                f"it has {share(lamp)} of the light that exposure and distance say: lamp, gain or exposure were "
                "others; that is taken out"
            )
    row, column = centre_of_mass(grey[k])
    return Plane(
        depth_m=float(depths[k]),
        exposure_s=picture.exposure_s,
        files=tuple(file.name for file in picture.files),
        peak=picture.peak,
        saturated=picture.saturated,
        signal_to_noise=snr,
        negative_share=negative,
        background=picture.background,
        centroid_px=(column, row),
        exposure=float(exposures[k]),
        lamp=lamp,
        faults=tuple(faults),
        notes=tuple(notes),
    )


def _stack(
    folder: Path,
    planes: NDArray[np.float32],
    depths: NDArray[np.float64],
    pitch_m: float,
    registration: Registration,
    told: tuple[Plane, ...],
    pictures: list[Picture],
    throughput_m2: float | None,
    frame: str,
    binning: int,
    cfa: Cfa | None,
) -> PsfStack:
    values = np.empty(planes.shape, np.float32)
    for k, plane in enumerate(planes):
        values[k] = magnified(plane / registration.exposures[k], 1.0, -registration.shifts_px[k])
    throughput = pitch_m**2 if throughput_m2 is None else throughput_m2
    values *= np.float32(throughput / (values.sum(axis=(-2, -1), dtype=np.float64).mean() * pitch_m**2))
    settings = {
        "kind": "measured",
        "frame": frame,
        "binning": binning,
        "cfa": cfa,
        "background": ", ".join(sorted({plane.background for plane in told})),
        "throughput_m2": throughput,
        "throughput_known": throughput_m2 is not None,
    }
    hashes = [sha256_file(file) for picture in pictures for file in picture.files]
    identity = [settings, hashes, depths.tolist(), pitch_m, registration.record()]
    return PsfStack(
        values=values,
        depths_m=depths,
        pixel_pitch_m=pitch_m,
        channels=RGB if planes.shape[1] == 3 else GREY,
        fingerprint=hashlib.sha256(json.dumps(identity).encode()).hexdigest(),
        provenance={
            **settings,
            "turned_by_180_degrees": frame == "physical",
            "images": [{"file": file, "of": folder.name} for plane in told for file in plane.files],
            "registration": registration.record(),
            "warnings": [f"{length(plane.depth_m)}: {fault}" for plane in told for fault in plane.faults],
        },
    )


def _distance(found: Distance | None) -> dict[str, float] | None:
    if found is None:
        return None
    record = {"distance_m": found.distance_m, "distance_std_m": found.distance_std_m}
    if found.offset_m is not None and found.offset_std_m is not None:
        record |= {"offset_m": found.offset_m, "offset_std_m": found.offset_std_m}
    return record


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
