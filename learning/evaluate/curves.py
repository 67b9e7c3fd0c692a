"""How networks learned: what they scored on validation scenes, step by step, from the log beside each checkpoint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from learning.validation import read_metrics

LOGGED = {"psnr": "psnr_db", "moving_psnr": "moving_psnr_db", "depth_rmse_cm": "depth_rmse_cm"}
"""What a training's log calls the scores."""


@dataclass(frozen=True)
class Curve:
    """One training: ``scores`` after so many ``steps``, by names of `LOGGED`."""

    method: str
    steps: tuple[int, ...]
    scores: Mapping[str, tuple[float, ...]]

    def plain(self) -> dict[str, Any]:
        """Return it for JSON."""
        return asdict(self)


def learning_curve(method: str, checkpoint: Path) -> Curve | None:
    """Return the curve of a checkpoint in the folder of its training; None elsewhere."""
    lines = [line for line in read_metrics(checkpoint.parent) if line["kind"] == "validation"]
    if not lines:
        return None
    scores = {
        score: tuple(line[logged] for line in lines)
        for score, logged in LOGGED.items()
        if all(logged in line for line in lines)
    }
    return Curve(method, tuple(line["step"] for line in lines), scores)
