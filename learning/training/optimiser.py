"""The optimiser of a configuration, and its learning rate as a function of the step: nothing of it has to be saved."""

from __future__ import annotations

import math

import torch
from torch import nn

from learning.config.train import OptimiserConfig

_CONVOLUTION = 4  # dimensions of its weights, at least: norms, biases and the inversion's P and lambda must not decay


def build_optimiser(network: nn.Module, config: OptimiserConfig) -> torch.optim.Optimizer:
    """Return AdamW over all parameters that learn; without weight decay it is Adam."""
    learning = [parameter for parameter in network.parameters() if parameter.requires_grad]
    groups = [
        {"params": [each for each in learning if each.ndim >= _CONVOLUTION], "weight_decay": config.weight_decay},
        {"params": [each for each in learning if each.ndim < _CONVOLUTION], "weight_decay": 0.0},
    ]
    return torch.optim.AdamW([group for group in groups if group["params"]], lr=config.learning_rate)


def learning_rate(step: int, steps: int, config: OptimiserConfig) -> float:
    """Return the learning rate of a step.

    Args:
        step: 0 to ``steps - 1``.
        steps: of the whole training.
        config: the optimiser's section.

    Example:
        >>> config = OptimiserConfig(learning_rate=0.1, warm_up=0.2)
        >>> [round(learning_rate(step, 10, config), 4) for step in (0, 1, 2, 6, 9)]
        [0.05, 0.1, 0.1, 0.05, 0.0038]
    """
    rising = round(config.warm_up * steps)
    if step < rising:
        return config.learning_rate * (step + 1) / rising
    if config.schedule == "constant":
        return config.learning_rate
    share = (step - rising) / (steps - rising)
    return config.learning_rate * (1 + math.cos(math.pi * share)) / 2
