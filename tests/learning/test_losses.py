"""The training loss: each term by its formula, weights, pixels without depth, gradients."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from learning.losses import ReconstructionLoss
from learning.method import Estimate
from simulator.errors import InputError

Scenes = tuple[Estimate, Tensor, Tensor, Tensor]


@pytest.fixture
def scenes() -> Scenes:
    """Three scenes in float64: estimate, image, disparity, valid; the last scene has no valid pixel."""
    generator = torch.Generator().manual_seed(4)
    draw = [torch.rand(3, channels, 32, 36, generator=generator, dtype=torch.float64) for channels in (3, 1, 3, 1)]
    valid = torch.rand(3, 1, 32, 36, generator=generator) < torch.tensor([0.9, 0.1, -1.0])[:, None, None, None]
    return Estimate(draw[0], draw[1]), draw[2], draw[3], valid


@pytest.mark.parametrize("intensity", ["mse", "l1"])
def test_terms_are_their_formulas(scenes: Scenes, intensity: str) -> None:
    """Against NumPy, scene by scene."""
    estimate, image, disparity, valid = scenes
    loss = ReconstructionLoss(intensity, intensity_weight=0.7, depth_weight=0.2)  # pyright: ignore[reportArgumentType]
    terms = loss(estimate, image, disparity, valid)
    difference = estimate.image.numpy() - image.numpy()
    expected = np.mean(difference**2) if intensity == "mse" else np.mean(np.abs(difference))
    depth = 0.0
    for scene in range(2):
        here = valid[scene].numpy()
        depth += np.mean(np.abs(estimate.disparity[scene].numpy()[here] - disparity[scene].numpy()[here])) / 3
    assert terms["intensity"].item() == pytest.approx(expected, rel=1e-12)
    assert terms["depth"].item() == pytest.approx(depth, rel=1e-12)
    assert terms["intensity_weighted"].item() == pytest.approx(0.7 * expected, rel=1e-12)
    assert terms["depth_weighted"].item() == pytest.approx(0.2 * depth, rel=1e-12)
    assert terms["total"].item() == pytest.approx(0.7 * expected + 0.2 * depth, rel=1e-12)
    assert set(terms) == {"total", "intensity", "depth", "intensity_weighted", "depth_weighted"}


def test_all_pixels_count_when_asked(scenes: Scenes) -> None:
    estimate, image, disparity, valid = scenes
    terms = ReconstructionLoss(invalid_depth=True)(estimate, image, disparity, valid)
    assert terms["depth"].item() == pytest.approx(np.abs((estimate.disparity - disparity).numpy()).mean(), rel=1e-12)


def test_parts_of_a_batch_average_to_the_whole(scenes: Scenes) -> None:
    """So two processes with half a batch each follow one process, although their scenes have unlike numbers of pixels."""
    estimate, image, disparity, valid = scenes
    loss = ReconstructionLoss("l1")
    whole = loss(estimate, image, disparity, valid)
    parts = [loss(Estimate(*(v[n : n + 1] for v in estimate)), *(v[n : n + 1] for v in scenes[1:])) for n in range(3)]
    for name, value in whole.items():
        assert np.mean([part[name].item() for part in parts]) == pytest.approx(value.item(), rel=1e-12)


@pytest.mark.parametrize("perceptual", ["none", "random_vgg"])
@pytest.mark.parametrize("perfect", [False, True])
def test_gradients_are_always_finite(scenes: Scenes, perceptual: str, perfect: bool) -> None:
    image, disparity, valid = (value.float() for value in scenes[1:])
    start = (image, disparity) if perfect else (image + 0.1, disparity + 0.1)
    estimate = Estimate(*(value.clone().requires_grad_() for value in start))
    loss = ReconstructionLoss(perceptual=perceptual)  # pyright: ignore[reportArgumentType]
    terms = loss(estimate, image, disparity, torch.zeros_like(valid, dtype=torch.bool))
    terms["total"].backward()
    assert terms["depth"].item() == 0
    for value in estimate:
        assert value.grad is not None
        assert value.grad.isfinite().all()
    assert bool(estimate.image.grad.any()) != perfect  # pyright: ignore[reportOptionalMemberAccess]
    assert not estimate.disparity.grad.any()  # pyright: ignore[reportOptionalMemberAccess]


@pytest.mark.slow
def test_the_perceptual_term_is_that_of_its_seed(scenes: Scenes) -> None:
    from learning.perceptual import PerceptualLoss

    estimate, image, disparity, valid = scenes
    loss = ReconstructionLoss(perceptual="random_vgg", intensity_weight=0, perceptual_weight=3, depth_weight=0, seed=9)
    terms = loss(estimate, image, disparity, valid)
    expected = PerceptualLoss("random_vgg", seed=9)(estimate.image, image)
    assert terms["perceptual"].item() == pytest.approx(expected.item(), rel=1e-5)
    assert terms["total"].item() == pytest.approx(3 * expected.item(), rel=1e-5)
    assert terms["intensity"].item() > 0  # logged although it does not count
    record = loss.record()
    wanted = {"perceptual": "random_vgg", "seed": 9, "intensity_weight": 0, "perceptual_weight": 3}
    assert record.items() >= wanted.items()


def test_nonsense_is_refused(scenes: Scenes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    estimate, image, disparity, valid = scenes
    with pytest.raises(InputError, match=r"^intensity: "):
        ReconstructionLoss("l2")  # pyright: ignore[reportArgumentType]
    with pytest.raises(InputError, match=r"^perceptual: "):
        ReconstructionLoss(perceptual="lpips")  # pyright: ignore[reportArgumentType]
    for weight in (-1.0, math.nan, math.inf):
        with pytest.raises(InputError, match=r"^depth_weight: "):
            ReconstructionLoss(depth_weight=weight)
    with pytest.raises(InputError, match=r"^intensity_weight, depth_weight: "):
        ReconstructionLoss(intensity_weight=0, depth_weight=0)
    with pytest.raises(InputError, match=r"^disparity: "):
        ReconstructionLoss()(estimate, image, disparity[:, 0], valid)
    with pytest.raises(InputError, match=r"^valid: "):
        ReconstructionLoss()(estimate, image, disparity, valid[:2])
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    with pytest.raises(InputError, match=r"^weights of vgg19: "):
        ReconstructionLoss(perceptual="vgg")
