"""A trained network in one file: weights, the camera that it belongs to, and how it was made; nothing in it is ever run.

The file is safetensors. Tensors ``network.*`` are the weights and ``camera.*`` the arrays of `CaptureModel`; the header's
metadata hold one JSON text, under ``flatlight``, with format, version, architecture, the camera's numbers and the record.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.models import Network, build_network, full_architecture, named
from learning.models.denoiser import Denoiser
from learning.models.flatnet import FIRST_VERSION
from learning.timing import Timing
from simulator.errors import InputError
from simulator.io.files import expanded, write_atomic
from simulator.io.json import are_names, canonical_json, check_keys, is_positive, is_shape
from simulator.optics.stack import PsfStack
from simulator.text import show
from simulator.validation import renamed

FORMAT, VERSION = "flatlight checkpoint", 2
_KEY = "flatlight"
_WEIGHTS, _CAMERA = "network.", "camera."
FOLDER = Path(__file__).parent / "checkpoints"
"""The trained networks shipped with Flatlight: one small file each."""
DENOISER = "denoiser"
"""Name of the network and of the shipped file; no method by itself."""
_BEST = "flatnet3d"  # where several fit
_NUMBERS: dict[str, Callable[[Any], object]] = {
    **dict.fromkeys(("sensor_shape", "scene_shape"), is_shape),
    **dict.fromkeys(("gain", "white", "pixel_pitch_m"), is_positive),
    "channels": are_names,
    "fingerprint": lambda text: isinstance(text, str),
    "provenance": lambda record: isinstance(record, dict),
}
_LARGEST_PERIOD, _MOST_VALUES = 16, 2**25  # times the pixels that the file holds; of all planes: seconds of work


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """What a checkpoint's file holds: the network in evaluation mode, on the CPU, and the camera that it is built for.

    ``fingerprint`` is of the PSFs that it was trained with, `capture` may have others; ``architecture`` has ``network``,
    ``size`` and all numbers; ``record`` says how it was made: configuration, metrics, command, seconds, versions, device;
    ``path`` is the file, for messages.
    """

    network: Network
    capture: CaptureModel
    fingerprint: str
    architecture: dict[str, Any]
    record: dict[str, Any]
    path: Path = Path("checkpoint")

    @property
    def named(self) -> dict[str, Any]:
        """The architecture as `learning.models.build_network` takes it: ``name`` instead of ``network``."""
        return named(self.architecture)


def save_checkpoint(
    path: Path | str,
    network: Network,
    *,
    architecture: Mapping[str, Any],
    capture: CaptureModel,
    record: Mapping[str, Any],
    precision: torch.dtype = torch.float32,
) -> None:
    """Write a checkpoint; the file holds all of it or what it held before.

    Args:
        path: the file, by custom ``*.safetensors``.
        network: of `learning.models.build_network`; unwrap it from DDP first.
        architecture: ``network``, ``size`` and the changes that it was built with.
        capture: the camera that it was built for.
        record: how it was made; plain values.
        precision: of the stored filters of convolutions and of the PSFs; ``torch.float16`` halves the file and rounds them
            by 5e-4 at most, far less than PSFs are sure to. All else stays exact.

    Raises:
        InputError: an architecture that is not this network's, filters beyond the range of ``precision``, or a record that
            has no JSON form.
        StorageError: the place cannot be written to.
    """
    full = full_architecture(architecture)
    weights = {name: _stored(name, value, precision) for name, value in network.state_dict().items()}
    check_shapes(_build(full, capture).state_dict(), weights, "architecture")
    stack = capture.stack
    arrays = {
        "psf": (stack.values, np.float32),
        "depths_m": (stack.depths_m, np.float64),
        "irradiance": (capture.irradiance, np.float32),
        "scene_to_camera": (capture.scene_to_camera, np.float64),
        "offset": (capture.offset, np.float64),
    }
    if capture.row_exposure is not None:
        arrays["row_exposure"] = (capture.row_exposure, np.float64)
    tensors = {
        _CAMERA + name: torch.from_numpy(np.array(array, kind, order="C")) for name, (array, kind) in arrays.items()
    }
    tensors[_CAMERA + "psf"] = _stored("the PSFs", tensors[_CAMERA + "psf"], precision)
    content = {
        "format": FORMAT,
        "version": VERSION,
        "architecture": full,
        "camera": {
            "sensor_shape": capture.sensor_shape,
            "scene_shape": capture.scene_shape,
            "gain": capture.gain,
            "white": capture.white,
            "channels": stack.channels,
            "pixel_pitch_m": stack.pixel_pitch_m,
            "fingerprint": stack.fingerprint,
            "provenance": stack.provenance,
            "timing": None if capture.timing is None else capture.timing.record(),
        },
        "record": dict(record),
    }
    # One key only: safetensors writes several in an order that differs from run to run.
    named = {_WEIGHTS + name: value for name, value in weights.items()} | tensors
    write_atomic(Path(path), save(named, {_KEY: canonical_json(content).decode()}))


def save_denoiser(
    path: Path | str, network: Denoiser, *, architecture: Mapping[str, Any], record: Mapping[str, Any]
) -> None:
    """Write a denoiser, which belongs to no camera: the same file without one; see `save_checkpoint`."""
    content = {"format": FORMAT, "version": VERSION, "architecture": dict(architecture), "record": dict(record)}
    weights = {_WEIGHTS + name: value.cpu().contiguous() for name, value in network.state_dict().items()}
    write_atomic(Path(path), save(weights, {_KEY: canonical_json(content).decode()}))


def load_denoiser(path: Path | str) -> tuple[Denoiser, dict[str, Any]]:
    """Read a denoiser, in evaluation mode on the CPU, and the record of how it was made.

    Raises:
        InputError: not a checkpoint, a damaged one, of a newer format, or of another network.
    """
    path = Path(path)
    content, tensors = _read(path)
    cure = "restore it from a copy"
    check_keys(path, content, dict.fromkeys(("architecture", "record"), lambda part: isinstance(part, dict)), cure)
    numbers = dict(content["architecture"])
    if (name := numbers.pop("network", None)) != DENOISER:
        raise InputError(path, f"got a checkpoint of {show(name)}, expected one of `flatlight train-denoiser`")
    try:
        with torch.device("meta"):
            built = Denoiser(**numbers)
    except (InputError, TypeError) as error:
        raise InputError(path, f"this version of Flatlight cannot build its network ({error})") from error
    _load_weights(built, path, tensors)
    return built.eval(), content["record"]


def load_checkpoint(path: Path | str, *, capture: CaptureModel | None = None, network: str | None = None) -> Checkpoint:
    """Read a checkpoint and build its network.

    Args:
        path: the file.
        capture: build the network for this camera, whose exposure or sizes may differ; None takes the file's own. Its PSFs
            may differ too, such as those of a PSF calibration of the same camera; these cannot be told from another mask's,
            so compare `Checkpoint.fingerprint` where they should be the same. For a camera with other planes see
            `learning.transfer.for_camera`.
        network: the architecture that is wanted; None takes any.

    Raises:
        InputError: not a checkpoint, a damaged one, of a newer format, of another architecture or camera than asked.
    """
    path = Path(path)
    content, tensors, own = _opened(path)
    architecture, record = renamed(content["architecture"]), renamed(content["record"])
    if content["version"] == 1:
        architecture = FIRST_VERSION | architecture
    name = architecture["network"]
    if network not in (None, name):
        raise InputError(path, f"got a checkpoint of {name}, expected {network}; name another file or another network")
    if capture is not None:
        _check_camera(path, own, capture)
    try:
        # Without memory for weights, whatever the header asks for: those of the file take their places.
        with torch.device("meta"):
            built = _build(architecture, capture or own)
    except (InputError, TypeError, ValueError, RuntimeError, OverflowError) as error:
        reason = f"this version of Flatlight cannot build its network ({error}); use the version that the record names"
        raise InputError(path, reason) from error
    _load_weights(built, path, tensors)
    return Checkpoint(built.eval(), capture or own, own.stack.fingerprint, architecture, record, path)


def read_camera(path: Path | str) -> CaptureModel:
    """Return a checkpoint's own camera, without its network; an InputError says what is wrong, as of `load_checkpoint`."""
    return _opened(Path(path))[2]


def _opened(path: Path) -> tuple[dict[str, Any], dict[str, Tensor], CaptureModel]:
    """Return what a network's file says, its tensors and its camera."""
    content, tensors = _read(path)
    architecture = content.get("architecture")
    if isinstance(architecture, dict) and architecture.get("network") == DENOISER:
        wanted = "expected a network of `flatlight train`; a denoiser belongs to the method pnp: denoiser: FILE"
        raise InputError(path, f"got a denoiser of `flatlight train-denoiser`, {wanted}")
    cure = "restore it from a copy"
    check_keys(
        path, content, dict.fromkeys(("architecture", "camera", "record"), lambda part: isinstance(part, dict)), cure
    )
    check_keys(path, content["architecture"], {"network": lambda name: isinstance(name, str)}, cure)
    check_keys(path, content["camera"], _NUMBERS, cure)
    try:
        return content, tensors, _capture(content["camera"], tensors)
    except (KeyError, ValueError) as error:  # arrays that are not there, or do not fit the numbers
        raise InputError(path, f"damaged: camera: {error}; {cure}") from error


def _load_weights(built: nn.Module, path: Path, tensors: Mapping[str, Tensor]) -> None:
    """Put the file's weights in the places of those of a network on the meta device."""
    weights = {key.removeprefix(_WEIGHTS): value for key, value in tensors.items() if key.startswith(_WEIGHTS)}
    expected = built.state_dict()
    check_shapes(expected, weights, str(path))
    for key, value in weights.items():
        if not bool(torch.isfinite(value).all()):
            raise InputError(path, f"{key} holds NaN or infinite numbers; take an earlier checkpoint")
    built.load_state_dict({key: value.to(expected[key].dtype) for key, value in weights.items()}, assign=True)


def _stored(name: str, value: Tensor, precision: torch.dtype) -> Tensor:
    value = value.detach().cpu().contiguous()
    if not (value.is_floating_point() and value.ndim >= 4):  # all but filters and PSFs are few, and some sensitive
        return value
    rounded = value.to(precision)
    if bool((value.isfinite() & ~rounded.isfinite()).any()):
        most = f"{float(value.abs().max()):.3g}, expected at most {torch.finfo(precision).max:g}"
        raise InputError("precision", f"{name} has values up to {most} for {precision}; store torch.float32")
    return rounded


def _build(architecture: Mapping[str, Any], capture: CaptureModel) -> Network:
    """Return a network of this architecture; torch's generator stays where it is."""
    with torch.random.fork_rng(devices=[]):
        return build_network(capture, **named(architecture))


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    try:
        with safe_open(path, framework="pt") as file:
            text = (file.metadata() or {}).get(_KEY)
            tensors = {} if text is None else {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118 (no dict)
    except OSError as error:
        raise InputError(path, f"cannot be read: {error.strerror or error}") from error
    except SafetensorError as error:
        raise InputError(path, f"not a checkpoint of `flatlight train`, or a truncated one ({error})") from error
    try:
        content = json.loads(text) if text is not None else {}
    except (ValueError, RecursionError):
        content = {}
    if not isinstance(content, dict) or content.get("format") != FORMAT or not isinstance(content.get("version"), int):
        raise InputError(path, "a safetensors file, but not a checkpoint that `flatlight train` wrote")
    if content["version"] > VERSION:
        raise InputError(path, f"got version {content['version']}, expected at most {VERSION}; update Flatlight")
    return content, tensors


def _capture(numbers: dict[str, Any], tensors: dict[str, Tensor]) -> CaptureModel:
    arrays = {key.removeprefix(_CAMERA): v.numpy() for key, v in tensors.items() if key.startswith(_CAMERA)}
    stack = PsfStack(
        arrays["psf"].astype(np.float32),
        arrays["depths_m"],
        float(numbers["pixel_pitch_m"]),
        tuple(numbers["channels"]),
        numbers["fingerprint"],
        numbers["provenance"],
    )
    shapes: Any = {name: tuple(numbers[name]) for name in ("sensor_shape", "scene_shape")}
    # The file holds scene and PSFs; of the sensor it only says the size, on which depends how long a reader computes.
    psf = stack.values.shape
    sides = zip(shapes["sensor_shape"], shapes["scene_shape"], psf[-2:], strict=True)
    period = math.prod(max(sensor, scene + size) for sensor, scene, size in sides)
    held = psf[-2] * psf[-1] + math.prod(shapes["scene_shape"])
    if period > max(_LARGEST_PERIOD * held, _MOST_VALUES // (psf[0] * psf[1])):
        sizes = (
            f"{show(numbers['sensor_shape'])} for a scene of {show(numbers['scene_shape'])}, PSFs of {list(psf[-2:])}"
        )
        raise InputError("sensor_shape", f"got {sizes} pixels, which no camera has")
    scalars: Any = {name: float(numbers[name]) for name in ("gain", "white")}
    timing = numbers.get("timing")
    scalars |= {
        "timing": None if timing is None else Timing.from_record(timing),
        "row_exposure": arrays.get("row_exposure"),
    }
    own: Any = {name: arrays[name] for name in ("offset", "irradiance", "scene_to_camera")}
    return CaptureModel(stack, **shapes, **scalars, **own)


def _check_camera(path: Path, own: CaptureModel, asked: CaptureModel) -> None:
    """Refuse a camera for which the weights mean something else: other channels, pixels, times, or planes at other depths."""
    if (own.timing is None) != (asked.timing is None):
        kinds = ["stills" if each.timing is None else "clips" for each in (own, asked)]
        raise InputError(path, f"its network is for {kinds[0]}, the camera's captures are {kinds[1]}")
    if own.timing is not None and asked.timing is not None:
        try:
            asked.timing.check_same(own.timing, asked.sensor_shape[0])
        except InputError as error:
            raise InputError(path, f"{error.path}: {error.reason}") from error
    mine, other = own.stack, asked.stack
    if mine.channels != other.channels:
        names, wanted = show(list(mine.channels)), show(list(other.channels))
        raise InputError(path, f"its network takes the channels {names}, the stack has {wanted}")
    # A share of 1e-3 forgives numbers that were written with few digits.
    if not np.isclose(mine.pixel_pitch_m, other.pixel_pitch_m, rtol=1e-3, atol=0):
        own_um, um = (f"{stack.pixel_pitch_m * 1e6:g} um" for stack in (mine, other))
        raise InputError(path, f"its network is for pixels of {own_um}, the stack's are {um}; use another stack")
    if len(mine.depths_m) != len(other.depths_m) or not np.allclose(1 / mine.depths_m, 1 / other.depths_m, rtol=1e-3):
        here, there = (
            f"{len(each.stack.depths_m)} planes from {each.near_m * 100:g} to {each.far_m * 100:g} cm"
            for each in (own, asked)
        )
        cure = "use the stack that it was trained with, or fine-tune it for this one (init_from)"
        raise InputError(path, f"its network is for {here}, the stack has {there}; {cure}")


def check_shapes(expected: Mapping[str, Tensor], found: Mapping[str, Tensor], where: str, cure: str = "") -> None:
    """Refuse weights that are not those of an architecture."""
    for name in sorted(expected.keys() | found.keys()):
        got, wanted = (tuple(of[name].shape) if name in of else "nothing" for of in (found, expected))
        if got != wanted:
            raise InputError(where, f"{name} has the shape {got}, expected {wanted} by the architecture{cure}")


def shipped_checkpoints() -> dict[str, Path]:
    """Return the files by name, that of the best network first; empty where there are none."""
    files = {path.stem: path for path in sorted(FOLDER.glob("*.safetensors")) if path.stem != DENOISER}
    return dict(sorted(files.items(), key=lambda item: (item[0] != _BEST, item[0])))


def find_checkpoint(text: str, key: str = "--checkpoint", resolve: Callable[[str], Path] = expanded) -> Path:
    """Return the file of a checkpoint: a shipped one by its bare name, any other by its path.

    Args:
        text: as a user writes it; ``./flatnet3d`` is a file of that name here.
        key: where it is written, for messages.
        resolve: makes a path of it, from the folder of the file that it stands in.

    Raises:
        InputError: neither a shipped checkpoint's name nor a file.
    """
    return _find(text, shipped_checkpoints(), "train", key, resolve)


def find_denoiser(text: str, key: str = DENOISER, resolve: Callable[[str], Path] = expanded) -> Path:
    """Return the file of a denoiser: the shipped one by its name, any other by its path; see `find_checkpoint`."""
    return _find(text, {DENOISER: FOLDER / f"{DENOISER}.safetensors"}, "train-denoiser", key, resolve)


def _find(text: str, shipped: Mapping[str, Path], command: str, key: str, resolve: Callable[[str], Path]) -> Path:
    path = shipped[text] if text in shipped else resolve(text)
    if not path.is_file():
        known = f"a shipped one's name ({', '.join(shipped) or 'there is none'})"
        raise InputError(key, f"got {text!r}, expected {known} or a file of `flatlight {command}`; not a file: {path}")
    return path
