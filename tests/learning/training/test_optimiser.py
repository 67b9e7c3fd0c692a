"""Learning rates by hand, and what weight decay is for."""

import math

import pytest
import torch

from learning.capture import CaptureModel
from learning.config.train import OptimiserConfig
from learning.models import build_network
from learning.training.optimiser import build_optimiser, learning_rate


def test_cosine_with_warm_up() -> None:
    config = OptimiserConfig(learning_rate=2.0, warm_up=0.1)
    rates = [learning_rate(step, 100, config) for step in range(100)]
    assert rates[:10] == pytest.approx([0.2 * (step + 1) for step in range(10)], rel=1e-12)
    assert rates[10] == 2.0
    assert rates[55] == pytest.approx(1.0, rel=1e-12)  # half of the way down
    assert rates[99] == pytest.approx(1 + math.cos(math.pi * 89 / 90), rel=1e-12)


def test_constant() -> None:
    config = OptimiserConfig(learning_rate=2.0, warm_up=0.0, schedule="constant")
    assert {learning_rate(step, 7, config) for step in range(7)} == {2.0}


def test_only_convolutions_decay(tiny_capture: CaptureModel) -> None:
    network = build_network(tiny_capture, "flatnet3d", "tiny")
    optimiser = build_optimiser(network, OptimiserConfig(learning_rate=0.1, weight_decay=0.5))
    before = {name: value.detach().clone() for name, value in network.named_parameters()}
    for parameter in network.parameters():
        parameter.grad = torch.zeros_like(parameter)
    optimiser.step()
    decayed = set()
    for name, value in network.named_parameters():
        if not torch.equal(value, before[name]):
            assert torch.allclose(value, before[name] * 0.95, rtol=1e-6)  # 1 - 0.1 x 0.5
            decayed.add(name)
    assert decayed == {name for name, value in before.items() if name.startswith("enhancement") and value.ndim == 4}


def test_what_does_not_learn_is_left_out(tiny_capture: CaptureModel) -> None:
    network = build_network(tiny_capture, "flatnet3d", "tiny")
    network.inversion.requires_grad_(False)
    optimiser = build_optimiser(network, OptimiserConfig())
    held = {id(parameter) for group in optimiser.param_groups for parameter in group["params"]}
    assert held == {id(parameter) for parameter in network.enhancement.parameters()}
