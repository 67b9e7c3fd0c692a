"""Checks that ``dataset.json`` agrees with itself: what was hashed, the configuration and the recorded shutter.

The shutter is built from the configuration's numbers; a file or function of row windows is not looked at.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from simulator.camera.shutter import Shutter
from simulator.camera.shutter_record import shutter_from_record, shutter_record
from simulator.dataset.dataset_info import FILE, DatasetInfo
from simulator.dataset.fingerprint import deciding, difference, hash_parts
from simulator.errors import InputError
from simulator.io.json import plain

_CURE = "restore it from a copy"
_SECONDS = {"exposure_ms": ("exposure_s", 1e-3), "line_time_us": ("line_time_s", 1e-6)}
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
            msg = f"got {rows} physical rows (sensor_shape x binning), expected at most {_MOST_ROWS}"
            raise InputError(msg)
        shutter.duration_s(info.sensor_shape[0])
    except InputError as error:
        text = str(error).removeprefix(f"{FILE}: time.shutter: ")
        return None, [f"{FILE}: time.shutter: {text}; {_CURE}"]
    try:
        expected = _of_configuration(info.config)
    except (InputError, KeyError, TypeError, ValueError, AttributeError):
        return shutter, [f"{FILE}: config.camera.shutter: got what this version does not know as a shutter; {_CURE}"]
    recorded = shutter_record(shutter)
    recorded.pop("table_s", None)  # of a file or function, which may be gone
    lines = difference(expected, recorded)
    text = ", ".join(lines.splitlines())
    return shutter, [f"{FILE}: time.shutter is not what config says ({text}); {_CURE}"] if text else []


def _of_configuration(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return the record of the shutter that a configuration asks for; of row windows only their kind and the binning.

    From plain values: reading a data set imports neither the schema nor what it names.

    Raises:
        InputError: the configuration has no shutter of a known kind.
        KeyError: a value is missing.
        TypeError, ValueError, AttributeError: a value is no number, or a section no mapping.
    """
    camera = config["camera"]
    chosen, binning = dict(camera["shutter"]), camera.get("sensor", {}).get("binning", 1)
    if chosen["type"] == "windows":
        return {"type": "windows", "binning": binning}
    record = {"binning": binning}
    for name, value in chosen.items():
        field, scale = _SECONDS.get(name, (name, None))
        record[field] = value if scale is None else value * scale
    return shutter_record(shutter_from_record(record))
