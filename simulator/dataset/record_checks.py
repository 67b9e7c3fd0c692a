"""Checks that ``dataset.json`` agrees with itself: what was hashed, the configuration and the recorded shutter.

The shutter is built from the configuration's numbers; a file or function of row windows is not looked at.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import TypeAdapter, ValidationError

from simulator.assemble.shutter import timed_shutter
from simulator.camera.shutter import Shutter
from simulator.camera.shutter_record import shutter_record
from simulator.config.shutter import RowWindows, ShutterConfig
from simulator.dataset.dataset_info import FILE, DatasetInfo
from simulator.dataset.fingerprint import deciding, difference, hash_parts
from simulator.dataset.plain import plain
from simulator.errors import InputError

_CURE = "restore it from a copy"


def check_fingerprint(info: DatasetInfo) -> list[str]:
    """Return a line if the fingerprint is not that of its parts, and one per value in which they and ``config`` differ."""
    try:
        found = hash_parts(info.fingerprint_parts)
        config = plain(deciding(info.config), "config")
    except InputError as error:
        return [f"{FILE}: {error}; {_CURE}"]
    problems = []
    if found != info.fingerprint:
        problems.append(f"{FILE}: fingerprint is {info.fingerprint[:12]}, but its parts make {found[:12]}; {_CURE}")
    lines = difference({"config": info.fingerprint_parts.get("config")}, {"config": config}).splitlines()
    return problems + [f"{FILE}: config is not what fingerprint_parts holds: {line}; {_CURE}" for line in lines]


def check_shutter(info: DatasetInfo) -> tuple[Shutter | None, list[str]]:
    """Return the recorded shutter, None where there is none that can be used, and a line per fault of it."""
    try:
        shutter = info.shutter
        if shutter is None:
            return None, []
        shutter.duration_s(info.sensor_shape[0])
    except InputError as error:
        text = str(error).removeprefix(f"{FILE}: time.shutter: ")
        return None, [f"{FILE}: time.shutter: {text}; {_CURE}"]
    try:
        expected = _of_configuration(info.config)
    except (ValidationError, InputError):
        return shutter, [f"{FILE}: config.camera.shutter: got what this version does not know as a shutter; {_CURE}"]
    recorded = shutter_record(shutter)
    recorded.pop("table_s", None)  # of a file or function, which may be gone
    lines = difference(expected, recorded)
    text = ", ".join(lines.splitlines())
    return shutter, [f"{FILE}: time.shutter is not what config says ({text}); {_CURE}"] if text else []


def _of_configuration(config: Mapping[str, Any]) -> dict[str, Any]:
    """Return the record of the shutter that a configuration asks for; of row windows only their kind and the binning.

    Raises:
        ValidationError: the configuration has no shutter of a known kind.
        InputError: the sensor's binning is no number of rows.
    """
    camera = config.get("camera")
    camera = camera if isinstance(camera, Mapping) else {}
    sensor = camera.get("sensor")
    binning = sensor.get("binning", 1) if isinstance(sensor, Mapping) else 1
    chosen = TypeAdapter(ShutterConfig).validate_python(camera.get("shutter"))
    if isinstance(chosen, RowWindows):
        return {"type": "windows", "binning": binning}
    return shutter_record(timed_shutter(chosen, binning))
