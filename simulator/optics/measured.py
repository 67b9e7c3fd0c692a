"""Measured PSF images as a stack, so that a real camera can be simulated.

One common scale turns counts into irradiance per irradiance; nothing is normalised per depth or channel, so the images
must share exposure, gain and the source's irradiance at the mask.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.measurements import (
    GREY,
    RGB,
    Cfa,
    MeasuredImage,
    check_numbers,
    crop_window,
    in_colours,
    note_of_full,
    read_measured_image,
    read_npy,
)
from simulator.optics.stack import PsfStack, check_depths

Background: TypeAlias = Literal["border", "none"] | float | Path

BORDER_SHARE = 0.02
"""Thickness of the outer frame whose median is the background, as a share of the shorter side."""
OFF_CENTRE_SHARE = 0.125
"""A centre of mass farther from the origin than this share of a side is noted as a warning."""
CUT = 0.1
"""Light along an edge, as a share of the image's mean, from which a PSF is taken to go on beyond its image."""


def load_measured_psf(
    files: Sequence[Path],
    depths_m: Sequence[float],
    pixel_pitch_m: float,
    *,
    frame: Literal["physical", "stored"],
    cfa: Cfa | None = None,
    crop: str | None = None,
    binning: int = 1,
    background: Background = "border",
    throughput_m2: float,
    channels: tuple[str, ...] | None = RGB,
) -> PsfStack:
    """Read measured PSFs, remove their background, crop, bin, rotate and scale them.

    Args:
        files: one image per depth (see `read_measured_image`; grey: the same PSF for every channel), or a single
            ``.npy`` of ``(K, H, W)`` or ``(K, C, H, W)``. Values must be linear in light.
        depths_m: ``(K,)`` depth of the point source from the mask plane, metres, increasing.
        pixel_pitch_m: pitch of the binned pixels, metres.
        frame: ``physical`` as read from the sensor (rotated here by 180 degrees), or ``stored`` (a pinhole's image is
            upright). The origin is sample ``(H // 2, W // 2)`` of the binned image.
        cfa: colours of the upper left 2 x 2 pixels of files that are a colour sensor's mosaic; each 2 x 2 becomes a pixel.
        crop: ``ROWSxCOLUMNS`` about the centre or ``ROWSxCOLUMNS+TOP+LEFT``; its centre becomes the origin.
        binning: pixels per side that are averaged into one; an image that does not divide is cropped in its centre.
        background: ``border`` takes the median of the image's outer 2 % frame, per image and channel (a PSF that fills
            the sensor needs another choice); a number of counts; a file with a dark image; or ``none``.
        throughput_m2: power that reaches the sensor per unit irradiance on the mask, square metres, as the mean over
            depths and channels: transmittance times aperture area, when nothing is cropped.
        channels: names of the channels; None takes those of the files, R, G, B or grey.

    Returns:
        The stack, ``values`` ``(K, C, H, W)`` float32; ``provenance`` records the background levels, the share of light
        that was negative after their removal and set to zero, crops, centres of mass, warnings, and what was assumed of
        each file.

    Raises:
        InputError: when files and depths do not match, a file is unreadable or differs in shape, holds NaN, seems to be a
            mosaic of which ``cfa`` says nothing, or nothing is left of a PSF after the background's removal.
    """
    depths = np.asarray(depths_m, np.float64)
    check_depths(depths)
    check_settings(pixel_pitch_m, throughput_m2, binning, frame)
    read = _Reading(channels, cfa, crop)
    level = _Background(background, read)
    planes: list[NDArray[np.float64]] = []
    records: list[dict[str, Any]] = []
    shape: tuple[int, ...] | None = None
    for name, read_image in read.images([Path(file) for file in files], len(depths)):
        image = read_image.values
        if shape is not None and image.shape != shape:
            raise InputError(
                name, f"{_size(image.shape)}, but the first PSF is {_size(shape)}; all depths need one size"
            )
        shape = image.shape
        light, record = _clean(image, level, binning, name)
        planes.append(rotated(light) if frame == "physical" else light)
        records.append(record | ({"notes": list(read_image.notes)} if read_image.notes else {}))
    values = np.stack(planes)
    if channels is None:
        channels = RGB if values.shape[1] == 3 else GREY
    energy = values.sum(axis=(-2, -1))
    if not np.all(energy > 0):
        k = int(np.argwhere(energy <= 0)[0][0])
        raise InputError(
            records[k]["file"],
            f"the PSF of {depths[k]:g} m is zero everywhere after a background of {records[k]['background']} is "
            "removed; check the image, or choose another background",
        )
    scale = throughput_m2 / (energy.mean() * pixel_pitch_m**2)
    centres = [centre_of_mass(plane) for plane in values.sum(axis=1)]
    told = {name: value for name, value in (("cfa", cfa), ("crop", crop)) if value is not None}
    settings = {
        "kind": "measured",
        **told,
        "frame": frame,
        "binning": binning,
        "background": level.name,
        "throughput_m2": throughput_m2,
    }
    provenance = {
        **settings,
        "same_psf_for_all_channels": values.shape[1] < len(channels),
        "turned_by_180_degrees": frame == "physical",
        "scale_per_count": float(scale),
        "images": [{**record, "centre_of_mass_px": list(c)} for record, c in zip(records, centres, strict=True)],
        "warnings": _warnings(centres, values, depths),
    }
    hashes = [_sha256(Path(file)) for file in files]
    identity = [settings, hashes, level.sha256, depths.tolist(), pixel_pitch_m, list(channels)]
    return PsfStack(
        values=np.repeat(values * scale, len(channels) // values.shape[1], axis=1).astype(np.float32),
        depths_m=depths,
        pixel_pitch_m=pixel_pitch_m,
        channels=tuple(channels),
        fingerprint=hashlib.sha256(json.dumps(identity).encode()).hexdigest(),
        provenance=provenance,
    )


@dataclass(frozen=True)
class _Reading:
    """How files become images ``(1 or C, H, W)``: their colours and the part that is wanted."""

    channels: tuple[str, ...] | None
    cfa: Cfa | None
    crop: str | None

    def one(self, path: Path, *, judge: bool = True) -> MeasuredImage:
        """Return the image of a file; without ``judge`` a mosaic is not looked for."""
        return self._part(read_measured_image(path, self.channels or RGB), path, judge)

    def images(self, files: list[Path], depths: int) -> Iterator[tuple[str, MeasuredImage]]:
        """Yield name and image for each depth, one at a time: a stack of raw captures may be large."""
        count = 3 if self.channels is None else len(self.channels)
        if len(files) == 1 and files[0].suffix.lower() == ".npy" and depths > 1:
            stack = check_numbers(read_npy(files[0]), files[0])
            stack = stack[:, None] if stack.ndim == 3 else stack
            if stack.ndim == 4 and stack.shape[1] not in (1, count) and stack.shape[3] in (1, count):
                stack = np.moveaxis(stack, -1, 1)
            if stack.ndim != 4 or stack.shape[0] != depths or stack.shape[1] not in (1, count) or 0 in stack.shape:
                raise InputError(
                    files[0], f"got shape {stack.shape}, expected ({depths}, H, W) or ({depths}, {count}, H, W)"
                )
            for k, image in enumerate(stack):
                yield f"{files[0].name}[{k}]", self._part(MeasuredImage(image), files[0], True)
            return
        if len(files) != depths:
            raise InputError("files", f"got {len(files)} for {depths} depths: give one per depth, or one .npy with all")
        yield from ((file.name, self.one(file)) for file in files)

    def _part(self, image: MeasuredImage, path: Path, judge: bool) -> MeasuredImage:
        values = in_colours(image, self.cfa, path, judge=judge)
        notes = image.notes if values.shape == image.values.shape else (*image.notes, f"mosaic {self.cfa or image.cfa}")
        full = float(np.iinfo(image.values.dtype).max) if image.values.dtype.kind == "u" else math.inf
        notes = (*notes, *note_of_full(image.values, full))
        if self.channels is not None and len(values) not in (1, len(self.channels)):
            wanted = f"one grey image, or {', '.join(self.channels)}, the camera's channels"
            raise InputError(path, f"got {len(values)} channels, expected {wanted}")
        if self.crop is not None:
            values = values[:, *crop_window(self.crop, path, values.shape[-2:])]
        return MeasuredImage(values, notes)


class _Background:
    """What is subtracted from every image: a level per channel, or a dark image."""

    def __init__(self, background: Background, read: _Reading) -> None:
        self._level: float | None = None
        self._dark: NDArray[Any] | None = None
        self.sha256: str | None = None
        if background in ("border", "none"):
            self.name: str | float = str(background)
        elif isinstance(background, int | float):
            if not (math.isfinite(background) and background >= 0):
                raise InputError("background", f"got {background}, expected counts from 0, 'border', 'none' or a file")
            self._level, self.name = float(background), float(background)
        else:
            path = Path(background)
            self._dark, self.sha256, self.name = read.one(path, judge=False).values, _sha256(path), path.name

    def of(self, image: NDArray[Any], name: str) -> NDArray[Any]:
        """The background of an image ``(C, H, W)``, broadcastable to it."""
        if self._dark is not None:
            if self._dark.shape[-2:] != image.shape[-2:] or self._dark.shape[0] not in (1, image.shape[0]):
                raise InputError(
                    "background",
                    f"{self.name} is {_size(self._dark.shape)}, but {name} is {_size(image.shape)}; expected a dark image "
                    "of the same size",
                )
            return self._dark
        if self._level is not None or self.name == "none":
            return np.full((1, 1, 1), self._level or 0.0)
        return border_level(image)


def border_level(image: NDArray[Any]) -> NDArray[Any]:
    """Return the median of an image's outer frame per channel: ``(C, H, W)`` -> ``(C, 1, 1)``."""
    width = max(1, round(BORDER_SHARE * min(image.shape[-2:])))
    inner = np.zeros(image.shape[-2:], bool)
    inner[width:-width, width:-width] = True
    return np.median(image[:, ~inner], axis=1)[:, None, None]


def _clean(
    image: NDArray[Any], background: _Background, binning: int, name: str
) -> tuple[NDArray[np.float64], dict[str, Any]]:
    """Binned light without background, ``(C, h, w)``, and what was done.

    Binning comes before the clipping at zero, so that noise averages out instead of becoming light.
    """
    if min(image.shape[-2:]) < binning:
        raise InputError(
            "binning", f"got {binning}, expected at most {min(image.shape[-2:])}, as {name} is {_size(image.shape)}"
        )
    dark = background.of(image, name)
    levels = np.broadcast_to(dark, (image.shape[0], *dark.shape[1:])).mean(axis=(-2, -1), dtype=np.float64)
    light = binned(image, binning) - (binned(dark, binning) if dark.shape[-1] > 1 else dark)
    negative, total = -np.minimum(light, 0).sum(axis=(-2, -1)), np.abs(light).sum(axis=(-2, -1))
    record = {
        "file": name,
        "shape": list(image.shape[-2:]),
        "background": levels.tolist(),
        "negative_share": np.divide(negative, total, out=np.zeros_like(total), where=total > 0).tolist(),
        "cropped_px": [n % binning for n in image.shape[-2:]],
    }
    return np.maximum(light, 0), record


def binned(image: NDArray[Any], binning: int) -> NDArray[np.float64]:
    """Mean over blocks of the largest part that divides, in the image's centre; ``(C, H, W)`` -> ``(C, h, w)``."""
    if binning == 1:
        return image.astype(np.float64)
    rows, columns = (n // binning for n in image.shape[-2:])
    top, left = ((n % binning) // 2 for n in image.shape[-2:])
    part = image[:, top : top + rows * binning, left : left + columns * binning]
    return part.reshape(-1, rows, binning, columns, binning).mean(axis=(2, 4), dtype=np.float64)


def rotated(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rotate ``(C, H, W)`` by 180 degrees about sample ``(H // 2, W // 2)``.

    An even size has one row more before the origin than behind it; that outermost row has no counterpart and is left
    out, because a plain flip would move the origin by one sample.
    """
    rows, columns = ((n + 1) % 2 for n in image.shape[-2:])
    return image[:, rows:, columns:][:, ::-1, ::-1]


def centre_of_mass(plane: NDArray[np.float64]) -> tuple[float, float]:
    """Row and column of the centre of mass from the origin, samples."""
    row, column = (np.arange(n) - n // 2 for n in plane.shape)
    return float(plane.sum(1) @ row / plane.sum()), float(plane.sum(0) @ column / plane.sum())


def cut_edges(plane: NDArray[np.floating]) -> dict[str, float]:
    """Return the edges at which a PSF ``(H, W)`` seems to be cut, with the light along them as a share of the mean.

    A PSF fades where it ends. `CUT` is far above what noise leaves after the background's removal, and below what a cut
    leaves: the image of a diffuser has about its mean there.
    """
    width = max(1, round(BORDER_SHARE * min(plane.shape)))
    strips = {"top": plane[:width], "bottom": plane[-width:], "left": plane[:, :width], "right": plane[:, -width:]}
    mean = float(plane.mean())
    return {edge: share for edge, strip in strips.items() if (share := float(strip.mean()) / mean) > CUT}


def _warnings(
    centres: list[tuple[float, float]], values: NDArray[np.float64], depths: NDArray[np.float64]
) -> list[str]:
    rows, columns = values.shape[-2:]
    off = [
        f"the PSF of {depth:g} m has its centre of mass ({row:.1f}, {column:.1f}) pixels from the grid's origin: "
        "the scene will appear shifted by as much"
        for depth, (row, column) in zip(depths, centres, strict=True)
        if abs(row) > OFF_CENTRE_SHARE * rows or abs(column) > OFF_CENTRE_SHARE * columns
    ]
    cut = [
        f"the PSF of {depth:g} m is cut by its image: {shown_edges(edges)}; the light beyond is missing"
        for depth, plane in zip(depths, values.mean(axis=1), strict=True)
        if (edges := cut_edges(plane))
    ]
    return off + cut


def shown_edges(edges: dict[str, float]) -> str:
    """Return the edges of `cut_edges` in words."""
    shown = ", ".join(f"{share:.0%} ({edge})" for edge, share in edges.items())
    return f"its edges still have {shown} of its mean irradiance"


def check_settings(pixel_pitch_m: float, throughput_m2: float, binning: int, frame: str) -> None:
    """Refuse settings of a measured PSF that make no sense, as an InputError naming the argument."""
    if not 1e-8 < pixel_pitch_m < 1e-2:
        raise InputError("pixel_pitch_m", f"got {pixel_pitch_m}, expected metres (2.4 um is 2.4e-6)")
    if not 0 < throughput_m2 < 1:
        raise InputError("throughput_m2", f"got {throughput_m2}, expected square metres above 0 (10 mm2 is 10e-6)")
    if not isinstance(binning, int) or binning < 1:
        raise InputError("binning", f"got {binning!r}, expected a whole number of pixels from 1")
    if frame not in ("physical", "stored"):
        raise InputError("frame", f"got {frame!r}, expected 'physical' (as read from the sensor) or 'stored' (rotated)")


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _size(shape: tuple[int, ...]) -> str:
    return " x ".join(map(str, shape[-2:])) + (f" with {shape[-3]} channels" if shape[-3] > 1 else "")
