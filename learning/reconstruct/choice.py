"""Which camera took a measurement and which method reconstructs it, from what the user and the measurement say."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from learning.camera import CaptureModel, capture_model, measure_reference_white, plain_capture, typical_white
from learning.checkpoint import find_checkpoint, load_checkpoint, read_camera, shipped_checkpoints
from learning.classical.by_name import ALL_DEFAULTS, OF_CLIPS, build_method, learned_files
from learning.classical.method import PLANAR_DEFAULTS, PlanarMethod, check_parameters
from learning.method import Method
from learning.models import learned_method
from learning.reconstruct.inputs import Measurement, Request
from learning.reconstruct.psfs import DEPTH_AND_PIXELS, psfs_of_capture
from learning.tune.study import load_tuned
from simulator.dataset.dataset_info import FILE
from simulator.dataset.reader import Dataset, open_dataset
from simulator.errors import InputError
from simulator.io.files import expanded, sha256_file
from simulator.optics.stack import PsfStack
from simulator.optics.stack_files import DESCRIPTION, read_psf_stack, stack_folder
from simulator.plots.drawing import centimetres

_TYPICAL = "twice the mean radiance of a scene that sends this much light"


@dataclass(frozen=True, eq=False)
class Setup:
    """A method for a measurement, on the CPU, its name in names of files, and a record of how it was chosen.

    ``known_white`` says whether the method's white is that of like scenes at this exposure, or a guess.
    """

    method: Method
    name: str
    record: dict[str, Any]
    known_white: bool = True


def choose_method(measurement: Measurement, request: Request) -> Setup:
    """Return the method for a measurement.

    Raises:
        InputError: options that exclude each other, a checkpoint, stack or tuning that cannot be read, or a camera that does
            not fit the measurement.
    """
    if request.checkpoint is not None and (request.method or request.stack or request.tuned or request.parameters):
        brings = "a network brings its own PSFs and parameters"
        raise InputError("--checkpoint", f"{brings}; leave out --method, --stack, --tuned and --set")
    if request.noise_db is not None and request.tuned is None:
        raise InputError("--noise-db", "chooses among tuned parameters; add --tuned, or leave it out")
    image = request.method is not None and request.stack is not None and expanded(request.stack).is_file()
    for option in ("--psf-background", "--psf-crop", "--psf-frame"):
        if getattr(request, option[2:].replace("-", "_")) is not None and not image:
            raise InputError(option, "applies to the image of a PSF; name one by --stack, or leave it out")
    if request.method is not None:
        return _classical(measurement, request, request.method)
    if request.checkpoint is not None:
        return _learned(measurement, find_checkpoint(request.checkpoint), request)
    if request.stack or request.tuned or request.parameters:
        raise InputError(
            "--method", "missing; --stack, --tuned and --set belong to a classical method: add --method NAME"
        )
    refused: dict[str, list[str]] = {}
    for name, path in shipped_checkpoints().items():
        try:
            return _learned(measurement, path, request)
        except InputError as error:
            reason = error.reason if error.path == str(measurement.path) else str(error)
            refused.setdefault(reason, []).append(name)
    reasons = "; ".join(f"{', '.join(names)}: {reason}" for reason, names in refused.items()) or "none is shipped"
    cure = (
        "Give --checkpoint FILE of a network for this camera, or --method (cls; of clips joint, or joint3d where PSFs are "
        "of several depths) with --stack, its PSFs"
    )
    raise InputError(measurement.path, f"no shipped checkpoint fits ({reasons}). {cure}")


def _learned(measurement: Measurement, path: Path, request: Request) -> Setup:
    capture = read_camera(path)
    numbers = "the checkpoint's: the measurement is assumed to be exposed like its training set"
    psfs = shown_stack(capture.stack)
    dataset = _own_dataset(measurement)
    _check_fit(measurement, capture, "the network")
    if dataset is not None:
        try:
            own = capture_model(dataset)
            if own.timing is not None and capture.timing is not None:
                # How many frames are estimated is the network's choice.
                own = replace(own, timing=own.timing.with_slivers_of(capture.timing))
            if own.stack.fingerprint != capture.stack.fingerprint:
                psfs += f", those that the network was trained with; the data set has {shown_stack(own.stack)}"
            capture = own.with_assumed(capture)
        except InputError as error:
            raise InputError(path, f"was trained for another camera than that of {dataset.root}: {error}") from error
        numbers = _of_own(dataset)
    capture = _lit(measurement, capture)
    checkpoint = load_checkpoint(path, capture=capture)
    if request.scene not in (None, capture.scene_shape):
        raise InputError("--scene", f"the network gives scenes of {_size(capture.scene_shape)}; leave it out")
    name = str(checkpoint.architecture["network"])
    record = {
        "checkpoint": str(path),
        "sha256": sha256_file(path),
        "architecture": checkpoint.architecture,
        "camera": _camera_record(capture, numbers, "the checkpoint's") | {"psfs": psfs},
    }
    return Setup(learned_method(name, checkpoint.network, capture), name, record, known_white=dataset is not None)


def _classical(measurement: Measurement, request: Request, name: str) -> Setup:
    if name not in ALL_DEFAULTS:
        known = ", ".join(ALL_DEFAULTS)
        raise InputError("--method", f"got {name!r}, expected one of {known}; a network is named by --checkpoint")
    capture, numbers_from, dataset = camera_of(measurement, request)
    _check_fit(measurement, capture, f"the stack {request.stack or 'of the data set'}")
    if request.scene is not None and capture.scene_shape != request.scene:
        scenes = _size(capture.scene_shape)
        raise InputError("--scene", f"got {_size(request.scene)}, the data set's scenes have {scenes}; leave it out")
    capture = _lit(measurement, capture)
    white, white_from = _white(measurement, request, dataset, capture)
    capture = replace(capture, white=white)
    flat = len(capture.stack.depths_m) == 1 and name in PLANAR_DEFAULTS
    if flat and capture.timing is not None:
        raise InputError("--method", f"got {name}, which is for stills, of a clip; take one of {', '.join(OF_CLIPS)}")
    if name in OF_CLIPS and capture.timing is None:
        what = "a still" if dataset is not None else "a capture of which only the PSFs are known, not the shutter"
        cure = "take cls, admm or pnp"
        if dataset is None:
            cure = f"give a data set of clips by this camera as --stack, or {cure}"
        raise InputError("--method", f"got {name}, which is for clips, of {what}; {cure}")
    if flat and request.tuned is not None:
        raise InputError("--tuned", f"{request.tuned} is for depth, these PSFs are of one; give --set instead")
    known, of = (PLANAR_DEFAULTS[name], f"{name} for one plane") if flat else (ALL_DEFAULTS[name], name)
    told = dict(request.parameters or {})
    check_parameters(told, known, of, "--set")
    parameters, source = _parameters(measurement, request, name, told)
    record: dict[str, Any] = {
        "method": name,
        "parameters": known | parameters,
        "parameters_from": source,
        "files": {key: sha256_file(path) for key, path in learned_files(name, known | parameters, "--set").items()},
        "camera": _camera_record(capture, numbers_from, white_from),
    }
    method = PlanarMethod(capture, name, parameters) if flat else build_method(capture, name, parameters)
    return Setup(method, name, record, known_white=white_from != _TYPICAL)


def _parameters(
    measurement: Measurement, request: Request, name: str, told: dict[str, Any]
) -> tuple[dict[str, Any], str]:
    """Return the parameters that differ from the defaults, and where they come from."""
    if request.tuned is None:
        return told, "defaults and --set" if told else "defaults"
    tuned = load_tuned(request.tuned)
    levels = tuned.levels_db(name)
    dataset = _own_dataset(measurement)
    of_set = None if dataset is None else dataset.config["camera"]["noise"].get("psnr_db")
    noise_db = request.noise_db or of_set or (levels[0] if len(levels) == 1 else None)
    if noise_db is None:
        known = ", ".join(f"{level:g}" for level in levels)
        raise InputError("--noise-db", f"missing; {request.tuned} has parameters for {known} dB: choose by the noise")
    chosen, level = tuned.parameters(name, noise_db)
    return chosen | told, f"{request.tuned}, tuned at {level:g} dB for {noise_db:g} dB{', and --set' if told else ''}"


def camera_of(measurement: Measurement, request: Request) -> tuple[CaptureModel, str, Dataset | None]:
    """Return the camera that took a measurement, its white still unknown.

    And where gain, offset and irradiance come from, in words; and the data set's train split that they are of, None where
    nothing but the PSFs is known.
    """
    dataset, stack = _own_dataset(measurement), request.stack
    if stack is None or stack in ("nominal", "captured"):
        if dataset is None:
            wanted = "give the PSFs of its camera: a stack's folder, a data set's, or the image of a PSF"
            found = f"got {stack or 'nothing'}, but {measurement.path} is not a sample of a data set"
            raise InputError("--stack", f"{found}; {wanted}")
        return capture_model(dataset, stack or "nominal"), _of_own(dataset), dataset
    place = expanded(stack)
    folder = stack_folder(place)
    if place.is_file():
        if dataset is not None:
            found = f"{place} is an image, but {measurement.path} is a sample of a data set"
            raise InputError("--stack", f"{found}; give a stack's folder")
    elif (place / FILE).is_file() and dataset is None:
        train = open_dataset(place, "train")
        return capture_model(train), f"of {place}, whose camera took the measurement", train
    elif not (folder / DESCRIPTION).is_file():
        what = "is a folder of neither a stack nor a data set; `flatlight psf` and `flatlight calibrate` make stacks"
        raise InputError("--stack", f"{place} {what if place.exists() else 'is no file or folder that exists'}")
    elif dataset is not None:
        return capture_model(dataset, read_psf_stack(folder)), _of_own(dataset), dataset
    found, notes = psfs_of_capture(place if place.is_file() else folder, measurement, request)
    noted = replace(found, provenance=found.provenance | {"notes": notes})
    try:
        capture = plain_capture(noted, measurement.sensor_shape, request.scene)
    except InputError as error:
        if error.path != "scene_shape" or request.scene is None:
            raise
        wanted = f"at most the sensor's {_size(measurement.sensor_shape, 'x')}, even where these are even"
        raise InputError("--scene", f"got {_size(request.scene, 'x')}, expected {wanted}, and else odd") from error
    return capture, "none: gain 1, no vignetting, colours as they are; radiance has an unknown factor", None


def _own_dataset(measurement: Measurement) -> Dataset | None:
    """Return the data set that a sample belongs to; the split does not matter."""
    return None if measurement.dataset is None else open_dataset(measurement.dataset, "train")


def _of_own(dataset: Dataset) -> str:
    return f"of {dataset.root}, the measurement's own data set"


def _lit(measurement: Measurement, capture: CaptureModel) -> CaptureModel:
    """Return the camera without its dark level where a background was subtracted, which would otherwise go twice."""
    if "background" in measurement.record:
        capture = replace(capture, offset=np.zeros_like(capture.offset))
    mean = float(np.mean(measurement.values - capture.offset[:, None, None]))
    if not mean > 0:
        found = f"a mean of {mean:.3g} above the background"
        raise InputError(measurement.path, f"got {found}, expected light; check --background, or the exposure")
    return capture


def _check_fit(measurement: Measurement, capture: CaptureModel, whose: str) -> None:
    """Refuse a measurement of other channels or another size than a camera's; the cure is named where there is one."""
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
    raise InputError(measurement.path, f"got {_size(got)} pixels, {whose} is for {_size(wanted)}; {cure}")


def _check_channels(measurement: Measurement, channels: tuple[str, ...], whose: str) -> None:
    if len(measurement.channels) != len(channels):
        got, wanted = ", ".join(measurement.channels), ", ".join(channels)[:60]
        cure = "give a stack or checkpoint of this camera"
        raise InputError(measurement.path, f"got the channels {got}, {whose} is for {wanted}; {cure}")


def _white(
    measurement: Measurement, request: Request, dataset: Dataset | None, capture: CaptureModel
) -> tuple[float, str]:
    """Return the radiance that the methods treat as 1, which sets how strongly they smooth, and where it comes from.

    A data set's, or a tuning's, has a meaning only where the camera's numbers are a data set's: the radiance of others has
    an unknown factor.
    """
    if dataset is not None and request.tuned is not None:
        return float(load_tuned(request.tuned).content["identity"]["white"]), f"{request.tuned}"
    if dataset is not None and len(dataset) > 0:
        return measure_reference_white(dataset), f"99th percentile of the train split of {dataset.root}"
    return typical_white(capture, measurement.values), _TYPICAL


def _camera_record(capture: CaptureModel, numbers: str, white_from: str) -> dict[str, Any]:
    """Return what a camera is, and where its numbers and its white come from, JSON-serialisable."""
    shown = ("kind", "frame", "background", "cfa", "crop", "binning", "images", "notes", "warnings", DEPTH_AND_PIXELS)
    return {
        "numbers_from": numbers,
        "psfs": shown_stack(capture.stack),
        "sensor_shape": list(capture.sensor_shape),
        "scene_shape": list(capture.scene_shape),
        "channels": list(capture.stack.channels),
        "depths_m": [float(depth) for depth in capture.stack.depths_m],
        "psf_fingerprint": capture.stack.fingerprint,
        "psf": {key: value for key, value in capture.stack.provenance.items() if key in shown},
        "gain": capture.gain,
        "offset": capture.offset.tolist(),
        "white": capture.white,
        "white_from": white_from,
    }


def shown_stack(stack: PsfStack) -> str:
    """Return how many depths a stack has, from where to where, on which pixels, and whose it is."""
    depths_m, notes = stack.depths_m, "".join(f"; {note}" for note in stack.provenance.get("notes", ()))
    if DEPTH_AND_PIXELS in stack.provenance:
        return f"1 image, its pixels taken as the capture's ({stack.fingerprint[:8]}){notes}"
    ends = " to ".join(centimetres(float(depth)) for depth in dict.fromkeys((depths_m[0], depths_m[-1])))
    count = f"{len(depths_m)} plane{'s' if len(depths_m) > 1 else ''}"
    return f"{count}, {ends}, {stack.pixel_pitch_m * 1e6:.4g} um pixels ({stack.fingerprint[:8]}){notes}"


def _size(shape: tuple[int, int], between: str = " x ") -> str:
    return between.join(map(str, shape))
