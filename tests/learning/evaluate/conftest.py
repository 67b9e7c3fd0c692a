"""What the tests of evaluations share."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
import yaml

from learning.camera import CaptureModel
from learning.config import EvaluateConfig, load_file
from learning.evaluate import report
from learning.method import Clock, Estimate, linear_to_srgb


class Oracle:
    """A method that was told the answers: of each measurement, known by its values, image and disparity."""

    name = "oracle"

    def __init__(
        self, capture: CaptureModel, examples: Any, change: Callable[[Estimate], Estimate] = lambda e: e
    ) -> None:
        self.capture, self._change = capture, change
        self._answers = {
            example.measurement.numpy().tobytes(): Estimate(
                linear_to_srgb(example.radiance, capture.white), torch.as_tensor(capture.disparity(example.depth_m))
            )
            for example in (examples[position] for position in range(len(examples)))
        }
        self.batches: list[int] = []

    def reconstruct(self, measurement: torch.Tensor, clock: Clock | None = None) -> Estimate:
        self.batches.append(len(measurement))
        answers = [self._answers[one.numpy().tobytes()] for one in measurement]
        return self._change(Estimate(*(torch.stack(values) for values in zip(*answers, strict=True))))


@pytest.fixture
def oracle() -> type[Oracle]:
    return Oracle


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Draw nothing and measure no FLIP: both take longer than all the rest, and have tests of their own."""
    monkeypatch.setattr(report, "_figures", lambda *_: {})
    monkeypatch.setattr("flip_evaluator.evaluate", lambda *_, **__: (None, 0.5, None))


@pytest.fixture
def load(tmp_path: Path, tiny_dataset: Path, checkpoints: list[Path]) -> Callable[..., EvaluateConfig]:
    """Return a function that writes an evaluation's file, of 3 scenes, and loads it."""

    def load(**changes: Any) -> EvaluateConfig:
        content: dict[str, Any] = {
            "name": "trial",
            "output": "out",
            "data": {"test": str(tiny_dataset), "training": str(tiny_dataset), "scenes": 3},
            "methods": [
                {"name": "FlatNet3D", "checkpoints": [str(path) for path in checkpoints[:2]]},
                {"name": "CLS", "classical": "cls", "parameters": {"regularisation_lambda": 0.1}},
            ],
            "perceptual": "none",
            "time": {"repeats": 0},
            "figures": {"montage": 0},
            "batch": 2,
        }
        data = content["data"] | changes.pop("data", {})
        path = tmp_path / "evaluate.yaml"
        path.write_text(yaml.safe_dump(content | {"data": data} | changes, sort_keys=False), encoding="utf-8")
        return load_file(EvaluateConfig, path)

    return load


@pytest.fixture
def written(tmp_path: Path) -> Callable[[], dict[str, Any]]:
    """Return a function that reads the results of that evaluation."""
    return lambda: json.loads((tmp_path / "out" / "results.json").read_text(encoding="utf-8"))
