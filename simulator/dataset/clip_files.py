"""A clip's values as they are, in OpenEXR: linear radiance, metres, and every extra; a file per frame."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from simulator.channels import describe_extras, frame_channels
from simulator.dataset.plain import plain
from simulator.errors import InputError
from simulator.exr import write_exr
from simulator.types import FARTHEST_M, Clip


def write_linear(path: Path, clip: Clip) -> list[Path]:
    """Write a still to ``path``, the frames of a clip beside it as ``name.0000.exr``, ``name.0001.exr``, ...

    Channels: R, G, B, ``Z`` in metres, ``valid`` and those of `simulator.channels` for extras; source, label and times are
    in the metadata.

    Raises:
        InputError: frames of a longer clip lie there, which would be taken for this one's.
        StorageError: the files cannot be written.
    """
    count = len(clip.rgb)
    paths = [path] if count == 1 else [path.with_suffix(f".{frame:04d}{path.suffix}") for frame in range(count)]
    _check_no_others(path, paths)
    layout = describe_extras(clip.extras)
    for frame, file in enumerate(paths):
        metadata = {
            "extras": layout,
            "frame": frame,
            "frame_edges_s": clip.frame_edges_s[frame : frame + 2].tolist(),
            "frames": count,
            "label": clip.label,
            "source": clip.source,
        }
        depth_m = np.minimum(clip.depth_m[frame], np.float32(FARTHEST_M))
        extras = {name: values[frame] for name, values in clip.extras.items()}
        channels = frame_channels(clip.rgb[frame], depth_m, clip.valid[frame], extras)
        write_exr(file, channels, plain(metadata, str(file)))
    return paths


def _check_no_others(path: Path, paths: list[Path]) -> None:
    numbered = re.compile(rf"{re.escape(path.stem)}\.\d{{4,}}{re.escape(path.suffix)}")
    own = {file.name for file in paths}
    others = sorted(file.name for file in path.absolute().parent.iterdir() if numbered.fullmatch(file.name))
    if foreign := [name for name in others if name not in own]:
        msg = (
            f"--output: {foreign[0]} lies there already and is no frame of this clip; remove it, or choose another name"
        )
        raise InputError(msg)
