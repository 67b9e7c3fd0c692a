"""One sample: what the camera measured, what was there, and how both are written to disk.

``measurement.exr`` holds the channels (DN / 2^bits) and, beside them, ``noiseless.<channel>``: an OpenEXR part has one
size, and the noiseless measurement has the sensor's, not the scene's. ``ground_truth.exr``, or for a clip a file per frame,
holds linear radiance R, G, B, depth ``Z`` in metres and ``valid`` (0 or 1), and the extras that the scene was asked for, in
the channels that `simulator.io.clips` names. ``sample.json`` repeats their metadata, says which extras and frames there are,
and adds the hashes. See `simulator.dataset.sample_layout` for the names.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.dataset.sample_layout import (
    DESCRIPTION,
    FRAMES,
    MEASUREMENT,
    MOST_FRAMES,
    NOISELESS,
    digest_of,
    file_metadata,
    global_file,
    truth_file,
)
from simulator.errors import InputError
from simulator.io.clips import describe_extras, frame_channels
from simulator.io.exr import write_exr
from simulator.io.files import committed_folder, sha256_bytes, write_atomic
from simulator.io.json import plain, readable_json

SPLITS = ("train", "validation", "test")
_LAST_INDEX = 99_999_999  # ids have eight digits, so that names sort


@dataclass(frozen=True, eq=False)
class Sample:
    """A measurement and its ground truth.

    Attributes:
        measurement: float32 ``(C, H, W)``, DN / 2^bits, with noise.
        noiseless: float32 ``(C, H, W)``, the same before noise.
        rgb: float32 ``(T, h, w, 3)``, linear radiance of the scene.
        depth_m: float32 ``(T, h, w)``, z from the mask plane, metres; the far depth where nothing was seen.
        valid: bool ``(T, h, w)``, false where nothing was seen.
        seed: the root seed of the data set.
        label: class name, or None.
        channels: one name per measurement channel.
        metadata: how the sample came about, JSON-serialisable; no clock times: the same seed gives the same bytes.
        extras: more that is known of every scene pixel, by name, ``(T, h, w)`` or ``(T, h, w, n)``; see `Clip.extras`.
        frame_edges_s: ``(T + 1,)`` increasing seconds: frame ``t`` (a sliver, or a frame of the scene) lasts from edge
            ``t`` to ``t + 1``; None for a still, which lasts.
        global_measurements: float32 ``(T, C, H, W)``, DN / 2^bits: what a global shutter would have given of each frame; or
            None.

    Raises:
        InputError: shapes, types or channel names that contradict each other.
    """

    measurement: NDArray[np.float32]
    noiseless: NDArray[np.float32]
    rgb: NDArray[np.float32]
    depth_m: NDArray[np.float32]
    valid: NDArray[np.bool_]
    seed: int
    label: str | None = None
    channels: tuple[str, ...] = ("R", "G", "B")
    metadata: dict[str, Any] = field(default_factory=dict)
    extras: dict[str, NDArray[Any]] = field(default_factory=dict)
    frame_edges_s: NDArray[np.float64] | None = None
    global_measurements: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        _expect("measurement", self.measurement, np.float32, "(C, H, W)", self.measurement.ndim == 3)
        shape = self.measurement.shape
        _expect("noiseless", self.noiseless, np.float32, f"{shape} like measurement", self.noiseless.shape == shape)
        _expect("rgb", self.rgb, np.float32, "(T, h, w, 3)", self.rgb.ndim == 4 and self.rgb.shape[-1] == 3)
        frames = self.rgb.shape[:3]
        _expect("depth_m", self.depth_m, np.float32, f"{frames} like rgb", self.depth_m.shape == frames)
        _expect("valid", self.valid, np.bool_, f"{frames} like rgb", self.valid.shape == frames)
        names = self.channels
        if len(names) != shape[0] or len(set(names)) != len(names) or any(name.startswith(NOISELESS) for name in names):
            msg = f"Sample.channels must be {shape[0]} different names, none starting with {NOISELESS!r}; got {names}"
            raise InputError(msg)
        if not isinstance(self.seed, int) or not isinstance(self.label, str | None):
            msg = f"Sample.seed must be a whole number and label text or None, got {self.seed!r} and {self.label!r}"
            raise InputError(msg)
        for name, values in self.extras.items():
            if values.ndim not in (3, 4) or values.shape[:3] != frames:
                msg = f"Sample.extras[{name!r}] must be {frames} or {(*frames, 'n')} like rgb, got {values.shape}"
                raise InputError(msg)
        _check_edges(frames[0], self.frame_edges_s)
        if (measured := self.global_measurements) is not None:
            every = (frames[0], *shape)
            _expect("global_measurements", measured, np.float32, f"{every} like measurement", measured.shape == every)


@dataclass(frozen=True)
class SampleRecord:
    """What the manifest keeps of a finished sample.

    Attributes:
        id: ``s00000012``; unique within its split.
        split: ``train``, ``validation`` or ``test``.
        digest: SHA-256 over the names and SHA-256 of the sample's files.
        seed: the root seed.
        label: class name, or None.
    """

    id: str
    split: str
    digest: str
    seed: int
    label: str | None


def sample_id(index: int) -> str:
    """Return the id of a sample's number within its split; ids sort like numbers.

    Example:
        >>> sample_id(12)
        's00000012'
    """
    if not 0 <= index <= _LAST_INDEX:
        msg = f"sample index must be 0 to {_LAST_INDEX}, got {index}"
        raise InputError(msg)
    return f"s{index:08d}"


def sample_index(identifier: str) -> int:
    """Return the number in an id.

    Example:
        >>> sample_index("s00000012")
        12
    """
    digits = identifier[1:]
    if identifier[:1] != "s" or len(digits) != 8 or not (digits.isascii() and digits.isdigit()):
        msg = f"sample id must look like s00000012, got {identifier!r}"
        raise InputError(msg)
    return int(digits)


def sample_folder(root: Path, split: str, index: int) -> Path:
    """Return the folder of a sample; at most a thousand samples share a parent.

    Example:
        >>> sample_folder(Path("out"), "train", 12_345).as_posix()
        'out/train/0012/s00012345'
    """
    if split not in SPLITS:
        msg = f"split must be one of {', '.join(SPLITS)}, got {split!r}"
        raise InputError(msg)
    return Path(root) / split / f"{index // 1000:04d}" / sample_id(index)


def write_sample(root: Path | str, split: str, index: int, sample: Sample) -> SampleRecord:
    """Write a sample's folder, which appears whole or not at all; the same sample gives the same bytes.

    Args:
        root: the data set's folder; made when missing.
        split: ``train``, ``validation`` or ``test``.
        index: number within the split.
        sample: a still (one frame) or a clip of up to 10 000 frames.

    Raises:
        InputError: too many frames, or values that cannot be stored (NaN, inf).
        StorageError: the disk is full or protected; nothing is left of this sample.
    """
    folder = sample_folder(Path(root), split, index)
    description = _describe(sample, split, index)
    with committed_folder(folder) as temporary:
        hashes = {
            name: sha256_bytes(write_exr(temporary / name, channels, file_metadata(description, frame)))
            for name, frame, channels in _files(temporary, sample)
        }
        data = readable_json(description | {"files": hashes})
        write_atomic(temporary / DESCRIPTION, data)
    digest = digest_of(hashes | {DESCRIPTION: sha256_bytes(data)})
    return SampleRecord(folder.name, split, digest, sample.seed, sample.label)


def _describe(sample: Sample, split: str, index: int) -> dict[str, Any]:
    """Return the content of ``sample.json`` without the hashes; what a sample has not is not mentioned."""
    identifier, frames = sample_id(index), sample.rgb.shape[0]
    if frames > MOST_FRAMES:
        msg = (
            f"sample {identifier} has {frames} frames, more than the {MOST_FRAMES} that can be stored; give it fewer frames, "
            "or only its slivers (dataset.slivers)"
        )
        raise InputError(msg)
    description: dict[str, Any] = {
        "channels": sample.channels,
        "frames": frames,
        "id": identifier,
        "index": index,
        "label": sample.label,
        "metadata": sample.metadata,
        "scene_shape": sample.rgb.shape[1:3],
        "seed": sample.seed,
        "sensor_shape": sample.measurement.shape[1:],
        "split": split,
    }
    if sample.extras:
        description["extras"] = describe_extras(sample.extras)
    if sample.frame_edges_s is not None:
        description["frame_edges_s"] = sample.frame_edges_s
    if sample.global_measurements is not None:
        description["global_measurements"] = True
    return plain(description, f"sample {identifier}")


def _files(folder: Path, sample: Sample) -> Iterator[tuple[str, int | None, dict[str, NDArray[np.float32]]]]:
    """Yield name, frame number (None where a sample has one such file) and channels of each EXR file."""
    measured = dict(zip(sample.channels, sample.measurement, strict=True))
    noiseless = {NOISELESS + name: values for name, values in zip(sample.channels, sample.noiseless, strict=True)}
    yield MEASUREMENT, None, measured | noiseless
    frames = len(sample.rgb)
    if frames > 1 or sample.global_measurements is not None:
        (folder / FRAMES).mkdir()
    for frame in range(frames):
        extras = {name: values[frame] for name, values in sample.extras.items()}
        truth = frame_channels(sample.rgb[frame], sample.depth_m[frame], sample.valid[frame], extras)
        yield truth_file(frame, frames), frame if frames > 1 else None, truth
        if sample.global_measurements is not None:
            planes = sample.global_measurements[frame]
            yield global_file(frame), frame, dict(zip(sample.channels, planes, strict=True))


def _check_edges(frames: int, edges_s: NDArray[np.float64] | None) -> None:
    if edges_s is None and frames > 1:
        msg = f"Sample.frame_edges_s must hold the {frames + 1} times that {frames} frames begin and end at, got None"
        raise InputError(msg)
    if edges_s is not None:
        _expect("frame_edges_s", edges_s, np.float64, f"({frames + 1},)", edges_s.shape == (frames + 1,))
        if not np.all(np.isfinite(edges_s)) or not np.all(np.diff(edges_s) > 0):
            msg = f"Sample.frame_edges_s must be finite and increasing seconds, got {edges_s.tolist()}"
            raise InputError(msg)


def _expect(name: str, values: NDArray[Any], kind: type, wanted: str, fits: bool) -> None:
    if not fits or values.dtype != kind:
        msg = f"Sample.{name} must be {np.dtype(kind)} {wanted}, got {values.dtype} {values.shape}"
        raise InputError(msg)
