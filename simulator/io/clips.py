"""Clips in OpenEXR: which channels hold what, and a clip's values as they are."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.exr import write_exr
from simulator.io.json import plain
from simulator.types import FARTHEST_M, Clip

TRUTH = ("R", "G", "B", "Z", "valid")

# What each extra is called in a file: its channel, or prefix and components.
_NAMES: dict[str, tuple[str, tuple[str, ...]]] = {
    "shape_id": ("id", ()),
    "normal": ("N", ("X", "Y", "Z")),
    "albedo": ("albedo", ("R", "G", "B")),
    "motion": ("motion", ("X", "Y", "Z")),
    "motion_valid": ("motion.valid", ()),
}
# The same for what follows the layer's number in hidden1_rgb.
_HIDDEN: dict[str, tuple[str, tuple[str, ...]]] = {
    "rgb": ("", ("R", "G", "B")),
    "depth_m": (".Z", ()),
    "valid": (".valid", ()),
}
_DTYPES = ("bool", "uint8", "int16", "uint16", "int32", "float16", "float32")
_LARGEST_WHOLE = 2**24  # up to here float32 holds every whole number
_MOST_COMPONENTS = 1000  # the names of bands have three digits

Layout = dict[str, dict[str, Any]]


def extra_channels(name: str, components: int | None) -> list[str]:
    """Return the channels of an extra; one that rendering does not know keeps its own name.

    Args:
        name: key of `Clip.extras`.
        components: numbers per pixel of ``(T, H, W, n)``, None for ``(T, H, W)``.

    Example:
        >>> extra_channels("hidden2_rgb", 3), extra_channels("shape_id", None), extra_channels("bands", 2)
        (['hidden2.R', 'hidden2.G', 'hidden2.B'], ['id'], ['band000', 'band001'])
    """
    if name == "bands" and components is not None:
        return [f"band{number:03d}" for number in range(components)]
    prefix, letters = _NAMES.get(name, (name, ()))
    hidden = re.fullmatch(r"(hidden\d+)_(rgb|depth_m|valid)", name)
    if hidden:
        suffix, letters = _HIDDEN[hidden[2]]
        prefix = hidden[1] + suffix
    if components is None:
        return [prefix]
    if len(letters) != components:
        letters = tuple(map(str, range(components)))
    return [f"{prefix}.{letter}" for letter in letters]


def describe_extras(extras: Mapping[str, NDArray[Any]]) -> Layout:
    """Return the layout of extras: channels, dtype and components (numbers per pixel, or None) by name.

    Raises:
        InputError: a type or value that float32 cannot hold exactly, or two extras that would share a channel.
    """
    layout: Layout = {}
    taken: dict[str, str] = dict.fromkeys(TRUTH, "the scene")
    for name, values in extras.items():
        if values.dtype.name not in _DTYPES or (values.dtype.kind in "iu" and np.abs(values).max() > _LARGEST_WHOLE):
            most = f", up to {np.abs(values).max()}" if values.dtype.kind in "iu" else ""
            raise InputError(
                f"extras[{name!r}]",
                f"got {values.dtype}{most}; expected {', '.join(_DTYPES)}, whole numbers up to 2^24; convert it knowingly",
            )
        components = values.shape[3] if values.ndim == 4 else None
        channels = extra_channels(name, components)
        for channel in channels:
            if channel in taken:
                raise InputError(f"extras[{name!r}]", f"its channel {channel!r} is that of {taken[channel]}; rename it")
            taken[channel] = name
        layout[name] = {"channels": channels, "components": components, "dtype": values.dtype.name}
    return layout


def frame_channels(
    rgb: NDArray[np.float32], depth_m: NDArray[np.float32], valid: NDArray[np.bool_], extras: Mapping[str, NDArray[Any]]
) -> dict[str, NDArray[np.float32]]:
    """Return one frame as channels."""
    channels = {name: rgb[..., position] for position, name in enumerate("RGB")}
    channels |= {"Z": depth_m, "valid": valid.astype(np.float32)}
    for name, values in extras.items():
        flat = values.ndim == 2
        planes = values[..., None] if flat else values
        for position, channel in enumerate(extra_channels(name, None if flat else values.shape[2])):
            channels[channel] = planes[..., position].astype(np.float32)
    return channels


def frame_extras(channels: Mapping[str, NDArray[np.float32]], layout: Layout) -> dict[str, NDArray[Any]]:
    """Return the extras of one frame, ``(H, W)`` or ``(H, W, n)`` by name: the inverse of `frame_channels`."""
    extras: dict[str, NDArray[Any]] = {}
    for name, entry in layout.items():
        planes = [channels[channel] for channel in entry["channels"]]
        values = planes[0] if entry["components"] is None else np.stack(planes, axis=-1)
        extras[name] = values.astype(entry["dtype"])
    return extras


def layout_channels(layout: object) -> list[str]:
    """Return all channels of a layout that somebody else may have written.

    Raises:
        InputError: it is not a layout.
    """
    entries = layout.items() if isinstance(layout, dict) else [("", None)]
    channels = [channel for name, entry in entries for channel in _listed(name, entry)]
    if "" in channels or len(set(channels)) != len(channels):
        raise InputError("extras", f"got {layout!r}, expected channels, components and dtype by name")
    return channels


def _listed(name: str, entry: object) -> list[str]:
    """Return the channels that a well-formed entry of a layout lists, else an empty name."""
    if not isinstance(entry, dict) or set(entry) != {"channels", "components", "dtype"}:
        return [""]
    count = entry["components"]
    counted = count is None or (type(count) is int and 0 < count <= _MOST_COMPONENTS)
    if not counted or entry["dtype"] not in _DTYPES or entry["channels"] != extra_channels(name, count):
        return [""]
    return entry["channels"]


def write_linear(path: Path, clip: Clip) -> list[Path]:
    """Write a still to ``path``, the frames of a clip beside it as ``name.0000.exr``, ``name.0001.exr``, ...

    Channels: R, G, B, ``Z`` in metres, ``valid`` and those of `simulator.io.clips` for extras; source, label and times are
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
        raise InputError("--output", f"{foreign[0]} is not a frame of this clip; remove it, or choose another name")
