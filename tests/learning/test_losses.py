"""The training loss: each term by its formula, weights, pixels without depth, gradients."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import torch.nn.functional as nnf
from pydantic import ValidationError
from torch import Tensor

from learning.camera import CaptureModel
from learning.config import LossConfig
from learning.losses import ReconstructionLoss
from learning.method import Estimate
from simulator.colour import linear_to_srgb, srgb_to_linear
from simulator.errors import InputError

Scenes = tuple[Estimate, Tensor, Tensor, Tensor]


@pytest.fixture
def scenes() -> Scenes:
    """Three scenes in float64: estimate, image, disparity, valid; the last scene has no valid pixel."""
    generator = torch.Generator().manual_seed(4)
    draw = [torch.rand(3, channels, 32, 36, generator=generator, dtype=torch.float64) for channels in (3, 1, 3, 1)]
    valid = torch.rand(3, 1, 32, 36, generator=generator) < torch.tensor([0.9, 0.1, -1.0])[:, None, None, None]
    return Estimate(draw[0], draw[1]), draw[2], draw[3], valid


@pytest.fixture
def make_loss(tiny_capture: CaptureModel) -> Callable[..., ReconstructionLoss]:
    """Make a loss for a camera of 1 to 20 cm."""
    return lambda **settings: ReconstructionLoss(LossConfig(**settings), tiny_capture)


@pytest.mark.parametrize("intensity", ["mse", "l1"])
def test_terms_are_their_formulas(scenes: Scenes, make_loss: Any, intensity: str) -> None:
    """Against NumPy, scene by scene."""
    estimate, image, disparity, valid = scenes
    loss = make_loss(intensity=intensity, intensity_weight=0.7, depth_weight=0.2)
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


def test_light_is_compared_at_three_scales(scenes: Scenes, make_loss: Any) -> None:
    """Against block means in NumPy; 36 columns are 4.5 blocks of 8."""
    estimate, image, disparity, valid = scenes
    terms = make_loss(multiscale_weight=0.4)(estimate, image, disparity, valid)
    expected = 0.0
    for side in (2, 4, 8):
        means = [
            np.stack([
                [decoded[..., r : r + side, c : c + side].mean((2, 3)) for c in range(0, 36, side)]
                for r in range(0, 32, side)
            ])
            for decoded in (srgb_to_linear(codes.numpy()).astype(np.float64) for codes in (estimate.image, image))
        ]  # fmt: skip
        found, true = (linear_to_srgb(mean).astype(np.float64) for mean in means)
        expected += np.abs(found - true).mean() / 3
    assert terms["multiscale"].item() == pytest.approx(expected, rel=1e-5)  # the curves in NumPy return float32
    assert terms["multiscale_weighted"].item() == pytest.approx(0.4 * expected, rel=1e-5)
    weighted = terms["intensity_weighted"] + terms["multiscale_weighted"] + terms["depth_weighted"]
    assert terms["total"].item() == pytest.approx(weighted.item(), rel=1e-12)


def test_noise_without_an_average_hardly_counts_at_scales(scenes: Scenes, make_loss: Any) -> None:
    """A chequerboard whose light averages to the truth's costs nothing there, a veil of the same size does."""
    _, image, disparity, valid = scenes
    image = 0.2 + 0.6 * nnf.interpolate(image[..., ::4, ::4], scale_factor=4.0)
    sign = 1.0 - 2.0 * (torch.arange(32)[:, None] + torch.arange(36)).remainder(2)
    loss = make_loss(multiscale_weight=1.0)
    light = torch.from_numpy(srgb_to_linear(image.numpy())).double()
    found = {}
    for name, change in (("chequerboard", 0.02 * sign), ("veil", torch.tensor(0.02))):
        changed = torch.from_numpy(linear_to_srgb((light + change).numpy())).double()
        found[name] = loss(Estimate(changed, disparity), image, disparity, valid)["multiscale"].item()
    assert found["chequerboard"] < 1e-6 < 0.005 < found["veil"]


def huber_cm(estimate: Tensor, disparity: Tensor) -> np.ndarray:
    """Return the loss of every pixel: depths from 1 / z between 1 / 20 and 1 / 1 cm, squares up to 1 cm, then absolute."""
    found, true = (1 / (0.05 + each.numpy() * (1 - 0.05)) for each in (estimate, disparity))
    error = np.abs(found - true)
    return np.where(error <= 1, error**2 / 2, error - 0.5)


def test_depth_counts_in_centimetres_too(scenes: Scenes, make_loss: Any) -> None:
    estimate, image, disparity, valid = scenes
    loss = make_loss(depth_weight=0.2, depth_cm_weight=0.03)
    terms = loss(estimate, image, disparity, valid)
    errors = huber_cm(estimate.disparity, disparity)
    assert 0.05 < np.mean(errors < 0.5) < 0.95  # both parts of it
    expected = sum(np.mean(errors[scene][valid[scene].numpy()]) / 3 for scene in range(2))
    assert terms["depth_cm"].item() == pytest.approx(expected, rel=1e-6)
    assert terms["depth_cm_weighted"].item() == pytest.approx(0.03 * expected, rel=1e-6)
    weighted = terms["intensity_weighted"] + terms["depth_weighted"] + terms["depth_cm_weighted"]
    assert terms["total"].item() == pytest.approx(weighted.item(), rel=1e-12)
    assert loss.record()["depth_cm_weight"] == 0.03
    everywhere = make_loss(depth_cm_weight=1.0, invalid_depth=True)(estimate, image, disparity, valid)
    assert everywhere["depth_cm"].item() == pytest.approx(errors.mean(), rel=1e-6)


def test_all_pixels_count_when_asked(scenes: Scenes, make_loss: Any) -> None:
    estimate, image, disparity, valid = scenes
    terms = make_loss(invalid_depth=True)(estimate, image, disparity, valid)
    assert terms["depth"].item() == pytest.approx(np.abs((estimate.disparity - disparity).numpy()).mean(), rel=1e-12)


def test_parts_of_a_batch_average_to_the_whole(scenes: Scenes, make_loss: Any) -> None:
    """So two processes with half a batch each follow one process, although their scenes have unlike numbers of pixels."""
    estimate, image, disparity, valid = scenes
    loss = make_loss(multiscale_weight=0.2, depth_cm_weight=0.1)
    whole = loss(estimate, image, disparity, valid)
    parts = [loss(Estimate(*(v[n : n + 1] for v in estimate)), *(v[n : n + 1] for v in scenes[1:])) for n in range(3)]
    for name, value in whole.items():
        assert np.mean([part[name].item() for part in parts]) == pytest.approx(value.item(), rel=1e-12)


@pytest.mark.parametrize("perceptual", ["none", "random_vgg"])
@pytest.mark.parametrize("perfect", [False, True])
def test_gradients_are_always_finite(scenes: Scenes, make_loss: Any, perceptual: str, perfect: bool) -> None:
    image, disparity, valid = (value.float() for value in scenes[1:])
    start = (image, disparity) if perfect else (image + 0.1, disparity + 0.1)
    estimate = Estimate(*(value.clone().requires_grad_() for value in start))
    loss = make_loss(perceptual=perceptual, multiscale_weight=0.2, depth_cm_weight=0.1)
    terms = loss(estimate, image, disparity, torch.zeros_like(valid, dtype=torch.bool))
    terms["total"].backward()
    assert terms["depth"].item() == terms["depth_cm"].item() == 0
    of_image, of_disparity = (value.grad for value in estimate)
    assert of_image is not None
    assert of_disparity is not None
    assert of_image.isfinite().all()
    assert bool(of_image.any()) != perfect
    assert not of_disparity.any()


@pytest.mark.slow
def test_the_perceptual_term_is_that_of_its_seed(scenes: Scenes, make_loss: Any) -> None:
    from learning.perceptual import PerceptualLoss

    estimate, image, disparity, valid = scenes
    loss = make_loss(
        perceptual="random_vgg", intensity_weight=0, perceptual_weight=3, depth_weight=0, perceptual_seed=9
    )
    terms = loss(estimate, image, disparity, valid)
    expected = PerceptualLoss("random_vgg", seed=9)(estimate.image, image)
    assert terms["perceptual"].item() == pytest.approx(expected.item(), rel=1e-5)
    assert terms["total"].item() == pytest.approx(3 * expected.item(), rel=1e-5)
    assert terms["intensity"].item() > 0  # logged although it does not count
    record = loss.record()
    wanted = {"perceptual": "random_vgg", "seed": 9, "intensity_weight": 0, "perceptual_weight": 3}
    assert record.items() >= wanted.items()


def test_weights_of_zero_are_refused() -> None:
    with pytest.raises(ValidationError, match=r"intensity_weight, .*depth_cm_weight are all 0: nothing to learn"):
        LossConfig(intensity_weight=0, depth_weight=0)
    LossConfig(intensity_weight=0, depth_weight=0, perceptual="random_vgg")


def test_nonsense_is_refused(scenes: Scenes, make_loss: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    estimate, image, disparity, valid = scenes
    with pytest.raises(InputError, match=r"^disparity: "):
        make_loss()(estimate, image, disparity[:, 0], valid)
    with pytest.raises(InputError, match=r"^valid: "):
        make_loss()(estimate, image, disparity, valid[:2])
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    with pytest.raises(InputError, match=r"^weights of vgg19: "):
        make_loss(perceptual="vgg")
