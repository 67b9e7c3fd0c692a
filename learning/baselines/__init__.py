"""Classical reconstruction, the networks' rivals: constrained least squares, ADMM, depth by graph cuts."""

from learning.baselines.admm import Admm
from learning.baselines.cls import ConstrainedLeastSquares
from learning.baselines.method import DEFAULTS, SEARCH, VOLUME_PARAMETERS, ClassicalMethod, build_classical

__all__ = [
    "DEFAULTS",
    "SEARCH",
    "VOLUME_PARAMETERS",
    "Admm",
    "ClassicalMethod",
    "ConstrainedLeastSquares",
    "build_classical",
]
