"""A PSF stack on disk: one EXR per depth and psf.json with depths, scale, provenance and hashes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from simulator.dataset.plain import readable_json
from simulator.errors import InputError
from simulator.exr import decode_exr, write_exr
from simulator.files import committed_folder, sha256_bytes, write_atomic
from simulator.optics.psf_stack import PsfStack

DESCRIPTION = "psf.json"


def write_psf_stack(folder: Path, stack: PsfStack) -> None:
    """Write a stack; the folder appears whole or not at all, and replaces an older one.

    Raises:
        StorageError: the place cannot be written to.
    """
    with committed_folder(folder) as temporary:
        files = {}
        for k, planes in enumerate(stack.values):
            name = f"depth_{k:04d}.exr"
            channels = {c: np.asarray(v, np.float32) for c, v in zip(stack.channels, planes, strict=True)}
            metadata = {"depth_m": float(stack.depths_m[k]), "pixel_pitch_m": stack.pixel_pitch_m}
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


def read_psf_stack(folder: Path) -> PsfStack:
    """Read a stack that ``write_psf_stack`` wrote; every file's hash is checked.

    Raises:
        InputError: no such stack, or a damaged one.
    """
    path = folder / DESCRIPTION
    try:
        content = json.loads(path.read_bytes())
    except FileNotFoundError as error:
        msg = f"no PSF stack in {folder}: it has no {DESCRIPTION}; `flatlight psf --output FOLDER` writes one"
        raise InputError(msg) from error
    except (OSError, ValueError) as error:
        msg = f"{path} is unreadable or damaged ({error}); restore it, or delete its folder and compute the stack again"
        raise InputError(msg) from error
    planes = []
    for name, digest in content["files"].items():
        try:
            data = (folder / name).read_bytes()
        except OSError as error:
            msg = f"cannot read {folder / name}: {error.strerror or error}; delete {folder} and compute the stack again"
            raise InputError(msg) from error
        if sha256_bytes(data) != digest:
            msg = (
                f"{folder / name} is damaged: its hash differs from {DESCRIPTION}; delete {folder} and compute it again"
            )
            raise InputError(msg)
        channels, _ = decode_exr(data, folder / name)
        planes.append(np.stack([channels[c] for c in content["channels"]]))
    return PsfStack(
        np.stack(planes),
        np.array([float(depth) for depth in content["depths_m"]]),
        content["pixel_pitch_m"],
        tuple(content["channels"]),
        content["fingerprint"],
        content["provenance"],
    )
