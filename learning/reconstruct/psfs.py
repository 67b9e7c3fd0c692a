"""The PSFs of a camera of which nothing else is known: an image or a stack's folder, made to fit its capture.

To fit: the channels are the capture's, a pixel of the one is a pixel of the other, and a PSF that its image cuts fades out.
"""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from learning.reconstruct.inputs import Frame, Measurement, Request, check_frame
from simulator.arrays import to_numpy
from simulator.errors import InputError
from simulator.io.measurements import Cfa, check_binning
from simulator.optics.measured import Background, cut_edges, load_measured_psf, shown_edges
from simulator.optics.stack import PsfStack, with_channels
from simulator.optics.stack_files import read_psf_stack

DEPTH_AND_PIXELS = "depth_and_pixels"
"""Key of the provenance of PSFs of which neither depth nor pixel pitch is known."""
_PITCH_M = 1e-5  # nothing here depends on it: values are scaled to a sum of 1
_FADE = 0.05
"""Share of a side over which a cut PSF fades out.

A step there is a line through every frequency: ADMM then draws a bright cross through the image's middle. Of a scene before
DiffuserCam's diffuser, enlarged beyond the sensor, 2 to 5 % took the line from 78 times the usual difference between
rows to 5 to 7 times, and the correlation with the truth from 0.86 to 0.89 and 0.90; 10 % took it back to 0.86.
"""
_BESIDE = 0.01
"""Share of an on-axis point's light beside the sensor that is worth a word."""


_BINNINGS = 4
"""Two images of one sensor are binned 1 and n, or both by few: 9 and 11 are chance."""


def psfs_of_capture(place: Path, measurement: Measurement, request: Request) -> tuple[PsfStack, list[str]]:
    """Return the PSFs in a file or folder for a capture by the same camera, and what there is to say of them.

    Raises:
        InputError: a file or folder that cannot be read, or PSFs of other channels or pixels.
    """
    if place.is_file():
        frame = request.psf_frame or measurement.frame or "stored"
        check_frame(frame, "--psf-frame")
        told: dict[str, Any] = {"background": request.psf_background, "cfa": request.cfa, "crop": request.psf_crop}
        binning = request.binning if request.psf_binning is None else request.psf_binning
        stack = load_psf_image(place, binning=binning, frame=frame, **told)
        of_files = _of_image(stack)
        shape, known = stack.provenance["images"][0]["shape"], request.psf_crop is not None
    else:
        binning, stack = 1 if request.psf_binning is None else request.psf_binning, read_psf_stack(place)
        shape, of_files = stack.values.shape[-2:], _notes_of_files(stack)
        if not 1 <= binning <= min(shape):
            raise InputError("--psf-binning", f"got {binning}, expected 1 to {min(shape)} pixels per side for {place}")
        known = stack.provenance.get("kind") != "measured"  # computed PSFs are as large as their light
        stack = _binned(stack, binning)
    of_pixels = []
    if not known and request.psf_binning is None:
        of_pixels = _same_pixels(place, (shape[0], shape[1]), binning, measurement, request)
    stack, of_channels = _with_channels_of(measurement, stack, place)
    stack, of_edges = _faded(stack)
    return stack, [*of_files, *of_pixels, *of_channels, *of_edges, *_beside(stack, measurement.sensor_shape)]


def load_psf_image(
    path: Path,
    *,
    background: str | None = None,
    cfa: Cfa | None = None,
    crop: str | None = None,
    binning: int = 1,
    frame: Frame = "stored",
) -> PsfStack:
    """Return the linear image of a PSF as a stack of one plane, infinitely far, with values that add up to 1 on average.

    ``background`` is ``border`` (also None), the median of the cropped image's outer frame; ``none``; counts; or an image of
    darkness, of the same size before the crop. ``cfa`` and ``crop`` as for the measurement: the PSF's origin is the centre of
    what is left. ``frame`` is the file's; a physical image is rotated.

    Raises:
        InputError: a file that cannot be read, a crop beyond it, a binning that does not divide it, or no light.
    """
    try:
        stack = load_measured_psf(
            [path],
            [np.inf],
            _PITCH_M,
            frame=frame,
            cfa=cfa,
            crop=crop,
            binning=binning,
            background=_level(background),
            throughput_m2=_PITCH_M**2,
            channels=None,
        )
        check_binning(binning, path, tuple(stack.provenance["images"][0]["shape"]), "--psf-crop", "--psf-binning")
    except InputError as error:
        if error.path in ("background", "binning", "cfa", "crop"):
            option = "--cfa" if error.path == "cfa" else f"--psf-{error.path}"
            raise InputError(option, error.reason) from error
        raise
    return replace(stack, provenance=stack.provenance | {DEPTH_AND_PIXELS: "unknown"})


def _level(background: str | None) -> Background:
    if background in (None, "border", "none"):
        return "none" if background == "none" else "border"
    try:
        return float(background)
    except ValueError:
        if not Path(background).exists():
            wanted = "border, none, counts, or the file of a dark image"
            raise InputError("--psf-background", f"got {background}, expected {wanted}") from None
        return Path(background)


def _of_image(stack: PsfStack) -> list[str]:
    """Say what was assumed of the image of a PSF, and its background."""
    words, levels = stack.provenance["background"], stack.provenance["images"][0]["background"]
    if words == "border":
        words = f"border {', '.join(f'{level:.4g}' for level in levels)}"
    return [*_notes_of_files(stack), f"background: {words}"]


def _notes_of_files(stack: PsfStack) -> list[str]:
    notes = (note for image in stack.provenance.get("images", ()) for note in image.get("notes", ()))
    return list(dict.fromkeys(notes))


def _binned(stack: PsfStack, binning: int) -> PsfStack:
    """Return a stack on larger pixels, the origin in the middle of its pixel."""
    if binning == 1:
        return stack
    return replace(
        stack,
        values=blocks(centred(to_numpy(stack.values), binning), binning),
        pixel_pitch_m=stack.pixel_pitch_m * binning,
        fingerprint=f"{stack.fingerprint}, binned by {binning}",
    )


def centred(psfs: NDArray[np.floating], factor: int) -> NDArray[np.floating]:
    """Pad PSFs ``(..., H, W)`` to an odd number of blocks with the origin, sample ``n // 2``, in the middle one."""
    margins = [(0, 0)] * (psfs.ndim - 2)
    for size in psfs.shape[-2:]:
        either_side = -(-(size // 2) // factor)
        before = either_side * factor + factor // 2 - size // 2
        margins.append((before, (2 * either_side + 1) * factor - before - size))
    return np.pad(psfs, margins)


def blocks(image: NDArray[np.floating], factor: int) -> NDArray[np.floating]:
    """Return the mean of blocks of ``(..., H, W)``."""
    rows, columns = (size // factor for size in image.shape[-2:])
    return image.reshape(*image.shape[:-2], rows, factor, columns, factor).mean(axis=(-3, -1))


def _same_pixels(
    place: Path, shape: tuple[int, int], binning: int, measurement: Measurement, request: Request
) -> list[str]:
    """Say that PSFs of another size than the capture are taken to have its pixels; refuse them where they may have others."""
    sensor = measurement.sensor_shape
    # The rotation of an even size about its origin leaves out a row.
    if all(size // binning in (there, there - 1) for size, there in zip(shape, sensor, strict=True)):
        return []
    captured = (sensor[0] * request.binning, sensor[1] * request.binning)
    scales = [Fraction(size, there).limit_denominator(16) for size, there in zip(shape, captured, strict=True)]
    whole = min(scales[0].as_integer_ratio()) == 1 or max(scales[0].as_integer_ratio()) <= _BINNINGS
    if request.crop is not None and list(shape) == measurement.record["shape"][-2:]:
        other = f"all of the sensor, of which the capture is a part: --psf-crop {request.crop}"
    elif shape == (captured[1], captured[0]):
        other = "the sensor on its side: save one of the two images rotated by 90 degrees"
    elif scales[0] == scales[1] and whole and abs(shape[0] / captured[0] / float(scales[0]) - 1) < 0.01:
        factors = request.binning * scales[0].denominator, request.binning * scales[0].numerator
        other = f"the same sensor with other pixels: --binning {factors[0]} --psf-binning {factors[1]}"
    else:
        return [f"its {shape[0]} x {shape[1]} pixels are taken to be as large as the capture's"]
    more = "more" if shape[0] > captured[0] else "fewer"
    same = f"pixels of the capture's size, {more} of them: --psf-binning {request.binning}"
    found = f"{place} has {shape[0]} x {shape[1]} pixels, the capture {captured[0]} x {captured[1]}"
    raise InputError("--stack", f"{found}. It shows either {other}; or {same}")


def _with_channels_of(measurement: Measurement, stack: PsfStack, place: Path) -> tuple[PsfStack, list[str]]:
    own, wanted = stack.channels, measurement.channels
    if len(own) == len(wanted):
        return stack, []
    try:
        fitting = with_channels(stack, wanted, str(place))
    except InputError:
        if len(wanted) > 1:
            got = f"got the channels {', '.join(wanted)}, {place} is for {', '.join(own)}"
            raise InputError(measurement.path, f"{got}; give PSFs of this camera") from None
        mean = to_numpy(stack.values).mean(axis=1, keepdims=True)
        fitting = replace(stack, values=mean, channels=wanted, fingerprint=f"{stack.fingerprint}, mean")
        return fitting, [f"the mean of {', '.join(own)}, as the capture is grey"]
    return fitting, [] if len(wanted) == 1 else [f"the same for {', '.join(wanted)}"]


def _faded(stack: PsfStack) -> tuple[PsfStack, list[str]]:
    """Return measured PSFs that end at the edges of their images without a step."""
    if stack.provenance.get("kind") != "measured":
        return stack, []
    values = to_numpy(stack.values)
    light, notes = np.ones_like(values[:, :1]), []
    for plane, window, depth_m in zip(values.mean(axis=1), light[:, 0], stack.depths_m, strict=True):
        edges = cut_edges(plane)
        for edge in edges:
            fade = _fade(plane.shape[0 if edge in ("top", "bottom") else 1])
            if edge in ("top", "bottom"):
                (window if edge == "top" else window[::-1])[: len(fade)] *= fade[:, None]
            else:
                (window if edge == "left" else window[:, ::-1])[:, : len(fade)] *= fade
        if edges:
            lost = 1 - float(np.sum(plane * window) / np.sum(plane))
            of = "" if len(values) == 1 else f" of {depth_m:g} m"
            said = f"the PSF{of} is cut by its image: {shown_edges(edges)}"
            notes.append(f"{said}; faded out there ({lost:.1%} of its light), and what lies beyond is missing")
    if not notes:
        return stack, []
    return replace(stack, values=values * light, fingerprint=f"{stack.fingerprint}, faded"), notes


def _fade(size: int) -> NDArray[np.float64]:
    """Return a cosine from 0 to 1."""
    width = max(1, round(_FADE * size))
    return 0.5 - 0.5 * np.cos(np.pi * (np.arange(width) + 0.5) / width)


def _beside(stack: PsfStack, sensor_shape: tuple[int, int]) -> list[str]:
    """Say what share of an on-axis point's light falls beside the sensor, where it matters."""
    values = to_numpy(stack.values)
    part = values
    for axis, there in ((-2, sensor_shape[0]), (-1, sensor_shape[1])):
        before = max(part.shape[axis] // 2 - there // 2, 0)
        part = np.take(part, range(before, min(before + there, part.shape[axis])), axis)
    beside = 1 - float(part.sum(dtype=np.float64) / values.sum(dtype=np.float64))
    return [f"{beside:.0%} of an on-axis point's light falls beside the sensor"] if beside > _BESIDE else []
