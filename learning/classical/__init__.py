"""Classical reconstruction, the networks' rivals: constrained least squares, ADMM, depth by graph cuts."""

from __future__ import annotations

from learning.classical.admm import Admm
from learning.classical.method import (
    DEFAULTS,
    SEARCH,
    VOLUME_PARAMETERS,
    ClassicalMethod,
    ConstrainedLeastSquares,
    build_classical,
)

__all__ = [
    "DEFAULTS",
    "SEARCH",
    "VOLUME_PARAMETERS",
    "Admm",
    "ClassicalMethod",
    "ConstrainedLeastSquares",
    "build_classical",
]
