"""Fixtures of the methods for clips: what a capture of known light measures, and the operator as a matrix."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from learning.layers.space_time import ClipProblem


@pytest.fixture(scope="session")
def measured() -> Callable[..., Tensor]:
    """Return the measurement ``(1, C, H, W)`` of light x, with noise over the greatest value."""

    def measured(problem: ClipProblem, light: Tensor, noise: float = 0.0) -> Tensor:
        clean = problem(light) / problem.scale
        drawn = torch.from_numpy(np.random.default_rng(4).standard_normal(clean.shape)).to(clean)
        return clean + problem.offset + noise * clean.max() * drawn

    return measured


@pytest.fixture(scope="session")
def dense() -> Callable[[ClipProblem], np.ndarray]:
    """Return A of each channel, column by column, ``(C, H W, N rows columns)``; that these are right is tested elsewhere."""

    def dense(problem: ClipProblem) -> np.ndarray:
        frames, _, channels, *field = problem.shape
        count = frames * field[0] * field[1]
        units = torch.eye(count).reshape(count, frames, 1, 1, *field).movedim(0, 2).expand(-1, -1, -1, channels, -1, -1)
        return problem(units).permute(1, 2, 3, 0).flatten(1, 2).numpy()

    return dense
