"""A still of the tiny camera, and an untrained network for it."""

from __future__ import annotations

from pathlib import Path

import pytest

from simulator.dataset import open_dataset


@pytest.fixture(scope="session")
def sample(tiny_dataset: Path) -> Path:
    return open_dataset(tiny_dataset, "test").folder(2)


@pytest.fixture(scope="session")
def checkpoint(checkpoints: list[Path]) -> Path:
    """A network with random weights for the tiny camera, whose white is the training set's."""
    return checkpoints[0]
