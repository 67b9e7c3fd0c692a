"""What a shutter is in words and numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from simulator.camera.shutter import DualRollingShutter, GlobalShutter, RollingShutter, Shutter
from simulator.camera.slivers import frames_seen

_ORDERS = {"outside_in": "from the outside in", "centre_out": "from the centre out"}


def duration(seconds: float) -> str:
    """Return a time in the unit that suits it.

    Example:
        >>> duration(9.17e-6), duration(0.01), duration(0)
        ('9.17 µs', '10 ms', '0 ms')
    """
    if seconds and abs(seconds) < 1e-3:
        return f"{seconds * 1e6:.4g} µs"
    return f"{seconds * 1e3:.4g} ms" if seconds < 1 else f"{seconds:.4g} s"


def shutter_name(shutter: Shutter) -> str:
    """Return what kind of shutter it is."""
    if isinstance(shutter, GlobalShutter):
        return "global shutter"
    if isinstance(shutter, RollingShutter):
        return f"rolling shutter, {shutter.direction}"
    if isinstance(shutter, DualRollingShutter):
        return f"dual rolling shutter, {_ORDERS[shutter.order]}"
    return "row-by-row shutter"


def shutter_facts(
    shutter: Shutter, rows: int, scene: Mapping[str, Any], slivers: int | None = None
) -> list[tuple[str, str]]:
    """Return what is worth knowing of a shutter, as (what, value).

    Args:
        shutter: the shutter.
        rows: stored rows.
        scene: parameters of the scenes; ``frames`` and ``frames_per_second`` are compared with the shutter.
        slivers: how many are wanted; None is one per frame.
    """
    facts = [("shutter", shutter_name(shutter)), ("exposure", _exposure(shutter, rows))]
    if isinstance(shutter, RollingShutter | DualRollingShutter):
        steps = "pair of rows" if isinstance(shutter, DualRollingShutter) else "row"
        facts.append(("line time", f"{duration(shutter.line_time_s)} per physical {steps}"))
    per_row = f", each the mean of {shutter.binning} physical rows" if shutter.binning > 1 else ""
    facts += [
        ("rows", f"{rows} in the picture{per_row}"),
        ("capture", f"{duration(shutter.duration_s(rows))} until the last row closes; {_together(shutter, rows)}"),
        ("frames told apart", _separable(shutter, rows)),
    ]
    return facts + _scene_facts(shutter, rows, scene, slivers)


def _exposure(shutter: Shutter, rows: int) -> str:
    times = shutter.exposures_s(rows)
    if np.ptp(times) <= 1e-9 * times.max():
        return f"{duration(float(times[0]))} per row"
    least, mean, most = (duration(float(value)) for value in (times.min(), times.mean(), times.max()))
    return f"{least} to {most} per row, {mean} on average"


def _together(shutter: Shutter, rows: int) -> str:
    windows = shutter.windows_s(rows)
    opening, closing = float(windows[..., 0].max()), float(windows[..., 1].min())
    if opening < closing:
        return f"all rows are open from {duration(opening)} to {duration(closing)}"
    return "at no time are all rows open"


def _separable(shutter: Shutter, rows: int) -> str:
    count = shutter.separable_frames(rows)
    if isinstance(shutter, GlobalShutter):
        return "1: all rows see the same time, so that what moves only blurs"
    if count == 1:
        return "1: any two rows are open together for some time; shorter frames come apart only as far as rows differ"
    return f"{count}: so many rows are open one after another, no two together; shorter frames mix in every row"


def _slower(rate: float) -> str:
    """Return a frame rate rounded down, so that what is read off it lasts long enough."""
    scale = 10.0 ** (np.floor(np.log10(rate)) - 3)
    return f"{np.floor(rate / scale) * scale:.6g}"


def _scene_facts(shutter: Shutter, rows: int, scene: Mapping[str, Any], slivers: int | None) -> list[tuple[str, str]]:
    frames, rate = scene.get("frames"), scene.get("frames_per_second")
    if not isinstance(frames, int):
        return []
    if frames == 1:
        return [("scenes", "stand still (1 frame), as long as the shutter is open")]
    open_s = shutter.duration_s(rows)
    fastest = _slower(frames / open_s)
    if not isinstance(rate, int | float):
        return [
            ("scenes", f"{frames} frames at a rate of their own; at more than {fastest} per second they are too short")
        ]
    clips = f"{frames} frames at {rate:g} per second last {duration(frames / rate)}"
    seen = frames_seen(np.arange(int(np.ceil(open_s * rate)) + 2) / rate, shutter, rows)
    if seen.stop > frames:
        needs = f"too short, the shutter needs {seen.stop} frames, or at most {fastest} per second"
        return [("scenes", f"{clips}: {needs}")]
    which = "all" if seen == slice(0, frames) else f"frames {seen.start + 1} to {seen.stop}"
    return [("scenes", f"{clips}; the shutter sees {which}"), ("slivers", _slivers(seen.stop - seen.start, slivers))]


def _slivers(frames: int, slivers: int | None) -> str:
    even = f"{', '.join(str(number) for number in range(1, frames + 1) if frames % number == 0)} come out even"
    if slivers is None:
        return f"{frames}, one per frame seen; {even}"
    if slivers > frames or frames % slivers:
        return f"{slivers} of {frames} frames seen do not come out even; {even}"
    each = frames // slivers
    return f"{slivers} of {each} frame{'s' if each > 1 else ''} each; {even}"
