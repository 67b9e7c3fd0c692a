"""Which camera and which method a measurement is reconstructed with, from what the user and the measurement say."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from learning.baselines.method import DEFAULTS, build_classical
from learning.capture import CaptureModel, capture_model
from learning.checkpoint import load_checkpoint
from learning.display import measure_white
from learning.measurements import RGB, Measurement
from learning.method import Method
from learning.models.method import LearnedMethod
from learning.plain_capture import plain_capture, typical_white
from learning.planar import PlanarMethod
from learning.shipped import find_checkpoint, shipped_checkpoints
from learning.tuning_book import load_tuned
from simulator.dataset.dataset_info import FILE
from simulator.dataset.psf_files import DESCRIPTION, read_psf_stack, stack_folder
from simulator.dataset.reader import Dataset, open_dataset
from simulator.errors import InputError
from simulator.files import sha256_file
from simulator.optics.measured import load_measured_psf

WORDS = ("nominal", "captured")
_PITCH_M = 1e-5  # of a PSF picture: nothing here depends on it, its values are scaled to a sum of 1


@dataclass(frozen=True)
class Request:
    """What the user says; see the options of `flatlight reconstruct`."""

    checkpoint: str | None = None
    method: str | None = None
    stack: str | None = None
    psf_background: str | None = None
    binning: int = 1
    scene: tuple[int, int] | None = None
    tuned: Path | None = None
    noise_db: float | None = None
    parameters: Mapping[str, Any] | None = None
    white: float | None = None


@dataclass(frozen=True, eq=False)
class Setup:
    """A method for a measurement, and how it was chosen.

    Attributes:
        method: on the CPU.
        white: the radiance that a picture of one plane shows as 1; None leaves it to the picture.
        record: words and numbers, JSON-serialisable.
    """

    method: Method
    white: float | None
    record: dict[str, Any]


def choose_method(measurement: Measurement, request: Request) -> Setup:
    """Return the method for a measurement.

    Raises:
        InputError: options that exclude each other, a checkpoint, stack or tuning that cannot be read, or a camera that does
            not fit the measurement.
    """
    if request.checkpoint is not None and (request.method or request.stack or request.tuned or request.parameters):
        msg = (
            "--checkpoint: a network brings its own PSFs and parameters; leave out --method, --stack, --tuned and --set"
        )
        raise InputError(msg)
    if request.noise_db is not None and request.tuned is None:
        msg = "--noise-db: chooses among tuned parameters; add --tuned, what `flatlight tune` wrote, or leave it out"
        raise InputError(msg)
    picture = request.method is not None and request.stack is not None and Path(request.stack).expanduser().is_file()
    if request.psf_background is not None and not picture:
        msg = "--psf-background: is for the picture of a PSF; name one by --stack, or leave it out"
        raise InputError(msg)
    if request.method is not None:
        return _classical(measurement, request, request.method)
    if request.checkpoint is not None:
        return _learned(measurement, find_checkpoint(request.checkpoint), request)
    if request.stack or request.tuned or request.parameters:
        msg = "--method: missing; --stack, --tuned and --set are for a classical method: add --method cls or --method admm"
        raise InputError(msg)
    refused: list[str] = []
    for name, path in shipped_checkpoints().items():
        try:
            return _learned(measurement, path, request)
        except InputError as error:
            refused.append(f"{name}: {error}")
    reasons = "; ".join(refused) or "none is shipped"
    msg = (
        f"{measurement.path}: no shipped checkpoint fits ({reasons}). Give --checkpoint FILE of a network for this camera, "
        "or --method cls or admm with --stack, its PSFs"
    )
    raise InputError(msg)


def _learned(measurement: Measurement, path: Path, request: Request) -> Setup:
    checkpoint = load_checkpoint(path)
    capture, numbers = (
        checkpoint.capture,
        "the checkpoint's: the measurement is taken to be exposed like its training set",
    )
    dataset = _own_dataset(measurement)
    _check_fit(measurement, capture, f"the network of {path.name}")
    if dataset is not None:
        own = capture_model(dataset)
        if own.scene_shape != capture.scene_shape:
            msg = f"{path}: trained for scenes of {_size(capture.scene_shape)}, {dataset.root} has {_size(own.scene_shape)}"
            raise InputError(msg)
        capture = replace(own.with_stack(capture.stack), white=capture.white)
        numbers = f"of {dataset.root}, the measurement's own data set"
    capture = _without_offset(capture, measurement)
    if request.white is not None:
        capture = replace(capture, white=request.white)
    if capture is not checkpoint.capture:
        checkpoint = load_checkpoint(path, capture=capture)
    if request.scene not in (None, capture.scene_shape):
        msg = f"--scene: the network gives scenes of {_size(capture.scene_shape)}; leave it out"
        raise InputError(msg)
    name = str(checkpoint.architecture["network"])
    record = {
        "checkpoint": str(path),
        "sha256": sha256_file(path),
        "architecture": checkpoint.architecture,
        "camera": _camera(capture, numbers, "as told" if request.white else "the checkpoint's"),
    }
    return Setup(LearnedMethod(name, checkpoint.network, capture), capture.white, record)


def _classical(measurement: Measurement, request: Request, name: str) -> Setup:
    if name not in ("cls", "admm"):
        msg = f"--method: got {name!r}, expected cls or admm; a network is named by --checkpoint"
        raise InputError(msg)
    capture, numbers = _camera_of(measurement, request)
    _check_fit(measurement, capture, f"the stack {request.stack or 'of the data set'}")
    if request.scene is not None and capture.scene_shape != request.scene:
        msg = f"--scene: got {_size(request.scene)}, the data set's scenes have {_size(capture.scene_shape)}; leave it out"
        raise InputError(msg)
    capture = _without_offset(capture, measurement)
    parameters, source = _parameters(measurement, request, name)
    white, white_from = _white(measurement, request, capture)
    capture = replace(capture, white=white)
    record: dict[str, Any] = {"parameters_from": source, "camera": _camera(capture, numbers, white_from)}
    if len(capture.stack.depths_m) == 1:
        planar = PlanarMethod(capture, name, parameters)
        shown = white if request.white is not None or white_from != _TYPICAL else None
        return Setup(planar, shown, {"method": name, "parameters": planar.parameters, **record})
    for parameter in parameters:
        if parameter not in DEFAULTS[name]:
            msg = f"--set: got {parameter!r}, expected a parameter of {name}: {', '.join(DEFAULTS[name])}"
            raise InputError(msg)
    chosen = DEFAULTS[name] | parameters
    return Setup(build_classical(capture, name, chosen), white, {"method": name, "parameters": chosen, **record})


def _camera_of(measurement: Measurement, request: Request) -> tuple[CaptureModel, str]:
    """Return the camera, its white still unknown, and where its numbers come from."""
    dataset, stack = _own_dataset(measurement), request.stack
    if stack is None or stack in WORDS:
        if dataset is None:
            msg = (
                f"--stack: got {stack or 'nothing'}, but {measurement.path} is no sample of a data set; give the PSFs of its "
                "camera: a stack's folder, a data set's, or the picture of a PSF"
            )
            raise InputError(msg)
        return capture_model(dataset, stack or "nominal"), f"of {dataset.root}, the measurement's own data set"
    place = Path(stack).expanduser()
    if place.is_file():
        if dataset is not None:
            msg = f"--stack: {place} is a picture, but {measurement.path} is a sample of a data set; give a stack's folder"
            raise InputError(msg)
        return _plain(measurement, _measured_psf(place, measurement, request), request)
    if (place / FILE).is_file() and dataset is None:
        return capture_model(open_dataset(place, "train")), f"of {place}, whose camera took the measurement"
    folder = stack_folder(place)
    if not (folder / DESCRIPTION).is_file():
        msg = (
            f"--stack: {place} is no picture of a PSF, no stack's folder and no data set; `flatlight psf` makes stacks"
        )
        raise InputError(msg)
    found = read_psf_stack(folder)
    if dataset is not None:
        return capture_model(dataset, found), f"of {dataset.root}, the measurement's own data set"
    return _plain(measurement, found, request)


def _plain(measurement: Measurement, stack: Any, request: Request) -> tuple[CaptureModel, str]:
    _check_channels(measurement, stack.channels, f"the stack {request.stack}")
    capture = plain_capture(stack, measurement.sensor_shape, request.scene)
    return capture, "none: gain 1, no vignetting, colours as they are; radiance has an unknown factor"


def _measured_psf(path: Path, measurement: Measurement, request: Request) -> Any:
    """Return the picture of a PSF as a stack of one plane, infinitely far, with values that add up to 1 on average."""
    background: Any = request.psf_background or "border"
    if background not in ("border", "none"):
        try:
            background = float(background)
        except ValueError:
            background = Path(background)
    return load_measured_psf(
        [path],
        [np.inf],
        _PITCH_M,
        frame="stored",
        binning=request.binning,
        background=background,
        throughput_m2=_PITCH_M**2,
        channels=RGB if len(measurement.channels) == 3 else measurement.channels,
    )


def _parameters(measurement: Measurement, request: Request, name: str) -> tuple[dict[str, Any], str]:
    told = dict(request.parameters or {})
    if request.tuned is None:
        return told, "defaults and --set" if told else "defaults"
    tuned = load_tuned(request.tuned)
    levels = tuned.levels_db(name)
    noise_db = request.noise_db or _noise_db(measurement) or (levels[0] if len(levels) == 1 else None)
    if noise_db is None:
        known = ", ".join(f"{level:g}" for level in levels)
        msg = f"--noise-db: missing; {request.tuned} was tuned at {known} dB: say how noisy the measurement is"
        raise InputError(msg)
    chosen, level = tuned.parameters(name, noise_db)
    return chosen | told, f"{request.tuned}, tuned at {level:g} dB for {noise_db:g} dB{', and --set' if told else ''}"


def _noise_db(measurement: Measurement) -> float | None:
    dataset = _own_dataset(measurement)
    return None if dataset is None else dataset.config["camera"]["noise"].get("psnr_db")


_TYPICAL = "twice the mean radiance of a scene that sends this much light"


def _white(measurement: Measurement, request: Request, capture: CaptureModel) -> tuple[float, str]:
    """Return the radiance to be shown as 1, by which the methods also scale their volumes, and where it comes from."""
    if request.white is not None:
        return request.white, "as told"
    if request.tuned is not None:
        return float(load_tuned(request.tuned).content["identity"]["white"]), f"{request.tuned}"
    root = measurement.dataset
    if root is not None and (train := open_dataset(root, "train")):
        return measure_white(train), f"99th percentile of the train split of {root}"
    return typical_white(capture, measurement.values), _TYPICAL


def _own_dataset(measurement: Measurement) -> Dataset | None:
    """Return the data set that a sample belongs to; the split does not matter."""
    return None if measurement.dataset is None else open_dataset(measurement.dataset, "train")


def _without_offset(capture: CaptureModel, measurement: Measurement) -> CaptureModel:
    """Return the camera without its dark level where a background was subtracted: it would go twice."""
    if "background" not in measurement.record:
        return capture
    return replace(capture, offset=np.zeros_like(capture.offset))


def _check_fit(measurement: Measurement, capture: CaptureModel, whose: str) -> None:
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
        cure = f"add --crop {_size(wanted, 'x')} (about the centre), or give another stack or checkpoint"
    msg = f"{measurement.path} has {_size(got)} pixels, {whose} is for {_size(wanted)}; {cure}"
    raise InputError(msg)


def _check_channels(measurement: Measurement, channels: tuple[str, ...], whose: str) -> None:
    if len(measurement.channels) == len(channels):
        return
    got, wanted = ", ".join(measurement.channels), ", ".join(channels)
    msg = (
        f"{measurement.path} has the channels {got}, {whose} is for {wanted}; give a stack or checkpoint of this camera"
    )
    raise InputError(msg)


def _camera(capture: CaptureModel, numbers: str, white_from: str) -> dict[str, Any]:
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
            if key in ("kind", "background", "binning", "images")
        },
        "gain": capture.gain,
        "offset": capture.offset.tolist(),
        "white": capture.white,
        "white_from": white_from,
    }


def _size(shape: tuple[int, int], between: str = " x ") -> str:
    return between.join(map(str, shape))
