"""Evaluation: all methods on the same scenes and measurements, by the same scores."""

from learning.evaluate.job import evaluate

__all__ = ["evaluate"]
