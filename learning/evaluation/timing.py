"""Seconds per scene and stage: one scene at a time, the methods by turns so that a busy machine slows all of them alike."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import torch
from torch import Tensor

from learning.method import Clock, Method


@dataclass(frozen=True)
class Times:
    """Seconds per scene of one method.

    Attributes:
        method: its name.
        stages: median over the repeats, by stage.
        total: median over the repeats of all stages together.
        fastest: least total, which other work on the machine disturbed least.
    """

    method: str
    stages: dict[str, float]
    total: float
    fastest: float

    def plain(self) -> dict[str, Any]:
        """Return the same for JSON."""
        return {"method": self.method, "stages_s": self.stages, "total_s": self.total, "fastest_s": self.fastest}


def take_times(
    methods: Sequence[Method],
    measurements: Tensor,
    repeats: int,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Times]:
    """Time methods on one device.

    Args:
        methods: ready on the measurements' device.
        measurements: ``(N, C, H, W)``; each turn takes the next one.
        repeats: turns that count, after one that does not.
        progress: called with turns done and in all.
    """
    totals: list[list[float]] = [[] for _ in methods]
    stages: list[dict[str, list[float]]] = [{} for _ in methods]
    for turn in range(repeats + 1):
        scene = measurements[turn % len(measurements)][None]
        for which, method in enumerate(methods):
            clock = Clock(scene.device)
            method.reconstruct(scene, clock)
            if turn:
                totals[which].append(sum(clock.seconds.values()))
                for stage, seconds in clock.seconds.items():
                    stages[which].setdefault(stage, []).append(seconds)
        progress(turn + 1, repeats + 1)
    return [
        Times(method.name, {stage: median(seconds) for stage, seconds in by.items()}, median(total), min(total))
        for method, by, total in zip(methods, stages, totals, strict=True)
    ]


def device_in_words(device: torch.device) -> str:
    """Return the processor, and for a CPU how many threads torch uses on it."""
    if device.type == "cuda":
        return torch.cuda.get_device_name(device)
    return f"{_processor()}, {torch.get_num_threads()} of {os.cpu_count()} threads"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
