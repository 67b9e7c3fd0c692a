"""The energy of a labelling, by its definition."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray


def _energy(unary: NDArray[np.floating], labels: NDArray[np.integer], pairwise: float) -> float:
    """Return E(x) of labels ``(h, w)`` for costs ``(K, h, w)``."""
    alone = np.take_along_axis(np.asarray(unary, np.float64), labels[None], axis=0).sum()
    steps = sum(int(np.abs(np.diff(labels, axis=axis)).sum()) for axis in (0, 1))
    return float(alone + pairwise * steps)


@pytest.fixture
def energy() -> Callable[..., float]:
    """Return E(x) of ``unary, labels, pairwise``."""
    return _energy
