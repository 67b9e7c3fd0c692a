"""dataset.json: what a data set is, how it was made, how big its samples are; and whether it agrees with itself."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.camera.shutter import KINDS, Shutter, shutter_from_record, shutter_record
from simulator.dataset.fingerprint import deciding, difference, hash_parts
from simulator.dataset.sample import MOST_SAMPLES, SPLITS
from simulator.errors import InputError
from simulator.io.exr import MAX_VALUES
from simulator.io.files import read_errors, read_limited, refuse_link, write_atomic
from simulator.io.json import parse_json, plain, readable_json
from simulator.io.store import Place, place
from simulator.settings import fields_from
from simulator.text import show

FILE = "dataset.json"
EXPORT = "export.json"
"""In a folder that holds an export of a data set, beside a copy of ``FILE`` or not."""
_SHUTTER = f"{FILE}: time.shutter"
FORMAT = "flatlight-dataset"
FORMAT_VERSION = 1


@dataclass(frozen=True)
class DatasetInfo:
    """The content of ``dataset.json``.

    Attributes:
        name: the configuration's name.
        config: the whole configuration; infinite numbers are the text ``inf`` on disk.
        fingerprint: SHA-256 in hexadecimal of what decides the samples' bytes.
        fingerprint_parts: what was hashed, for readable comparisons.
        versions: package versions.
        backend: the renderer's variant.
        exposure: the one scale from irradiance to DN / 2^bits, ``bit_depth``, and how it was found.
        counts: samples wanted per split.
        scene_shape: rows, columns of the ground truth.
        sensor_shape: rows, columns of the measurement.
        channels: names of the measurement's channels.
        scene_to_camera: ``matrix``, the rows that take the ground truth's linear sRGB to the channels, and its origin.
        field_of_view: how much of the light from each direction counts (see `simulator.camera.field`), ``margin``: rows and
            columns beside the image from which light was simulated, ``light_from_outside``: share of a uniform half space's
            light that comes from beyond them.
        time: how the measurements were exposed and taken apart: ``shutter`` (see `simulator.camera.shutter`),
            ``slivers`` per sample (None where every frame is one), and what else the job recorded.

    Raises:
        InputError: a field has the wrong type or a senseless value.
    """

    name: str
    config: dict[str, Any]
    fingerprint: str
    fingerprint_parts: dict[str, Any]
    versions: dict[str, str]
    backend: str
    exposure: dict[str, Any]
    counts: dict[str, int]
    scene_shape: tuple[int, int]
    sensor_shape: tuple[int, int]
    channels: tuple[str, ...]
    scene_to_camera: dict[str, Any] = field(default_factory=dict)
    field_of_view: dict[str, Any] = field(default_factory=dict)
    time: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name in ("name", "fingerprint", "backend"):
            _expect(name, isinstance(getattr(self, name), str), "text", getattr(self, name))
        dicts = (
            "config",
            "fingerprint_parts",
            "versions",
            "exposure",
            "counts",
            "scene_to_camera",
            "field_of_view",
            "time",
        )
        for name in dicts:
            _expect(name, isinstance(getattr(self, name), dict), "a dict", getattr(self, name))
        hexadecimal = len(self.fingerprint) == 64 and set(self.fingerprint) <= set("0123456789abcdef")
        _expect("fingerprint", hexadecimal, "64 hexadecimal digits", self.fingerprint)
        counts_fit = all(
            split in SPLITS and _whole(count, 0) and count <= MOST_SAMPLES for split, count in self.counts.items()
        )
        _expect("counts", counts_fit, f"whole numbers up to {MOST_SAMPLES} for {', '.join(SPLITS)}", self.counts)
        for name in ("scene_shape", "sensor_shape"):
            shape = getattr(self, name)
            fits = isinstance(shape, tuple) and len(shape) == 2 and all(_whole(size, 1) for size in shape)
            _expect(name, fits and math.prod(shape) <= MAX_VALUES, f"two sizes, {MAX_VALUES} pixels at most", shape)
        texts = isinstance(self.channels, tuple) and all(isinstance(name, str) for name in self.channels)
        _expect("channels", texts and len(self.channels) > 0, "a tuple of names", self.channels)

    @property
    def unit(self) -> str:
        """The unit of measurements, in words."""
        bits = self.exposure.get("bit_depth")
        return f"DN / 2^{bits}" if _whole(bits, 1) else "DN / 2^bits"

    @property
    def colour_matrix(self) -> NDArray[np.float64]:
        """The rows ``(C, 3)`` that take linear sRGB to the channels.

        Raises:
            InputError: none is recorded, or a damaged one.
        """
        rows = self.scene_to_camera.get("matrix")
        try:
            matrix = np.array(rows, np.float64)
        except (TypeError, ValueError, OverflowError):
            matrix = np.empty(0)
        fits = matrix.shape == (len(self.channels), 3) and bool(np.all(np.isfinite(matrix)))
        _expect(f"{FILE}: scene_to_camera.matrix", fits, "three finite numbers for each channel", rows)
        return matrix

    @property
    def shutter(self) -> Shutter | None:
        """The shutter through which the measurements were exposed; None where none is recorded.

        Raises:
            InputError: a damaged record, or one of another version's.
        """
        record = self.time.get("shutter")
        try:
            return None if record is None else shutter_from_record(record)
        except InputError as error:
            raise InputError(_SHUTTER, str(error)) from error


def write_info(root: Place | str, info: DatasetInfo) -> None:
    """Write ``dataset.json`` into the folder ``root``, whole or not at all.

    Raises:
        StorageError: the folder is missing or protected, or the disk is full.
    """
    content = {"format": FORMAT, "format_version": FORMAT_VERSION} | asdict(info)
    write_atomic(place(root) / FILE, readable_json(content))


def read_info(root: Place | str) -> DatasetInfo:
    """Read ``dataset.json`` from the folder ``root``.

    Raises:
        InputError: no such folder, not a data set, an export, one with links in it, of a newer version, or a damaged file.
    """
    root = place(root)
    path = root / FILE
    with read_errors(root):
        if not root.is_dir():
            raise InputError(root, "no such folder; give the folder that `flatlight generate` wrote (dataset.output)")
        if (root / EXPORT).is_file():
            raise InputError(
                root, f"an export ({EXPORT}), whose format other tools read; give the data set that it was made from"
            )
        if not path.is_file():
            raise InputError(root, f"not a data set: it has no {FILE}; give the folder that `flatlight generate` wrote")
        for one in sorted(root.iterdir()) if isinstance(root, Path) else ():
            refuse_link(one)
    data = read_limited(path, "the description of a data set")
    try:
        content = parse_json(data)
    except ValueError as error:
        raise InputError(path, f"unreadable or damaged ({error}); restore it from a copy") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise InputError(path, f"does not describe a data set of ours: its format must be {FORMAT!r}")
    if content.get("format_version") != FORMAT_VERSION:
        version = content.get("format_version")
        raise InputError(
            path, f"has format version {version!r}, this package reads {FORMAT_VERSION}; install a matching flatlight"
        )
    optional = {entry.name for entry in fields(DatasetInfo) if entry.default_factory is not MISSING}
    missing = [entry.name for entry in fields(DatasetInfo) if entry.name not in content.keys() | optional]
    if missing:
        raise InputError(path, f"lacks {', '.join(missing)}; restore it from a copy")
    values = {entry.name: content[entry.name] for entry in fields(DatasetInfo) if entry.name in content}
    for name in ("scene_shape", "sensor_shape", "channels"):
        values[name] = tuple(values[name]) if isinstance(values[name], list) else values[name]
    if isinstance(values["counts"], dict):  # JSON keys lie sorted; train comes first everywhere else
        counts = values["counts"]
        values["counts"] = {split: counts[split] for split in SPLITS if split in counts} | counts
    try:
        return DatasetInfo(**values)
    except InputError as error:
        raise InputError(path, str(error)) from error


def _whole(value: object, least: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= least


def _expect(name: str, fits: bool, wanted: str, value: object) -> None:
    if not fits:
        raise InputError(name, f"expected {wanted}, got {show(value)}")


_CURE = "restore it from a copy"
_MOST_ROWS = 1 << 20  # of a sensor, physical: more are a damaged number


def check_fingerprint(info: DatasetInfo) -> list[str]:
    """Return a line if the fingerprint is not that of its parts, and one per value in which they and ``config`` differ."""
    try:
        found = hash_parts(info.fingerprint_parts)
        # Of both alike: which settings decide nothing may have grown since the data set was begun.
        hashed, config = (
            plain(deciding(values), "config") for values in (info.fingerprint_parts.get("config", {}), info.config)
        )
    except InputError as error:
        return [f"{FILE}: {error}; {_CURE}"]
    problems = []
    if found != info.fingerprint:
        problems.append(f"{FILE}: fingerprint is {info.fingerprint[:12]}, but its parts make {found[:12]}; {_CURE}")
    lines = difference({"config": hashed}, {"config": config}).splitlines()
    return problems + [f"{FILE}: config is not what fingerprint_parts holds: {line}; {_CURE}" for line in lines]


def check_shutter(info: DatasetInfo) -> tuple[Shutter | None, list[str]]:
    """Return the recorded shutter, None where there is none that can be used, and a line per fault of it."""
    try:
        shutter = info.shutter
        if shutter is None:
            return None, []
        rows = info.sensor_shape[0] * shutter.binning
        if rows > _MOST_ROWS:
            raise InputError(
                _SHUTTER, f"got {rows} physical rows (sensor_shape x binning), expected at most {_MOST_ROWS}"
            )
        shutter.duration_s(info.sensor_shape[0])
    except InputError as error:
        return None, [f"{_SHUTTER}: {error.reason}; {_CURE}"]
    try:
        expected = _of_configuration(info.config)
    except (InputError, KeyError, TypeError, ValueError, AttributeError):
        return shutter, [f"{FILE}: config.camera.shutter: got what this version does not know as a shutter; {_CURE}"]
    recorded = shutter_record(shutter)
    recorded.pop("table_s", None)  # of a file or function, which may be gone
    lines = difference(expected, recorded)
    text = ", ".join(lines.splitlines())
    return shutter, [f"{_SHUTTER} is not what config says ({text}); {_CURE}"] if text else []


def _of_configuration(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return the record of the shutter that a configuration asks for; of row windows only their kind and the binning.

    From plain values: reading a data set imports neither the schema nor what it names.

    Raises:
        InputError: the configuration has no shutter of a known kind.
        KeyError: a value is missing.
        TypeError, ValueError, AttributeError: a value is not a number, or a section not a mapping.
    """
    camera = config["camera"]
    chosen, binning = dict(camera["shutter"]), camera.get("sensor", {}).get("binning", 1)
    if chosen["type"] == "windows":
        return {"type": "windows", "binning": binning}
    record = fields_from(KINDS[chosen["type"]], chosen) | {"binning": binning}
    return shutter_record(shutter_from_record(record))
