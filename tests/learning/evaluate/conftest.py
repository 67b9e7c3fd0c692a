"""What the tests of evaluations share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch

from learning.camera import CaptureModel, capture_model, measure_reference_white
from learning.checkpoint import save_checkpoint
from learning.method import Clock, Estimate, linear_to_srgb
from learning.models import build_network
from simulator.dataset.reader import open_dataset


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


@pytest.fixture(scope="session")
def tiny_camera(tiny_dataset: Path) -> CaptureModel:
    """The camera of the tiny data set, as training knows it."""
    train = open_dataset(tiny_dataset, "train")
    return capture_model(train, white=measure_reference_white(train))


@pytest.fixture(scope="session")
def checkpoints(tmp_path_factory: pytest.TempPathFactory, tiny_camera: CaptureModel) -> list[Path]:
    """Two seeds of an untrained FlatNet3D and one FlatNet2D."""
    folder = tmp_path_factory.mktemp("checkpoints")
    made = []
    for name, seed in (("flatnet3d", 0), ("flatnet3d", 1), ("flatnet2d", 0)):
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            network = build_network(tiny_camera, name, "tiny").eval()
        path = folder / f"{name}_{seed}.safetensors"
        architecture = {"network": name, "size": "tiny"}
        save_checkpoint(path, network, architecture=architecture, capture=tiny_camera, record={"seed": seed})
        made.append(path)
    return made
