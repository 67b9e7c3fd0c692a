"""The files of a sample's folder: their names, and ``sample.json``, which describes and binds them.

A sample of one frame has ``measurement.exr`` and ``ground_truth.exr``; a clip has ``frames/ground_truth.0000.exr`` and so on
instead of the latter. Global measurements are ``frames/global.0000.exr`` and so on, where there are any.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from simulator.errors import InputError
from simulator.io.clips import layout_channels
from simulator.io.files import sha256_bytes

MEASUREMENT, GROUND_TRUTH, DESCRIPTION = "measurement.exr", "ground_truth.exr", "sample.json"
FRAMES = "frames"  # the folder inside a sample's
NOISELESS = "noiseless."
MOST_FRAMES = 10_000  # names have four digits, so that they sort
_FIELDS = {"channels", "files", "id", "index", "label", "metadata", "seed", "split"}


def truth_file(frame: int, frames: int) -> str:
    """Return the name of a frame's ground truth in a sample of so many frames.

    Example:
        >>> truth_file(0, 1), truth_file(3, 10)
        ('ground_truth.exr', 'frames/ground_truth.0003.exr')
    """
    return GROUND_TRUTH if frames == 1 else f"{FRAMES}/ground_truth.{frame:04d}.exr"


def global_file(frame: int) -> str:
    """Return the name of a frame's global measurement."""
    return f"{FRAMES}/global.{frame:04d}.exr"


def file_names(frames: int, global_measurements: bool) -> list[str]:
    """Return the names of the EXR files of a sample."""
    names = [MEASUREMENT, *(truth_file(frame, frames) for frame in range(frames))]
    return names + [global_file(frame) for frame in range(frames if global_measurements else 0)]


def file_metadata(description: Mapping[str, Any], frame: int | None) -> dict[str, Any]:
    """Return the metadata of an EXR file: all of ``sample.json`` but the hashes, and its frame where a clip has several.

    So no file can take another's place, of its own sample or of another.
    """
    shared = {key: value for key, value in description.items() if key != "files"}
    return shared if frame is None else shared | {"frame": frame}


def digest_of(hashes: Mapping[str, str]) -> str:
    """Return the digest of a sample from the SHA-256 of its files by name, ``sample.json`` included."""
    return sha256_bytes("".join(f"{name} {hashes[name]}\n" for name in sorted(hashes)).encode())


def read_description(folder: Path) -> tuple[dict[str, Any], bytes]:
    """Read ``sample.json``: its content and its bytes.

    Raises:
        InputError: missing or not what ``write_sample`` wrote.
    """
    path = Path(folder) / DESCRIPTION
    cure = "make the sample again or restore it from a copy"
    try:
        data = path.read_bytes()
        description = json.loads(data)
        complete = set(description) >= _FIELDS and _files_fit(description)
        complete = complete and all(isinstance(name, str) for name in description["channels"])
        complete = complete and isinstance(description["metadata"], dict)
        layout_channels(description.get("extras", {}) if complete else {})
    except OSError as error:
        msg = f"cannot read {path}: {error.strerror or error}; is {folder} a sample?"
        raise InputError(msg) from error
    except (ValueError, TypeError, RecursionError) as error:
        msg = f"{path} is not a sample description ({error}); {cure}"
        raise InputError(msg) from error
    if not complete:
        msg = f"{path} lacks fields of a sample description; {cure}"
        raise InputError(msg)
    return description, data


def _files_fit(description: dict[str, Any]) -> bool:
    """Whether a description lists just the files, and the times, of the frames that it speaks of."""
    frames, measured = description.get("frames", 1), description.get("global_measurements", False)
    if type(frames) is not int or not 1 <= frames <= MOST_FRAMES or type(measured) is not bool:
        return False
    edges_s = description.get("frame_edges_s")
    if edges_s is not None:
        edges = np.array(edges_s, np.float64)
        if edges.shape != (frames + 1,) or not np.all(np.isfinite(edges)) or not np.all(np.diff(edges) > 0):
            return False
    return set(description["files"]) == set(file_names(frames, measured)) and (edges_s is not None or frames == 1)
