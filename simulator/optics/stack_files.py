"""A PSF stack on disk: one EXR per depth and psf.json with depths, scale, provenance and hashes."""

from __future__ import annotations

from collections.abc import Callable
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.exr import MAX_FILE_BYTES, decode_exr, write_exr
from simulator.io.files import UnreadableError, committed_folder, read_limited, sha256_bytes, write_atomic
from simulator.io.json import are_names, check_keys, is_positive, parse_json, plain, readable_json
from simulator.io.store import Place
from simulator.optics.stack import PsfStack
from simulator.text import show

DESCRIPTION = "psf.json"
PSF_FOLDER = "psf"  # of a data set: the stack that was used
CAPTURED_FOLDER = "psf_captured"  # the same as a calibration would measure it, where the configuration asks for it


def write_psf_stack(folder: Place, stack: PsfStack) -> None:
    """Write a stack; the folder appears whole or not at all, and replaces an older stack.

    Raises:
        InputError: something other than a stack is there.
        StorageError: the place cannot be written to.
    """
    check_replaceable(folder)
    with committed_folder(folder, DESCRIPTION) as temporary:
        files = {}
        for k, planes in enumerate(stack.values):
            name = _file_name(k)
            channels = {c: np.asarray(v, np.float32) for c, v in zip(stack.channels, planes, strict=True)}
            metadata = _metadata(stack.depths_m[k], stack.pixel_pitch_m)
            files[name] = sha256_bytes(write_exr(temporary / name, channels, metadata))
        content = {
            "depths_m": [float(depth) for depth in stack.depths_m],
            "pixel_pitch_m": stack.pixel_pitch_m,
            "channels": list(stack.channels),
            "frame": "stored",
            "fingerprint": stack.fingerprint,
            "provenance": stack.provenance,
            "files": files,
        }
        write_atomic(temporary / DESCRIPTION, readable_json(content))


def read_psf_stack(folder: Place) -> PsfStack:
    """Read a stack that ``write_psf_stack`` wrote; every file's hash, depth and pitch are checked.

    Raises:
        InputError: no such stack, or a damaged one.
    """
    content = _description(folder)
    files, channels, pitch_m = content.pop("files"), content["channels"], content["pixel_pitch_m"]
    try:
        written = [_metadata(depth_m, pitch_m) for depth_m in content["depths_m"]]
    except InputError as error:
        raise InputError(folder / DESCRIPTION, f"damaged depths_m or pixel_pitch_m ({error.reason})") from error
    planes = [
        _read_planes(folder / name, digest, channels, metadata)
        for (name, digest), metadata in zip(files.items(), written, strict=True)
    ]
    try:
        return PsfStack(np.stack(planes), **content)
    except InputError as error:
        raise InputError(folder / DESCRIPTION, f"damaged ({error}); compute the stack again") from error


def read_depths_m(folder: Place) -> NDArray[np.float64]:
    """Return the depths ``(K,)`` of a stack on disk, metres, without reading its images; errors as `read_psf_stack`."""
    return _description(folder)["depths_m"]


def stack_files(folder: Place) -> list[str]:
    """Return the names of a stack's files; errors as `read_psf_stack`."""
    return [DESCRIPTION, *_description(folder)["files"]]


def stack_folder(place: Path, *, captured: bool = False) -> Path:
    """Return where a stack lies: ``place`` itself, or ``psf`` in it when it is a data set's folder.

    Args:
        place: a folder.
        captured: the stack as a calibration would measure it instead, which lies beside the true one.

    Example:
        >>> stack_folder(Path("out/stack"), captured=True).as_posix()
        'out/stack_captured'
    """
    folder = place / PSF_FOLDER if (place / PSF_FOLDER).is_dir() else place
    if not captured:
        return folder
    folder = folder if folder.name else folder.absolute()  # the current folder has no name of its own
    return folder.with_name(f"{folder.name}_captured")


def check_replaceable(folder: Place) -> None:
    """Refuse a place where writing a stack would take away something else.

    Raises:
        InputError: it is a file, or a folder with other files in it.
    """
    if not folder.exists():
        return
    if not folder.is_dir():
        raise InputError(folder, "a file; a PSF stack is a folder: choose another name")
    foreign = [path.name for path in sorted(folder.iterdir()) if not is_stack_file(path.name)]
    if foreign:
        raise InputError(
            folder, f"holds other files ({foreign[0]}, ...), which a PSF stack would replace: choose another name"
        )


def is_stack_file(name: str) -> bool:
    """Whether a file has the name of one that belongs to a stack."""
    return name == DESCRIPTION or fnmatchcase(name, "depth_*.exr")


def _description(folder: Place) -> dict[str, Any]:
    """Return the content of psf.json: the fields of a PsfStack but its values, and ``files`` with their hashes."""
    path = folder / DESCRIPTION
    cure = "delete its folder and compute the stack again"
    if not path.exists():
        raise InputError(
            folder, f"not a PSF stack: it has no {DESCRIPTION}; `flatlight psf --output FOLDER` writes one"
        )
    data = read_limited(path, "the description of a PSF stack")
    try:
        content = parse_json(data)
    except ValueError as error:
        raise InputError(path, f"damaged ({type(error).__name__}: {error}); {cure}") from error
    checks: dict[str, Callable[[Any], object]] = {
        "frame": lambda frame: frame == "stored",
        "depths_m": lambda depths: [float(depth) for depth in depths],
        "pixel_pitch_m": is_positive,
        "channels": are_names,
        "fingerprint": lambda text: isinstance(text, str),
        "provenance": lambda record: isinstance(record, dict),
        "files": lambda files: list(files) == [_file_name(k) for k in range(len(content["depths_m"]))] and dict(files),
    }
    check_keys(path, content, checks, cure)
    own = {name: content[name] for name in ("pixel_pitch_m", "fingerprint", "provenance", "files")}
    return own | {
        "depths_m": np.array([float(depth) for depth in content["depths_m"]]),
        "channels": tuple(content["channels"]),
    }


def _file_name(k: int) -> str:
    return f"depth_{k:04d}.exr"


def _metadata(depth_m: float, pixel_pitch_m: float) -> dict[str, Any]:
    """Return what an EXR file says of its plane."""
    return plain({"depth_m": float(depth_m), "pixel_pitch_m": pixel_pitch_m}, "PSF")


def _read_planes(file: Place, digest: str, channels: tuple[str, ...], metadata: dict[str, Any]) -> NDArray[np.float32]:
    """Return the PSFs ``(C, H, W)`` of one depth."""
    try:
        data = read_limited(file, "an OpenEXR file", MAX_FILE_BYTES)
    except UnreadableError:
        raise
    except InputError as error:
        raise InputError(file, f"{error.reason}; delete {file.parent} and compute it again") from error
    if sha256_bytes(data) != digest:
        raise InputError(
            file, f"damaged: its hash differs from {DESCRIPTION}; delete {file.parent} and compute it again"
        )
    found, written = decode_exr(data, file)
    if written != metadata:
        raise InputError(
            file.parent / DESCRIPTION,
            f"its depths_m and pixel_pitch_m say {metadata}, {file.name} was written for {written}: restore both",
        )
    if set(found) != set(channels):
        raise InputError(
            file, f"has the channels {sorted(found)}, {DESCRIPTION} says {show(sorted(channels))}: restore both"
        )
    return np.stack([found[name] for name in channels])
