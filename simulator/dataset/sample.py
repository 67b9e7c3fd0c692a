"""One sample: what the camera measured and what was there, the files of its folder, how they are written and read."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.clips import TRUTH, describe_extras, frame_channels, frame_extras, layout_channels
from simulator.io.exr import MAX_FILE_BYTES, decode_exr, write_exr
from simulator.io.files import committed_folder, read_limited, refuse_link, sha256_bytes, write_atomic
from simulator.io.json import are_names, check_keys, parse_json, plain, readable_json
from simulator.io.store import Place, place
from simulator.types import Clip, Surroundings

MEASUREMENT, GROUND_TRUTH, DESCRIPTION = "measurement.exr", "ground_truth.exr", "sample.json"
SURROUNDINGS = "surroundings.exr"
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


def surroundings_file(frame: int, frames: int) -> str:
    """Return the name of a frame of what shines beside the image, of so many frames; see `truth_file`."""
    return SURROUNDINGS if frames == 1 else f"{FRAMES}/surroundings.{frame:04d}.exr"


def file_names(frames: int, global_measurements: bool, surroundings: int) -> list[str]:
    """Return the names of the EXR files of a sample; ``surroundings`` counts their frames."""
    names = [MEASUREMENT, *(truth_file(frame, frames) for frame in range(frames))]
    names += [global_file(frame) for frame in range(frames if global_measurements else 0)]
    return names + [surroundings_file(frame, surroundings) for frame in range(surroundings)]


def file_metadata(description: Mapping[str, Any], frame: int | None) -> dict[str, Any]:
    """Return the metadata of an EXR file: all of ``sample.json`` but the hashes, and its frame where a clip has several.

    So no file can take another's place, of its own sample or of another.
    """
    shared = {key: value for key, value in description.items() if key != "files"}
    return shared if frame is None else shared | {"frame": frame}


def digest_of(hashes: Mapping[str, str]) -> str:
    """Return the digest of a sample from the SHA-256 of its files by name, ``sample.json`` included."""
    return sha256_bytes("".join(f"{name} {hashes[name]}\n" for name in sorted(hashes)).encode())


def read_description(folder: Place) -> tuple[dict[str, Any], bytes]:
    """Read ``sample.json``: its content and its bytes.

    Raises:
        InputError: missing or not what ``write_sample`` wrote.
    """
    path = folder / DESCRIPTION
    cure = "make the sample again or restore it from a copy"
    data = read_limited(path, "the description of a sample")
    try:
        description = parse_json(data)
        layout_channels(description.get("extras", {}) if isinstance(description, dict) else {})
    except (ValueError, TypeError) as error:
        raise InputError(path, f"not a sample description ({str(error)[:200]}); {cure}") from error
    check_keys(path, description, dict.fromkeys(sorted(_FIELDS), lambda _: True), cure)
    frames, measured = description.get("frames", 1), description.get("global_measurements", False)
    around = description.get("surroundings")
    beside: int = around.get("frames", 0) if isinstance(around, dict) else 0
    checks: dict[str, Callable[[Any], object]] = {
        "channels": are_names,
        "metadata": lambda metadata: isinstance(metadata, dict),
        "frames": lambda frames: type(frames) is int and 1 <= frames <= MOST_FRAMES,
        "global_measurements": lambda measured: type(measured) is bool,
        "frame_edges_s": lambda edges_s: (edges_s is None and frames == 1) or _are_edges(edges_s, frames),
        "surroundings": lambda around: (
            around is None or (beside in (1, frames) and _is_count(around.get("coarseness")))
        ),
        "files": lambda files: (
            set(files) == set(file_names(frames, measured, beside))
            and all(isinstance(digest, str) for digest in files.values())
        ),
    }
    optional = {"frames": frames, "global_measurements": measured, "frame_edges_s": None, "surroundings": None}
    check_keys(path, optional | description, checks, cure)
    return description, data


def _is_count(value: Any) -> bool:
    return type(value) is int and value >= 1


def _are_edges(edges_s: Any, frames: int) -> bool:
    edges = np.array(edges_s, np.float64)
    return edges.shape == (frames + 1,) and bool(np.all(np.isfinite(edges)) and np.all(np.diff(edges) > 0))


SPLITS = ("train", "validation", "test")
MOST_SAMPLES = 100_000_000  # of a split: ids have eight digits, so that names sort


@dataclass(frozen=True, eq=False)
class Sample(Mapping[str, Any]):
    """A measurement and its ground truth.

    Also a mapping, by the same names, of what a batch can be made of, so that torch's ``default_collate`` makes a dict of
    tensors of several: all arrays that there are, ``extras`` as a dict of their own, and the label where there is one.

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
        surroundings: what shone beside the image, of one frame or of T; None where nothing else was simulated.

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
    surroundings: Surroundings | None = None

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
            raise InputError(
                "Sample.channels",
                f"got {names}, expected {shape[0]} different names, none that starts with {NOISELESS!r}",
            )
        if not isinstance(self.seed, int) or not isinstance(self.label, str | None):
            raise InputError("Sample.seed", f"got {self.seed!r} and label {self.label!r}, expected an int and text")
        for name, values in self.extras.items():
            if values.ndim not in (3, 4) or values.shape[:3] != frames:
                raise InputError(f"Sample.extras[{name!r}]", f"got {values.shape}, expected {frames}, or one axis more")
        _check_edges(frames[0], self.frame_edges_s)
        if (measured := self.global_measurements) is not None:
            every = (frames[0], *shape)
            _expect("global_measurements", measured, np.float32, f"{every} like measurement", measured.shape == every)
        if (around := self.surroundings) is not None and len(around.rgb) not in (1, frames[0]):
            raise InputError("Sample.surroundings", f"got {len(around.rgb)} frames, expected 1 or {frames[0]} like rgb")

    def clip(self) -> Clip:
        """Return the scene, to be simulated anew, by other cameras too; a still lasts a second.

        Its surroundings' depths, like its own, end at `FARTHEST_M`.
        """
        edges_s = np.array([0.0, 1.0]) if self.frame_edges_s is None else self.frame_edges_s
        around = self.surroundings
        return Clip(self.rgb, self.depth_m, self.valid, edges_s, self.label, extras=self.extras, surroundings=around)

    def __getitem__(self, name: str) -> Any:
        """Return the attribute of a name that `_IN_BATCHES` lists, where the sample has it."""
        value = getattr(self, name) if name in _IN_BATCHES else None
        if value is None or (name == "extras" and not value):
            raise KeyError(name)
        return value

    def __iter__(self) -> Iterator[str]:
        return (name for name in _IN_BATCHES if name in self)

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def __eq__(self, other: object) -> bool:
        """Whether it is the same object: mappings would compare their arrays, whose truth is ambiguous."""
        return self is other

    def __hash__(self) -> int:
        return id(self)


_IN_BATCHES = (
    "measurement",
    "noiseless",
    "rgb",
    "depth_m",
    "valid",
    "label",
    "extras",
    "frame_edges_s",
    "global_measurements",
)


@dataclass(frozen=True, slots=True)
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
    if not 0 <= index < MOST_SAMPLES:
        raise InputError("index", f"expected 0 to {MOST_SAMPLES - 1}, got {index}")
    return f"s{index:08d}"


def sample_index(identifier: str) -> int:
    """Return the number in an id.

    Example:
        >>> sample_index("s00000012")
        12
    """
    digits = identifier[1:]
    if identifier[:1] != "s" or len(digits) != 8 or not (digits.isascii() and digits.isdigit()):
        raise InputError("identifier", f"expected one like s00000012, got {identifier!r}")
    return int(digits)


def sample_folder(root: Place, split: str, index: int) -> Place:
    """Return the folder of a sample; at most a thousand samples share a parent.

    Example:
        >>> sample_folder(Path("out"), "train", 12_345).as_posix()
        'out/train/0012/s00012345'
    """
    if split not in SPLITS:
        raise InputError("split", f"expected one of {', '.join(SPLITS)}, got {split!r}")
    return root / split / f"{index // 1000:04d}" / sample_id(index)


def stored_folder(root: Place, split: str, identifier: str) -> Place:
    """Return the folder of a sample to read it from.

    Raises:
        InputError: neither a split nor an id, or a link on the way, or in place of the frames' folder.
    """
    folder = sample_folder(root, split, sample_index(identifier))
    for path in (folder.parent.parent, folder.parent, folder, folder / FRAMES):
        refuse_link(path)
    return folder


def write_sample(root: Place | str, split: str, index: int, sample: Sample) -> SampleRecord:
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
    folder = sample_folder(place(root), split, index)
    description = _describe(sample, split, index)
    with committed_folder(folder, DESCRIPTION) as temporary:
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
        raise InputError(
            f"sample {identifier}",
            f"got {frames} frames, expected at most {MOST_FRAMES}; store fewer, or only slivers (dataset.slivers)",
        )
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
    if (around := sample.surroundings) is not None:
        description["surroundings"] = {"frames": len(around.rgb), "coarseness": around.coarseness}
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
    if (around := sample.surroundings) is not None:
        beside = len(around.rgb)
        for frame, (rgb, depth_m) in enumerate(zip(around.rgb, around.depth_m, strict=True)):
            light = dict(zip("RGB", np.moveaxis(rgb, -1, 0), strict=True))
            yield surroundings_file(frame, beside), frame if beside > 1 else None, light | {"Z": depth_m}


def _check_edges(frames: int, edges_s: NDArray[np.float64] | None) -> None:
    if edges_s is None and frames > 1:
        raise InputError("Sample.frame_edges_s", f"got None, expected the {frames + 1} edges of {frames} frames")
    if edges_s is not None:
        _expect("frame_edges_s", edges_s, np.float64, f"({frames + 1},)", edges_s.shape == (frames + 1,))
        if not np.all(np.isfinite(edges_s)) or not np.all(np.diff(edges_s) > 0):
            raise InputError("Sample.frame_edges_s", f"expected finite and increasing seconds, got {edges_s.tolist()}")


def _expect(name: str, values: NDArray[Any], kind: type, wanted: str, fits: bool) -> None:
    if not fits or values.dtype != kind:
        raise InputError(f"Sample.{name}", f"expected {np.dtype(kind)} {wanted}, got {values.dtype} {values.shape}")


class SceneFrame(NamedTuple):
    """What was there in one frame: ``Sample``'s fields of the same names without their first axis."""

    rgb: NDArray[np.float32]
    depth_m: NDArray[np.float32]
    valid: NDArray[np.bool_]
    extras: dict[str, NDArray[Any]]


class StoredSample:
    """A sample on disk; every file is read, and checked against ``sample.json``, when it is asked for.

    Attributes:
        folder: the sample's folder.
        description: the content of ``sample.json``.
        channels: one name per measurement channel.
        label: class name, or None.
        frames: how many frames the ground truth has.
        frame_edges_s: see ``Sample``.
        has_global_measurements: whether there is one for each frame.
    """

    def __init__(
        self, folder: Place | str, description: dict[str, Any] | None = None, files: Mapping[str, bytes] | None = None
    ) -> None:
        """Read ``sample.json``.

        Args:
            folder: the sample's folder.
            description: what `read_description` gave, where it was read already.
            files: the content of the EXR files by name, where they were read already; ``folder`` only names them then.

        Raises:
            InputError: no sample, or a damaged ``sample.json``.
        """
        self.folder = place(folder)
        self.description = read_description(self.folder)[0] if description is None else description
        self.channels: tuple[str, ...] = tuple(self.description["channels"])
        self.label: str | None = self.description["label"]
        self.frames: int = self.description.get("frames", 1)
        edges_s = self.description.get("frame_edges_s")
        self.frame_edges_s = None if edges_s is None else np.array(edges_s, np.float64)
        self.has_global_measurements: bool = self.description.get("global_measurements", False)
        self._files = files

    def measurement(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the measurement and the same before noise, ``(C, H, W)`` each.

        Raises:
            InputError: the file is missing, damaged, or belongs to another sample; it is named.
        """
        expected = [*self.channels, *(NOISELESS + name for name in self.channels)]
        planes = self._read(MEASUREMENT, None, expected)
        return self._stacked(planes), self._stacked(planes, NOISELESS)

    def frame(self, number: int) -> SceneFrame:
        """Return what was there in a frame, 0 to ``frames - 1``.

        Raises:
            InputError: the file is missing, damaged, or belongs elsewhere; it is named.
        """
        layout = self.description.get("extras", {})
        own = number if self.frames > 1 else None
        planes = self._read(truth_file(number, self.frames), own, [*TRUTH, *layout_channels(layout)])
        rgb = np.stack([planes[name] for name in "RGB"], axis=-1)
        return SceneFrame(rgb, planes["Z"], planes["valid"] != 0, frame_extras(planes, layout))

    def global_measurement(self, number: int) -> NDArray[np.float32]:
        """Return what a global shutter would have measured of a frame, ``(C, H, W)``.

        Raises:
            InputError: the sample has none, or the file is missing, damaged, or belongs elsewhere; it is named.
        """
        if not self.has_global_measurements:
            raise InputError(self.folder, "has no global measurements; make it with dataset.global_measurements=true")
        return self._stacked(self._read(global_file(number), number, list(self.channels)))

    def surroundings(self) -> Surroundings | None:
        """Return what shone beside the image; None where nothing else was simulated.

        Raises:
            InputError: a file is missing, damaged, of no use, or belongs elsewhere; it is named.
        """
        described = self.description.get("surroundings")
        if described is None:
            return None
        frames, found = described["frames"], []
        for number in range(frames):
            name = surroundings_file(number, frames)
            planes = self._read(name, number if frames > 1 else None, [*"RGB", "Z"])
            found.append((np.stack([planes[channel] for channel in "RGB"], axis=-1), planes["Z"]))
        light, depths_m = (np.stack(values) for values in zip(*found, strict=True))
        try:
            return Surroundings(light, depths_m, described["coarseness"])
        except InputError as error:
            raise InputError(self.folder / surroundings_file(0, frames), f"{error}; make the sample again") from error

    def sample(self) -> Sample:
        """Return all of the sample.

        Raises:
            InputError: a file is missing, damaged, of no use, or belongs elsewhere; it is named.
        """
        self._check_no_more_frames()
        measurement, noiseless = self.measurement()
        frames = [self.frame(number) for number in range(self.frames)]
        measured = None
        if self.has_global_measurements:
            measured = np.stack([self.global_measurement(number) for number in range(self.frames)])
        return Sample(
            measurement=measurement,
            noiseless=noiseless,
            rgb=np.stack([frame.rgb for frame in frames]),
            depth_m=np.stack([frame.depth_m for frame in frames]),
            valid=np.stack([frame.valid for frame in frames]),
            seed=self.description["seed"],
            label=self.label,
            channels=self.channels,
            metadata=self.description["metadata"],
            extras={name: np.stack([frame.extras[name] for frame in frames]) for name in frames[0].extras},
            frame_edges_s=self.frame_edges_s,
            global_measurements=measured,
            surroundings=self.surroundings(),
        )

    def _stacked(self, planes: dict[str, NDArray[np.float32]], prefix: str = "") -> NDArray[np.float32]:
        return np.stack([planes[prefix + name] for name in self.channels])

    def _read(self, name: str, frame: int | None, expected: list[str]) -> dict[str, NDArray[np.float32]]:
        path = self.folder / name
        data = read_limited(path, "an OpenEXR file", MAX_FILE_BYTES) if self._files is None else self._files[name]
        planes, metadata = decode_exr(data, path, require_checksums=True)
        wanted = file_metadata(self.description, frame)
        if metadata != wanted:
            what = f"does not belong to the {DESCRIPTION} beside it: their metadata differ"
            if metadata | {"frame": frame} == wanted:
                what = f"holds frame {metadata.get('frame')} of this sample, not frame {frame}"
            raise InputError(path, f"{what} (mixed-up or edited files)")
        if sorted(planes) != sorted(expected):
            raise InputError(path, f"expected the channels {sorted(expected)}, got {sorted(planes)}")
        return planes

    def _check_no_more_frames(self) -> None:
        """Refuse frames beyond those described: whoever lists the folder would take them for this sample's."""
        folder = self.folder / FRAMES
        if self.frames == 1 or not folder.is_dir():
            return
        names = [
            path.name
            for path in folder.iterdir()
            if re.fullmatch(r"(ground_truth|global|surroundings)\.\d+\.exr", path.name)
        ]
        unknown = sorted(f"{FRAMES}/{name}" for name in names if f"{FRAMES}/{name}" not in self.description["files"])
        if unknown:
            raise InputError(self.folder / unknown[0], f"not one of this sample's {self.frames} frames; remove it")
