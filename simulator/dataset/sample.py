"""One sample: what the camera measured, what was there, and how both lie on disk.

``measurement.exr`` holds the channels (DN / 2^bits) and, beside them, ``noiseless.<channel>``: an OpenEXR part has one
size, and the noiseless measurement has the sensor's, not the scene's. ``ground_truth.exr`` holds linear radiance
R, G, B, depth ``Z`` in metres and ``valid`` (0 or 1), and the extras that the scene was asked for, in the channels that
`simulator.channels` names. ``sample.json`` repeats their metadata, says which extras there are, and adds the hashes.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.channels import TRUTH, describe_extras, frame_channels, frame_extras, layout_channels
from simulator.dataset.plain import plain, readable_json
from simulator.errors import InputError
from simulator.exr import decode_exr, write_exr
from simulator.files import committed_folder, sha256_bytes, write_atomic

SPLITS = ("train", "validation", "test")
MEASUREMENT, GROUND_TRUTH, DESCRIPTION = "measurement.exr", "ground_truth.exr", "sample.json"
NOISELESS = "noiseless."
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


def digest_of(hashes: dict[str, str]) -> str:
    """Return the digest of a sample from the SHA-256 of its files by name, ``sample.json`` included."""
    return sha256_bytes("".join(f"{name} {hashes[name]}\n" for name in sorted(hashes)).encode())


def write_sample(root: Path | str, split: str, index: int, sample: Sample) -> SampleRecord:
    """Write a sample's folder, which appears whole or not at all; the same sample gives the same bytes.

    Args:
        root: the data set's folder; made when missing.
        split: ``train``, ``validation`` or ``test``.
        index: number within the split.
        sample: a still (one frame).

    Raises:
        InputError: more than one frame, or values that cannot be stored (NaN, inf).
        StorageError: the disk is full or protected; nothing is left of this sample.
    """
    folder = sample_folder(Path(root), split, index)
    frames = sample.rgb.shape[0]
    if frames != 1:
        msg = f"sample {folder.name} has {frames} frames; only stills (one frame) can be stored"
        raise InputError(msg)
    layout = {"extras": describe_extras(sample.extras)} if sample.extras else {}
    description = plain(
        layout
        | {
            "channels": sample.channels,
            "frames": frames,
            "id": folder.name,
            "index": index,
            "label": sample.label,
            "metadata": sample.metadata,
            "scene_shape": sample.rgb.shape[1:3],
            "seed": sample.seed,
            "sensor_shape": sample.measurement.shape[1:],
            "split": split,
        },
        f"sample {folder.name}",
    )
    measured = dict(zip(sample.channels, sample.measurement, strict=True))
    measured |= {NOISELESS + name: values for name, values in zip(sample.channels, sample.noiseless, strict=True)}
    extras = {name: values[0] for name, values in sample.extras.items()}
    truth = frame_channels(sample.rgb[0], sample.depth_m[0], sample.valid[0], extras)
    with committed_folder(folder) as temporary:
        hashes = {
            MEASUREMENT: sha256_bytes(write_exr(temporary / MEASUREMENT, measured, description)),
            GROUND_TRUTH: sha256_bytes(write_exr(temporary / GROUND_TRUTH, truth, description)),
        }
        data = readable_json(description | {"files": hashes})
        write_atomic(temporary / DESCRIPTION, data)
    digest = digest_of(hashes | {DESCRIPTION: sha256_bytes(data)})
    return SampleRecord(folder.name, split, digest, sample.seed, sample.label)


def read_description(folder: Path) -> tuple[dict[str, Any], bytes]:
    """Read ``sample.json``: its content and its bytes.

    Raises:
        InputError: missing or not what ``write_sample`` wrote.
    """
    path = Path(folder) / DESCRIPTION
    try:
        data = path.read_bytes()
        description = json.loads(data)
        complete = {"channels", "files", "id", "index", "label", "metadata", "seed", "split"} <= set(description)
        complete = complete and set(description["files"]) == {MEASUREMENT, GROUND_TRUTH}
        complete = complete and all(isinstance(name, str) for name in description["channels"])
        complete = complete and isinstance(description["metadata"], dict)
        layout_channels(description.get("extras", {}) if complete else {})
    except OSError as error:
        msg = f"cannot read {path}: {error.strerror or error}; is {folder} a sample?"
        raise InputError(msg) from error
    except (ValueError, TypeError, RecursionError) as error:
        msg = f"{path} is not a sample description ({error}); make the sample again or restore it from a copy"
        raise InputError(msg) from error
    if not complete:
        msg = f"{path} lacks fields of a sample description; make the sample again or restore it from a copy"
        raise InputError(msg)
    return description, data


def read_sample(folder: Path | str) -> Sample:
    """Read a sample's folder.

    Raises:
        InputError: a file is missing, damaged, or belongs to another sample; it is named.
    """
    folder = Path(folder)
    description, _ = read_description(folder)
    files: dict[str, bytes] = {}
    for name in (MEASUREMENT, GROUND_TRUTH):
        try:
            files[name] = (folder / name).read_bytes()
        except OSError as error:
            msg = f"cannot read {folder / name}: {error.strerror or error}"
            raise InputError(msg) from error
    return sample_from_bytes(folder, description, files)


def sample_from_bytes(folder: Path, description: dict[str, Any], files: dict[str, bytes]) -> Sample:
    """Build a sample from the content of its files; ``folder`` only names them in errors."""
    channels = {name: _read_paired(folder / name, data, description) for name, data in files.items()}
    measured, truth = channels[MEASUREMENT], channels[GROUND_TRUTH]
    names = tuple(description["channels"])
    _expect_channels(folder / MEASUREMENT, measured, [*names, *(NOISELESS + name for name in names)])
    layout = description.get("extras", {})
    _expect_channels(folder / GROUND_TRUTH, truth, [*TRUTH, *layout_channels(layout)])
    return Sample(
        measurement=np.stack([measured[name] for name in names]),
        noiseless=np.stack([measured[NOISELESS + name] for name in names]),
        rgb=np.stack([truth[name] for name in "RGB"], axis=-1)[None],
        depth_m=truth["Z"][None],
        valid=(truth["valid"] != 0)[None],
        seed=description["seed"],
        label=description["label"],
        channels=names,
        metadata=description["metadata"],
        extras={name: values[None] for name, values in frame_extras(truth, layout).items()},
    )


def _read_paired(path: Path, data: bytes, description: dict[str, Any]) -> dict[str, NDArray[np.float32]]:
    channels, metadata = decode_exr(data, path, require_checksums=True)
    if metadata != {key: value for key, value in description.items() if key != "files"}:
        msg = f"{path} does not belong to the {DESCRIPTION} beside it: their metadata differ (mixed-up or edited files)"
        raise InputError(msg)
    return channels


def _expect_channels(path: Path, found: dict[str, Any], expected: list[str]) -> None:
    if sorted(found) != sorted(expected):
        msg = f"{path} must have the channels {sorted(expected)}, got {sorted(found)}"
        raise InputError(msg)


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
