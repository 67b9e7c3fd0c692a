"""The picture of a PSF as a stack of one plane: cropped, cleaned and binned as its measurement is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from learning.reconstruction.pixels import check_binning, crop_window
from simulator.io.measurements import read_measurement
from simulator.optics.measured import Background, load_measured_psf
from simulator.optics.stack import PsfStack

_PITCH_M = 1e-5  # nothing here depends on it: values are scaled to a sum of 1


def load_psf_picture(
    path: Path, channels: tuple[str, ...], *, background: str | None = None, crop: str | None = None, binning: int = 1
) -> PsfStack:
    """Return the picture of a PSF as a stack of one plane, infinitely far, with values that add up to 1 on average.

    Args:
        path: a linear picture; see `simulator.io.measurements.read_measurement`.
        channels: of the measurement.
        background: ``border`` (also None), the median of the cropped picture's outer frame; ``none``; counts; or a picture
            of darkness, of the same size before the crop.
        crop: see `crop_window`; the PSF's origin is the centre of what is left.
        binning: pixels per side that become one.

    Raises:
        InputError: a file that cannot be read, a crop beyond it, a binning that does not divide it, or no light.
    """
    picture = read_measurement(path, channels)
    if crop is None:
        check_binning(binning, path, _shape(picture), "--psf-crop")
        return _load(path, channels, _level(background), binning)
    window = crop_window(crop, path, _shape(picture), "psf-crop")
    cut = picture[(slice(None), *window)]
    check_binning(binning, path, _shape(cut), "--psf-crop")
    level = _level(background)
    with TemporaryDirectory() as folder:
        np.save(place := Path(folder, "psf.npy"), cut)
        if isinstance(level, Path):
            dark = read_measurement(level, channels)
            dark_window = crop_window(crop, level, _shape(dark), "psf-crop")
            np.save(level := Path(folder, "dark.npy"), dark[(slice(None), *dark_window)])
        stack = _load(place, channels, level, binning)
    told = {"background": background} if isinstance(level, Path) else {}
    images = [record | {"file": path.name} for record in stack.provenance["images"]]
    return replace(stack, provenance={**stack.provenance, **told, "images": images, "crop": crop})


def _load(path: Path, channels: tuple[str, ...], background: Background, binning: int) -> PsfStack:
    return load_measured_psf(
        [path],
        [np.inf],
        _PITCH_M,
        frame="stored",
        binning=binning,
        background=background,
        throughput_m2=_PITCH_M**2,
        channels=channels,
    )


def _level(background: str | None) -> Background:
    if background is None or background == "border":
        return "border"
    if background == "none":
        return "none"
    try:
        return float(background)
    except ValueError:
        return Path(background)


def _shape(picture: Any) -> tuple[int, int]:
    return picture.shape[-2], picture.shape[-1]
