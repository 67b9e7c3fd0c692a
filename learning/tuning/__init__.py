"""Tuning of classical methods: their parameters by noise level, the search, its score and its book."""

from learning.tuning.book import Tuned, load_tuned
from learning.tuning.tune import Tunable, VolumeMethod, tune

__all__ = ["Tunable", "Tuned", "VolumeMethod", "load_tuned", "tune"]
