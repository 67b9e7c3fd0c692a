"""A shutter as plain JSON values and back, exactly: a data set tells its readers how its measurements were exposed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from simulator.camera.shutter import DualRollingShutter, GlobalShutter, RollingShutter, RowShutter, Shutter
from simulator.errors import InputError

_KINDS: dict[str, type] = {
    "global": GlobalShutter,
    "rolling": RollingShutter,
    "dual_rolling": DualRollingShutter,
    "windows": RowShutter,
}


def shutter_record(shutter: Shutter) -> dict[str, Any]:
    """Return a shutter's kind, as the configuration calls it, and its fields; JSON keeps them exactly.

    Raises:
        InputError: a shutter of another class.

    Example:
        >>> shutter_record(GlobalShutter(0.01))
        {'type': 'global', 'exposure_s': 0.01, 'binning': 1}
    """
    for kind, known in _KINDS.items():
        if type(shutter) is known:
            values = {entry.name: getattr(shutter, entry.name) for entry in fields(known)}
            return {"type": kind} | {name: _plain(value) for name, value in values.items()}
    msg = (
        f"shutter: got a {type(shutter).__name__}, which has no record; expected one of simulator.camera.shutter; put its "
        "windows into a RowShutter(shutter.physical_windows_s(rows))"
    )
    raise InputError(msg)


def shutter_from_record(record: object) -> Shutter:
    """Return the shutter of a record that somebody else may have written.

    Raises:
        InputError: an unknown kind, missing or foreign fields, or senseless values.

    Example:
        >>> shutter_from_record({"type": "global", "exposure_s": 0.01, "binning": 1})
        GlobalShutter(exposure_s=0.01, binning=1)
    """
    values = dict(record) if isinstance(record, Mapping) else {}
    kind = values.pop("type", None)
    known = _KINDS.get(kind) if isinstance(kind, str) else None
    if known is None:
        shown = repr(kind) if isinstance(record, Mapping) else type(record).__name__
        msg = (
            f"shutter record: got {shown}, expected a type of {', '.join(_KINDS)}; another version may have written it"
        )
        raise InputError(msg)
    wanted = [entry.name for entry in fields(known)]
    if set(values) != set(wanted):
        msg = f"shutter record: got the fields {sorted(map(str, values))} for {kind!r}, expected {sorted(wanted)}"
        raise InputError(msg)
    for name, value in values.items():
        values[name] = _read(name, value)
    return known(**values)


def _plain(value: Any) -> Any:
    """Return a number as Python's own, which JSON can hold, and an array as lists."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def _read(name: str, value: Any) -> Any:
    """Return a field's value as its class wants it; it checks the range itself."""
    whole = isinstance(value, int) and not isinstance(value, bool) and abs(value) <= 2**53  # a float holds it
    if name == "table_s":
        try:
            return np.array(value, np.float64)
        except (TypeError, ValueError) as error:
            msg = f"shutter record: table_s must hold opening and closing of every row in seconds ({error})"
            raise InputError(msg) from error
    fits = whole if name == "binning" else whole or isinstance(value, float)
    if name in ("direction", "order"):
        fits = isinstance(value, str)
    if not fits:
        msg = (
            f"shutter record: {name} is {value!r}; expected {'text' if name in ('direction', 'order') else 'a number'}"
        )
        raise InputError(msg)
    return value
