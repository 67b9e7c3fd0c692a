"""What the user gives to `flatlight reconstruct`: the options of a method and its PSFs, and the measurement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from simulator.dataset.dataset_info import FILE
from simulator.dataset.sample import DESCRIPTION, MEASUREMENT, StoredSample
from simulator.errors import InputError
from simulator.io.exr import read_exr
from simulator.io.measurements import (
    GREY,
    RGB,
    Cfa,
    FullScale,
    check_binning,
    crop_window,
    full_scale,
    in_colours,
    note_of_full,
    read_measured_image,
)
from simulator.optics.measured import binned

Frame: TypeAlias = Literal["physical", "stored"]
"""As read from the sensor, or rotated by 180 degrees, so that a pinhole's image is upright."""
Mirror: TypeAlias = Literal["none", "left-right", "up-down"]
"""How a file's image is mirrored against the PSFs'."""


@dataclass(frozen=True)
class Request:
    """What the user says of method and PSFs; see the options of `flatlight reconstruct`."""

    checkpoint: str | None = None
    method: str | None = None
    stack: str | None = None
    cfa: Cfa | None = None
    psf_background: str | None = None
    psf_crop: str | None = None
    psf_frame: Frame | None = None
    psf_binning: int | None = None
    crop: str | None = None
    binning: int = 1
    scene: tuple[int, int] | None = None
    tuned: Path | None = None
    noise_db: float | None = None
    parameters: Mapping[str, Any] | None = None


@dataclass(frozen=True)
class Measurement:
    """What a camera stored: ``values`` ``(C, H, W)`` float32, DN / 2^bits, background removed, cropped, binned, in our frame.

    ``path`` is the file or the sample's folder, ``dataset`` the folder of the data set that it is a sample of; ``channels``
    is ``("grey",)`` for one; ``frame`` is that of the file: samples and copies of their files say ``stored`` themselves, of
    others it is what was told, or None; ``record`` says what was done to the file's numbers, and what was assumed in its
    ``notes``.
    """

    values: NDArray[np.float32]
    path: Path
    channels: tuple[str, ...]
    dataset: Path | None
    frame: Frame | None
    record: dict[str, Any]

    @property
    def sensor_shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.values.shape[1], self.values.shape[2]


def load_measurement(
    path: Path | str,
    *,
    bits: int | None = None,
    background: str | float | None = None,
    cfa: Cfa | None = None,
    crop: str | None = None,
    binning: int = 1,
    mirror: Mirror = "none",
    frame: Frame | None = None,
) -> Measurement:
    """Read a measurement; what is done to it follows the order of the arguments.

    Args:
        path: a sample's folder or its ``measurement.exr``; or the file of one linear image, grey or RGB, see
            `simulator.io.measurements.read_measured_image`.
        bits: the numbers are divided by 2^bits. None takes unsigned integers by their type (8, 16 or 32 bits) and floats as
            shares already.
        background: what the sensor shows without light, in the file's numbers: one number, or an image's path.
        cfa: colours of the upper left 2 x 2 pixels of a colour sensor's mosaic; each 2 x 2 becomes a pixel of three
            channels. None believes a raw file; ``none`` insists that an image is grey.
        crop: ``ROWSxCOLUMNS`` about the centre, or ``ROWSxCOLUMNS+TOP+LEFT``, in the file's pixels; of a mosaic in its 2 x 2.
        binning: pixels per side whose mean becomes one.
        mirror: how the file's image is mirrored against the PSFs'; undone here.
        frame: of an image's file: ``physical`` is rotated here; None leaves it as it is, to be told later.

    Raises:
        InputError: a file that cannot be read or holds NaN, numbers above 2^bits, floats far above 1 without
            ``bits``, a background of another size, what seems to be a mosaic of which ``cfa`` says nothing, a crop beyond the
            image, a size that the binning does not divide, or a frame, mirror or mosaic for a sample, which says all itself.
    """
    path = Path(path)
    sample = _sample_folder(path)
    notes: tuple[str, ...] = ()
    if sample is None:
        image = read_measured_image(path)
        values, notes = image.values, image.notes
        scale = full_scale(image, bits, path)
        notes = (*notes, *note_of_full(values, scale.full))
        light = in_colours(image, cfa, path, "--cfa") / scale.divisor
        if light.shape != values.shape:
            notes = (*notes, f"mosaic {cfa or image.cfa}: each 2 x 2 pixels are one")
        elif cfa not in (None, "none"):
            raise InputError("--cfa", f"got {cfa}, but {path} has {len(values)} channels, not a mosaic; leave it out")
        channels = RGB if len(light) == 3 else GREY
        dataset = label = None
        if frame is None and path.suffix.lower() == ".exr" and "sensor_shape" in read_exr(path)[1]:
            frame = "stored"  # a file of ours that was copied out of its sample says so itself
    else:
        stored = StoredSample(sample)
        values, channels, label = stored.measurement()[0], stored.channels, stored.label
        scale = FullScale(1.0, 1.0, "as stored: DN / 2^bits")
        mirrored = None if mirror == "none" else mirror
        for option, told in (("--bits", bits), ("--frame", frame), ("--mirror", mirrored), ("--cfa", cfa)):
            if told is not None:
                raise InputError(option, f"got {told}, but {sample} is a sample, which says that itself; leave it out")
        frame, light = "stored", values
        dataset = sample.parents[2] if (sample.parents[2] / FILE).is_file() else None
    record: dict[str, Any] = {"file": str(path), "shape": list(light.shape), "divided_by": scale.divisor}
    record["scale"] = scale.source
    if notes:
        record["notes"] = list(notes)
    if label is not None:
        record["label"] = label
    if background is not None:
        dark, words = _dark(background, light.shape, path, cfa)
        light = light - dark / scale.divisor
        record["background"] = words
    if crop is not None:
        light = light[(slice(None), *crop_window(crop, path, (light.shape[-2], light.shape[-1]), "--crop"))]
        record["crop"] = crop
    if binning != 1:
        check_binning(binning, path, light.shape)
        light = binned(light, binning)
        record["binning"] = binning
    if mirror != "none":
        if mirror not in get_args(Mirror):
            raise InputError("--mirror", f"got {mirror!r}, expected one of {', '.join(get_args(Mirror))}")
        light = light[:, :, ::-1] if mirror == "left-right" else light[:, ::-1]
        record["mirror"] = mirror
    if frame is not None:
        check_frame(frame, "--frame")
        record["frame"] = frame
    if frame == "physical":
        light = light[:, ::-1, ::-1]
    return Measurement(light.astype(np.float32), sample or path, channels, dataset, frame, record)


def check_frame(frame: str, option: str) -> None:
    """Refuse other words than those of `Frame`; ``option`` is for the message."""
    if frame not in get_args(Frame):
        raise InputError(option, f"got {frame!r}, expected physical (as read from the sensor) or stored (rotated)")


def _sample_folder(path: Path) -> Path | None:
    """Return the folder of one of our samples, or None for other files."""
    folder = path.absolute()
    if path.name == MEASUREMENT:
        folder = folder.parent
    elif not path.is_dir():
        return None
    if (folder / DESCRIPTION).is_file():
        return folder
    if path.is_dir():
        what = "a data set" if (path / FILE).is_file() else f"a folder without {DESCRIPTION}"
        raise InputError(path, f"{what}; give a sample's folder, e.g. train/0000/s00000000, or an image's file")
    return None


def _dark(
    background: str | float, shape: tuple[int, ...], path: Path, cfa: Cfa | None
) -> tuple[NDArray[np.float64] | float, str]:
    """Return what to subtract from an image of this shape, and what it is in words."""
    try:
        level = float(background)
    except ValueError:
        image = Path(str(background))
    else:
        if not np.isfinite(level):
            raise InputError("--background", f"got {background}, expected a finite number, or an image")
        return level, f"{level:g}"
    dark = in_colours(read_measured_image(image), cfa, image, "--cfa", judge=False)
    if dark.shape[1:] != shape[1:] or len(dark) not in (1, shape[0]):
        dark_size, size = (f"{h} x {w} with {c} channel{'s' if c > 1 else ''}" for c, h, w in (dark.shape, shape))
        wanted = "a dark image of the same camera and size, before crop and binning"
        raise InputError("--background", f"{image} is {dark_size}, but {path} is {size}; expected {wanted}")
    return dark.astype(np.float64), str(image)
