"""Which camera took a measurement, from what the user and the measurement say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from learning.capture import CaptureModel, capture_model
from learning.reconstruction.measurements import RGB, Measurement
from learning.reconstruction.plain_capture import plain_capture
from learning.reconstruction.psf_picture import load_psf_picture
from simulator.dataset.dataset_info import FILE
from simulator.dataset.reader import Dataset, open_dataset
from simulator.errors import InputError
from simulator.optics.stack import PsfStack
from simulator.optics.stack_files import DESCRIPTION, read_psf_stack, stack_folder

WORDS = ("nominal", "captured")


@dataclass(frozen=True)
class Request:
    """What the user says; see the options of `flatlight reconstruct`."""

    checkpoint: str | None = None
    method: str | None = None
    stack: str | None = None
    psf_background: str | None = None
    psf_crop: str | None = None
    binning: int = 1
    scene: tuple[int, int] | None = None
    tuned: Path | None = None
    noise_db: float | None = None
    parameters: Mapping[str, Any] | None = None
    white: float | None = None


@dataclass(frozen=True, eq=False)
class Camera:
    """The camera of a measurement.

    Attributes:
        capture: its white still unknown.
        numbers_from: where gain, offset and irradiance come from, in words.
        dataset: the data set's train split that they are of; None where nothing but the PSFs is known.
    """

    capture: CaptureModel
    numbers_from: str
    dataset: Dataset | None


def camera_of(measurement: Measurement, request: Request) -> Camera:
    """Return the camera that took a measurement.

    Raises:
        InputError: PSFs that are missing, cannot be read, or are of other channels.
    """
    dataset, stack = own_dataset(measurement), request.stack
    if stack is None or stack in WORDS:
        if dataset is None:
            msg = (
                f"--stack: got {stack or 'nothing'}, but {measurement.path} is no sample of a data set; give the PSFs of its "
                "camera: a stack's folder, a data set's, or the picture of a PSF"
            )
            raise InputError(msg)
        return Camera(capture_model(dataset, stack or "nominal"), _own(dataset), dataset)
    place = Path(stack).expanduser()
    if place.is_file():
        if dataset is not None:
            msg = f"--stack: {place} is a picture, but {measurement.path} is a sample of a data set; give a stack's folder"
            raise InputError(msg)
        channels = RGB if len(measurement.channels) == 3 else measurement.channels
        picture = load_psf_picture(
            place, channels, background=request.psf_background, crop=request.psf_crop, binning=request.binning
        )
        return _plain(measurement, picture, request)
    if (place / FILE).is_file() and dataset is None:
        found = open_dataset(place, "train")
        return Camera(capture_model(found), f"of {place}, whose camera took the measurement", found)
    folder = stack_folder(place)
    if not (folder / DESCRIPTION).is_file():
        msg = (
            f"--stack: {place} is no picture of a PSF, no stack's folder and no data set; `flatlight psf` makes stacks"
        )
        raise InputError(msg)
    found = read_psf_stack(folder)
    if dataset is not None:
        return Camera(capture_model(dataset, found), _own(dataset), dataset)
    return _plain(measurement, found, request)


def _own(dataset: Dataset) -> str:
    return f"of {dataset.root}, the measurement's own data set"


def _plain(measurement: Measurement, stack: PsfStack, request: Request) -> Camera:
    _check_channels(measurement, stack.channels, f"the stack {request.stack}")
    capture = plain_capture(stack, measurement.sensor_shape, request.scene)
    return Camera(capture, "none: gain 1, no vignetting, colours as they are; radiance has an unknown factor", None)


def own_dataset(measurement: Measurement) -> Dataset | None:
    """Return the data set that a sample belongs to; the split does not matter."""
    return None if measurement.dataset is None else open_dataset(measurement.dataset, "train")


def without_offset(capture: CaptureModel, measurement: Measurement) -> CaptureModel:
    """Return the camera without its dark level where a background was subtracted: it would go twice."""
    if "background" not in measurement.record:
        return capture
    return replace(capture, offset=np.zeros_like(capture.offset))


def check_fit(measurement: Measurement, capture: CaptureModel, whose: str) -> None:
    """Refuse a measurement that is not of this camera.

    Args:
        measurement: as read.
        capture: the camera.
        whose: it is, in words.

    Raises:
        InputError: other channels or another number of pixels; the cure is named where there is one.
    """
    _check_channels(measurement, capture.stack.channels, whose)
    got, wanted = measurement.sensor_shape, capture.sensor_shape
    if got == wanted:
        return
    factors = {a / b for a, b in zip(got, wanted, strict=True)}
    cure = "it is of another camera: give another stack or checkpoint"
    if len(factors) == 1 and (factor := factors.pop()) > 1 and factor.is_integer():
        cure = f"add --binning {int(factor)}, or give another stack or checkpoint"
    elif measurement.record.get("binning"):
        cure = "leave out --binning, or give another stack or checkpoint"
    elif all(a >= b for a, b in zip(got, wanted, strict=True)):
        cure = f"add --crop {size_in_words(wanted, 'x')} (about the centre), or give another stack or checkpoint"
    msg = f"{measurement.path} has {size_in_words(got)} pixels, {whose} is for {size_in_words(wanted)}; {cure}"
    raise InputError(msg)


def check_light(measurement: Measurement, capture: CaptureModel) -> None:
    """Refuse a measurement without light, of which a method would make something nevertheless.

    Args:
        measurement: as read.
        capture: the camera, its offset what is left of the background.

    Raises:
        InputError: its mean is not above the background.
    """
    mean = float(np.mean(measurement.values - capture.offset[:, None, None]))
    if not mean > 0:
        msg = (
            f"{measurement.path} has a mean of {mean:.3g} above the background, expected light; check --background, or the "
            "exposure"
        )
        raise InputError(msg)


def _check_channels(measurement: Measurement, channels: tuple[str, ...], whose: str) -> None:
    if len(measurement.channels) == len(channels):
        return
    got, wanted = ", ".join(measurement.channels), ", ".join(channels)
    msg = (
        f"{measurement.path} has the channels {got}, {whose} is for {wanted}; give a stack or checkpoint of this camera"
    )
    raise InputError(msg)


def camera_record(capture: CaptureModel, numbers: str, white_from: str) -> dict[str, Any]:
    """Return what a camera is, and where its numbers and its white come from, JSON-serialisable."""
    return {
        "numbers_from": numbers,
        "sensor_shape": list(capture.sensor_shape),
        "scene_shape": list(capture.scene_shape),
        "channels": list(capture.stack.channels),
        "depths_m": [float(depth) for depth in capture.stack.depths_m],
        "psf_fingerprint": capture.stack.fingerprint,
        "psf": {
            key: value
            for key, value in capture.stack.provenance.items()
            if key in ("kind", "background", "crop", "binning", "images")
        },
        "gain": capture.gain,
        "offset": capture.offset.tolist(),
        "white": capture.white,
        "white_from": white_from,
    }


def size_in_words(shape: tuple[int, int], between: str = " x ") -> str:
    """Return rows and columns as a text."""
    return between.join(map(str, shape))
