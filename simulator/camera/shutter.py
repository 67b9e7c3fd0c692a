"""Shutters: when every sensor row is open, and which share of each frame interval it sees; tables and records of them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.measurements import read_npy
from simulator.io.tables import read_number_table
from simulator.settings import NO_KEY, Quantity, Settings

ROUNDING = 1e-9
"""Share of a capture's time that rounding of its edges may take."""
_EXPECTED = "opening and closing of every row, seconds (rows, 2)"


class Shutter(Settings, ABC):
    """A shutter: the window of time in which each row is open.

    Attributes:
        binning: physical rows that a stored row averages.
    """

    binning: int

    @abstractmethod
    def physical_windows_s(self, rows: int) -> NDArray[np.float64]:
        """Return opening and closing of each of so many physical rows, seconds ``(rows, 2)``, top first."""

    def windows_s(self, rows: int) -> NDArray[np.float64]:
        """Return opening and closing of the physical rows behind each of so many stored rows, ``(rows, binning, 2)``."""
        return self.physical_windows_s(rows * self.binning).reshape(rows, self.binning, 2)

    def exposures_s(self, rows: int) -> NDArray[np.float64]:
        """Return the exposure time of each stored row (the mean of its physical rows'), seconds ``(rows,)``."""
        windows = self.windows_s(rows)
        return (windows[..., 1] - windows[..., 0]).mean(axis=1)

    def duration_s(self, rows: int) -> float:
        """Return how long a capture of so many stored rows lasts, from time zero until its last row closes, seconds."""
        return self.span_s(rows)[1]

    def span_s(self, rows: int) -> tuple[float, float]:
        """Return when the first of so many stored rows opens and the last one closes, seconds after the capture's start."""
        windows = self.windows_s(rows)
        return float(windows[..., 0].min()), float(windows[..., 1].max())

    def check_covered(self, rows: int, frame_edges_s: NDArray[np.float64]) -> None:
        """Refuse a clip during which not all of the capture of so many stored rows happens.

        Args:
            rows: stored rows.
            frame_edges_s: ``(T + 1,)`` seconds, increasing.

        Raises:
            InputError: the clip begins after the first row opens or ends before the last one closes, by more than rounding.
        """
        (first, last), begin, end = self.span_s(rows), float(frame_edges_s[0]), float(frame_edges_s[-1])
        if begin > first + ROUNDING * last or end < last * (1 - ROUNDING):
            raise InputError(
                "frame_edges_s",
                f"the clip lasts from {begin:.9g} to {end:.9g} s, but the shutter is open from {first:.9g} to "
                f"{last:.9g} s; use more frames, fewer per second, or a faster shutter",
            )

    def separable_frames(self, rows: int) -> int:
        """Return how many frames one capture of so many stored rows can tell apart.

        The most stored rows of which no two are open at the same time, each from its first physical row's opening to its last
        one's closing: a frame as long as that is then seen by rows that see nothing of the others. Shorter frames mix in
        every row; they come apart only as far as neighbouring rows differ (line by line, at most as many as there are
        different windows) and as the noise allows. A global shutter separates 1.
        """
        windows = self.windows_s(rows)
        spans = np.stack([windows[..., 0].min(axis=1), windows[..., 1].max(axis=1)], axis=-1)
        count, free_from = 0, -np.inf
        # Always taking the row that closes first is optimal: the textbook's interval scheduling.
        for opening, closing in spans[np.argsort(spans[:, 1], kind="stable")]:
            if opening >= free_from - 1e-9 * (closing - opening):
                count, free_from = count + 1, closing
        return count

    def weights(self, rows: int, frame_edges_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return S ``(T, rows)``: the share, 0..1, of each frame interval that lies inside each row's window.

        With dt the frame durations, sum_t dt_t S[t, r] is the exposure time of row r.

        Args:
            rows: stored rows in the physical sensor's order, top first; each is the mean of its ``binning`` physical rows.
            frame_edges_s: ``(T + 1,)`` increasing seconds; must cover the capture.

        Raises:
            InputError: when the clip does not last from the first row's opening to the last one's closing, or its edges do
                not increase.
        """
        edges = np.asarray(frame_edges_s, np.float64)
        if edges.ndim != 1 or len(edges) < 2 or not np.all(np.diff(edges) > 0):
            raise InputError(
                "frame_edges_s", f"got shape {edges.shape}, expected at least two strictly increasing times in seconds"
            )
        self.check_covered(rows, edges)
        windows, (first, last) = self.windows_s(rows), self.span_s(rows)
        reached = np.concatenate([[min(edges[0], first)], edges[1:-1], [max(edges[-1], last)]])
        open_until = np.clip(reached[:, None, None], windows[..., 0], windows[..., 1]).mean(axis=-1)
        return np.clip(np.diff(open_until, axis=0) / np.diff(edges)[:, None], 0, 1)


Exposure = Annotated[
    float, Quantity(1e-4, 1e5, "ms", key="exposure_ms", default=10.0, below="without exposure time there is no light")
]
LineTime = Annotated[
    float, Quantity(1e-3, 1e6, "us", key="line_time_us", below="rows that open together are a global shutter")
]


@dataclass(frozen=True)
class GlobalShutter(Shutter):
    """All rows are exposed together, from time zero.

    Attributes:
        exposure_s: exposure time.
        binning: physical rows that a stored row averages.
    """

    exposure_s: Exposure
    binning: int = field(default=1, metadata=NO_KEY)
    type: Literal["global"] = field(default="global", repr=False)

    def __post_init__(self) -> None:
        _check_times(self.binning, exposure_s=self.exposure_s)

    def physical_windows_s(self, rows: int) -> NDArray[np.float64]:
        """Return ``(rows, 2)`` seconds; see `Shutter`."""
        return _windows(np.zeros(rows), self.exposure_s)


@dataclass(frozen=True)
class RollingShutter(Shutter):
    """One row after another: row r opens at r times the line time.

    Attributes:
        exposure_s: exposure time of each row.
        line_time_s: time from one physical row's opening to the next.
        direction: ``down`` begins with the physical sensor's top row, ``up`` with its bottom row.
        binning: physical rows that a stored row averages.
    """

    exposure_s: Exposure
    line_time_s: LineTime
    direction: Literal["down", "up"] = "down"
    binning: int = field(default=1, metadata=NO_KEY)
    type: Literal["rolling"] = field(default="rolling", repr=False)

    def __post_init__(self) -> None:
        _check_times(self.binning, exposure_s=self.exposure_s, line_time_s=self.line_time_s)
        _check_choice("direction", self.direction, ("down", "up"))

    def physical_windows_s(self, rows: int) -> NDArray[np.float64]:
        """Return ``(rows, 2)`` seconds; see `Shutter`."""
        lines = np.arange(rows) if self.direction == "down" else np.arange(rows)[::-1]
        return _windows(lines * self.line_time_s, self.exposure_s)


@dataclass(frozen=True)
class DualRollingShutter(Shutter):
    """Two halves, read at once: two rows, mirrored at the sensor's middle, open together.

    Attributes:
        exposure_s: exposure time of each row.
        line_time_s: time from one pair of physical rows to the next.
        order: ``outside_in`` begins with the top and bottom rows (pco.edge), ``centre_out`` with the middle (Zyla).
        binning: physical rows that a stored row averages.
    """

    exposure_s: Exposure
    line_time_s: LineTime
    order: Literal["outside_in", "centre_out"] = "outside_in"
    binning: int = field(default=1, metadata=NO_KEY)
    type: Literal["dual_rolling"] = field(default="dual_rolling", repr=False)

    def __post_init__(self) -> None:
        _check_times(self.binning, exposure_s=self.exposure_s, line_time_s=self.line_time_s)
        _check_choice("order", self.order, ("outside_in", "centre_out"))

    def physical_windows_s(self, rows: int) -> NDArray[np.float64]:
        """Return ``(rows, 2)`` seconds; see `Shutter`. Of an odd number, the middle row has no partner."""
        lines = np.minimum(np.arange(rows), np.arange(rows)[::-1])
        if self.order == "centre_out":
            lines = lines.max() - lines
        return _windows(lines * self.line_time_s, self.exposure_s)


@dataclass(frozen=True, eq=False)
class RowShutter(Shutter):
    """Any shutter whose rows have windows of their own: global reset, interlaced, coded exposures, a measured table.

    Attributes:
        table_s: opening and closing of every physical row, seconds ``(rows, 2)``, top first.
        binning: physical rows that a stored row averages.
    """

    table_s: NDArray[np.float64]
    binning: int = field(default=1, metadata=NO_KEY)
    type: Literal["windows"] = field(default="windows", repr=False)

    def __post_init__(self) -> None:
        _check_times(self.binning)
        table = np.asarray(self.table_s, np.float64)
        if table.ndim != 2 or table.shape[1:] != (2,) or not len(table):
            raise InputError("table_s", f"got shape {table.shape}, expected {_EXPECTED}")
        wrong = np.flatnonzero(~((table[:, 0] >= 0) & (table[:, 1] > table[:, 0]) & (table[:, 1] < np.inf)))
        if wrong.size:  # NaN is wrong too: it compares as false
            row = int(wrong[0])
            raise InputError(
                "table_s",
                f"row {row} (from 0, top first) opens at {table[row, 0]:g} s and closes at {table[row, 1]:g} s; "
                "expected 0 <= opening < closing",
            )
        object.__setattr__(self, "table_s", table)

    def physical_windows_s(self, rows: int) -> NDArray[np.float64]:
        """Return ``(rows, 2)`` seconds; see `Shutter`.

        Raises:
            InputError: the table is of another number of rows.
        """
        if rows != len(self.table_s):
            raise InputError(
                "table_s",
                f"got windows of {len(self.table_s)} rows, expected {rows}: one for each physical row of the sensor",
            )
        return self.table_s


def _windows(opening_s: NDArray[np.floating], exposure_s: float) -> NDArray[np.float64]:
    return np.stack([opening_s, opening_s + exposure_s], axis=-1).astype(np.float64)


def _check_times(binning: int, **times_s: float) -> None:
    for name, value in times_s.items():
        if not 0 < value < np.inf:
            raise InputError(name, f"got {value!r}, expected positive seconds (10 ms is 0.01)")
    if not isinstance(binning, int | np.integer) or isinstance(binning, bool) or binning < 1:
        raise InputError("binning", f"got {binning!r}, expected a whole number of physical rows from 1")


def _check_choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise InputError(name, f"got {value!r}, expected {' or '.join(map(repr, choices))}")


_UNITS_S = {"s": 1.0, "ms": 1e-3, "us": 1e-6}


def read_row_shutter(path: Path, rows: int, binning: int) -> RowShutter:
    """Return the shutter of a file, for an image of so many rows.

    Args:
        path: ``.csv``: two numbers per row, seconds or what a header says, such as ``open_ms,close_ms`` (s, ms or us).
            ``.npy``: ``(rows, 2)`` seconds.
        rows: of the image.
        binning: physical rows per row of the image.

    Raises:
        InputError: as `row_shutter`, and of a CSV as `simulator.io.tables.read_number_table`.
    """
    if path.suffix.lower() == ".csv":
        return row_shutter(_read_csv(path), rows, binning, path)
    if path.suffix.lower() != ".npy":
        raise InputError(path, "expected .csv or .npy with opening and closing of every row")
    windows = read_npy(path)
    if windows.ndim != 2 or windows.shape[1] != 2 or windows.dtype.kind not in "fiu":
        raise InputError(path, f"got {windows.dtype} {windows.shape}, expected {_EXPECTED}")
    return row_shutter(windows, rows, binning, path)


def row_shutter(windows: Any, rows: int, binning: int, source: str | Path) -> RowShutter:
    """Return the shutter of a table, ``(rows * binning, 2)`` seconds, for an image of so many rows.

    Raises:
        InputError: at ``source``, naming the row.
    """
    try:
        table = np.asarray(windows, np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(source, f"got {type(windows).__name__}, expected {_EXPECTED}: {error}") from error
    try:
        shutter = RowShutter(table, binning)
        shutter.physical_windows_s(rows * binning)
    except InputError as error:
        raise InputError(source, error.reason) from error
    return shutter


def _read_csv(path: Path) -> NDArray[np.float64]:
    table = read_number_table(path, "opening and closing", columns=2)
    if table.header is None:
        return table.values
    names = [name.lower().partition("_") for name in table.header]
    if [name for name, _, _ in names] != ["open", "close"] or any(unit not in _UNITS_S for _, _, unit in names):
        raise InputError(
            path,
            f"got the header {','.join(table.header)!r}, expected open_s,close_s (or _ms, _us); without one: seconds",
        )
    return table.values * [_UNITS_S[unit] for _, _, unit in names]


KINDS: dict[str, type[Shutter]] = {
    kind.type: kind for kind in (GlobalShutter, RollingShutter, DualRollingShutter, RowShutter)
}
"""The shutters that can be recorded, by what the configuration calls them."""


def shutter_record(shutter: Shutter) -> dict[str, Any]:
    """Return a shutter's kind, as the configuration calls it, and its fields; JSON keeps them exactly.

    Raises:
        InputError: a shutter of another class.

    Example:
        >>> shutter_record(GlobalShutter(0.01))
        {'type': 'global', 'exposure_s': 0.01, 'binning': 1}
    """
    if type(shutter) not in KINDS.values():
        raise InputError(
            "shutter",
            f"got a {type(shutter).__name__}; expected one of {', '.join(KINDS)}, such as a RowShutter of its windows",
        )
    return {name: _plain(getattr(shutter, name)) for name in ("type", *_recorded(type(shutter)))}


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
    known = KINDS.get(kind) if isinstance(kind, str) else None
    if known is None:
        shown = repr(kind) if isinstance(record, Mapping) else type(record).__name__
        raise InputError("shutter record", f"got {shown}, expected a type of {', '.join(KINDS)} (another version's?)")
    wanted = _recorded(known)
    if set(values) != set(wanted):
        raise InputError("shutter record", f"got {sorted(map(str, values))} for {kind!r}, expected {sorted(wanted)}")
    for name, value in values.items():
        values[name] = _read(name, value)
    return known(**values)


def _recorded(kind: type[Shutter]) -> list[str]:
    return [entry.name for entry in fields(kind) if entry.name != "type"]  # pyright: ignore[reportArgumentType]


def _plain(value: Any) -> Any:
    """Return a number as Python's own, which JSON can hold, and an array as lists."""
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else value


def _read(name: str, value: Any) -> Any:
    """Return a field's value as its class wants it; it checks the range itself."""
    if name == "table_s":
        try:
            return np.array(value, np.float64)
        except (TypeError, ValueError) as error:
            raise InputError("shutter record", f"table_s: expected {_EXPECTED} ({error})") from error
    is_text = name in ("direction", "order")
    whole = isinstance(value, int) and not isinstance(value, bool) and abs(value) <= 2**53  # a float holds it
    fits = isinstance(value, str) if is_text else whole or (name != "binning" and isinstance(value, float))
    if not fits:
        raise InputError("shutter record", f"{name} is {value!r}; expected {'text' if is_text else 'a number'}")
    return value
