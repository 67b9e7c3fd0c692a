"""Classifiers of clips: what they look at, and that they can tell apart what differs in time only."""

from __future__ import annotations

from typing import get_args

import pytest
import torch
from torch import Tensor

from learning.config.training import ClassifierName
from learning.layers.classifiers import CLASSIFIERS, FrameClassifier, x3d
from simulator.errors import InputError


@pytest.fixture(autouse=True)
def _seeded() -> None:
    torch.manual_seed(0)


def test_the_configuration_knows_all() -> None:
    assert set(get_args(ClassifierName)) == set(CLASSIFIERS)
    with pytest.raises(InputError, match="classifier"):
        FrameClassifier("alexnet", 10, 3, 0, 5)


@pytest.mark.parametrize("name", CLASSIFIERS)
@pytest.mark.parametrize(("frames", "shared", "size"), [(10, 4, (64, 64)), (6, 0, (40, 48))])
def test_every_pixel_and_frame_counts(name: str, frames: int, shared: int, size: tuple[int, int]) -> None:
    """The answer follows what all frames share, too, and each of the frames."""
    network = FrameClassifier(name, frames, 3, shared, 5).eval()
    own = torch.randn(2, frames, 3, *size, requires_grad=True)
    alike = torch.randn(2, shared, *size, requires_grad=True)
    logits = network(own, alike)
    assert logits.shape == (2, 5)
    logits.square().sum().backward()
    for given in (own, alike) if shared else (own,):
        assert given.grad is not None
        by_image = given.grad.abs().amax(dim=(-2, -1))
        assert bool((by_image > 0).all())
    # A capture's answer is its own, whatever else is in the batch.
    torch.testing.assert_close(network(own[1:], alike[1:]), logits[1:], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", [name for name, (flat, _) in CLASSIFIERS.items() if not flat])
def test_fewer_frames_than_a_kernel_spans_have_finite_gradients_in_bfloat16(name: str) -> None:
    """Those of oneDNN were what memory happened to hold, on CPUs with bfloat16; see `learning.layers.convolution`."""
    network, frames = FrameClassifier(name, 2, 3, 0, 5), torch.randn(2, 2, 3, 40, 48)
    for _ in range(3):
        network.zero_grad()
        with torch.autocast("cpu", torch.bfloat16):
            logits = network(frames, frames[:, 0, :0])
        logits.float().square().sum().backward()
        for parameter in network.parameters():
            assert parameter.grad is not None
            assert bool(parameter.grad.isfinite().all())


def test_x3d_of_the_published_depth_has_the_published_size() -> None:
    """3.79 million weights in PyTorchVideo's model zoo, whose excitations are wider by 8 in the last stage: 0.03 million."""
    network = x3d(3, 400, depths=(3, 5, 11, 7))
    assert sum(weight.numel() for weight in network.parameters()) == pytest.approx(3.79e6 - 0.03e6, abs=0.01e6)


@pytest.mark.parametrize("name", ["dronet", "cnn3d"])
def test_faint_changes_count_like_strong_ones(name: str) -> None:
    network = FrameClassifier(name, 6, 3, 0, 5)
    network.body = torch.nn.Identity()
    frames = torch.rand(4, 6, 3, 48, 48)
    still = frames.mean(dim=1, keepdim=True)
    strong, faint = (network(still + strength * (frames - still), frames[:, 0, :0]) for strength in (1, 0.1))
    torch.testing.assert_close(faint, strong, rtol=0.02, atol=1e-5)  # the scaling adds 1e-5 to a variance of 0.0007


def test_the_temperature_is_that_with_which_labels_were_drawn() -> None:
    """Networks three times too sure, and half as sure as they may be; as many labels tell the temperature to some 1 %."""
    network = FrameClassifier("dronet", 6, 3, 0, 5)
    fair = 2 * torch.randn(20000, 5)
    labels = torch.multinomial(fair.softmax(dim=1), 1)[:, 0]
    for factor in (3.0, 0.5):
        network.calibrate(factor * fair, labels)
        assert float(network.temperature) == pytest.approx(factor, rel=0.04)


def test_the_temperature_divides_answers_but_in_training() -> None:
    network = FrameClassifier("dronet", 6, 3, 0, 5)
    network.body = torch.nn.Identity()
    seen = torch.rand(2, 6, 3, 16, 16), torch.zeros(2, 0, 16, 16)
    before = network(*seen), network.eval()(*seen)
    network.temperature.fill_(4)
    torch.testing.assert_close(network(*seen), before[1] / 4)
    torch.testing.assert_close(network.train()(*seen), before[0])


def clips(count: int) -> tuple[Tensor, Tensor]:
    """Return clips of 6 frames in which a dot goes to the right or to the left from anywhere, and which of the two."""
    frames, way = torch.zeros(count, 6, 1, 32, 32), torch.arange(count) % 2
    start = torch.randint(32, (count, 2))
    for clip in range(count):
        for frame in range(6):
            column = int(start[clip, 1]) + (2 * int(way[clip]) - 1) * 3 * frame
            rows, columns = (torch.arange(3) + int(start[clip, 0])) % 32, (torch.arange(3) + column) % 32
            frames[clip, frame, 0, rows[:, None], columns] = 1
    return frames, way


@pytest.mark.slow
@pytest.mark.parametrize("name", CLASSIFIERS)
def test_the_order_of_frames_can_be_learned(name: str) -> None:
    """Of two classes with the same frames in opposite order, new clips are told apart; a single frame says nothing."""
    network = FrameClassifier(name, 6, 1, 0, 2)
    optimiser = torch.optim.Adam(network.parameters(), 2e-3)
    for _ in range(72):
        frames, way = clips(32)
        loss = torch.nn.functional.cross_entropy(network(frames, frames[:, 0, :0]), way)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    network.eval()
    new, truth = clips(100)
    with torch.no_grad():
        right = (network(new, new[:, 0, :0]).argmax(dim=1) == truth).float().mean()
        backwards = (network(new.flip(1), new[:, 0, :0]).argmax(dim=1) == truth).float().mean()
    # Chance is 0.5 with a standard deviation of 0.05.
    assert right > 0.9
    assert backwards < 0.1
