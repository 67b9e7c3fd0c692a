"""What both benchmarks share: interleaved timing in CPU seconds and a table with ratios.

CPU seconds of one thread are less disturbed by other jobs than wall time; rounds that run every contender once, one
after another, let a slow phase of the machine hit all of them alike.
"""

from __future__ import annotations

import gc
import platform
import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import metadata
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Row:
    """One line of the table."""

    name: str
    seconds: float
    ratio: float
    error: float


def measure(contenders: Mapping[str, Callable[[], Any]], rounds: int) -> dict[str, list[float]]:
    """CPU seconds of every contender in every round, after one round that is not counted."""
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    for number in range(rounds + 1):
        for name, run in contenders.items():
            gc.collect()
            start = time.process_time()
            run()
            if number > 0:
                seconds[name].append(time.process_time() - start)
    return seconds


def rows(seconds: Mapping[str, list[float]], errors: Mapping[str, float], reference: str) -> list[Row]:
    """Median times, and the median over rounds of each contender's time as a multiple of the reference's."""
    ours = seconds[reference]
    return [
        Row(
            name,
            statistics.median(times),
            statistics.median(t / o for t, o in zip(times, ours, strict=True)),
            errors[name],
        )
        for name, times in seconds.items()
    ]


def show(title: str, table: list[Row], reference: str, error_name: str) -> None:
    """Print one table."""
    width = max(len(row.name) for row in table)
    print(f"\n{title}")
    print(f"  {'':{width}}  {'CPU s':>8}  {'x ' + reference:>12}  {error_name:>12}")
    for row in table:
        print(f"  {row.name:{width}}  {row.seconds:8.3f}  {row.ratio:12.2f}  {row.error:12.1e}")


def relative_error(found: np.ndarray, truth: np.ndarray) -> float:
    """Relative L2 distance."""
    return float(np.linalg.norm(np.asarray(found, np.float64) - truth) / np.linalg.norm(truth))


def single_threaded() -> None:
    """Let torch use one thread (scipy.fft does so by default)."""
    try:
        import torch
    except ImportError:
        return
    torch.set_num_threads(1)


def versions(*names: str) -> str:
    """``name version`` of each package, or ``name missing``."""
    found = []
    for name in names:
        try:
            found.append(f"{name} {metadata.version(name)}")
        except metadata.PackageNotFoundError:
            found.append(f"{name} missing")
    return f"Python {platform.python_version()}, " + ", ".join(found)
