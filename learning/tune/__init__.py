"""Tuning of classical methods: their parameters by noise level, the search, its score and its study."""

from learning.tune.job import Tunable, VolumeMethod, tune
from learning.tune.study import Tuned, load_tuned

__all__ = ["Tunable", "Tuned", "VolumeMethod", "load_tuned", "tune"]
