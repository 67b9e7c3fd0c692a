"""The loss of clips: each term by its formula, weights, what is absent, gradients."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from pydantic import ValidationError
from torch import Tensor

from learning.camera import CaptureModel
from learning.clip_loss import ClipDepthLoss, ClipLoss
from learning.config import ClipLossConfig, Video3DLossConfig
from learning.losses import multiscale
from learning.method import Estimate
from learning.models.videonet import Film
from learning.perceptual import PerceptualLoss

Clips = tuple[Film, Tensor, Tensor]
NOTHING = torch.zeros(0, dtype=torch.float64)


@pytest.fixture
def clips() -> Clips:
    """Two clips of four frames in float64: what a network with MeasNet gave, true codes, true global measurements."""
    rng = np.random.default_rng(4)
    drawn = [torch.from_numpy(rng.random((2, 4, 3, *size))) for size in ((32, 36), (9, 7), (32, 36), (9, 7))]
    return Film(drawn[0], drawn[1]), drawn[2], drawn[3]


def loss(**settings: Any) -> ClipLoss:
    return ClipLoss(ClipLossConfig(**settings))


@pytest.mark.parametrize("intensity", ["mse", "l1"])
def test_terms_are_their_formulas(clips: Clips, intensity: str) -> None:
    film, image, measured = clips
    weights = {"measurement_weight": 0.7, "intensity_weight": 3.0, "change_weight": 0.2}
    terms = loss(intensity=intensity, **weights)(film, image, measured)
    error = (film.image - image).numpy()
    expected = {
        "measurement": np.mean((film.measured.numpy() - measured.numpy()) ** 2),
        "intensity": np.mean(error**2) if intensity == "mse" else np.mean(np.abs(error)),
    }
    changes = 0.0
    for frame in range(3):
        found, true = (each[:, frame + 1].numpy() - each[:, frame].numpy() for each in (film.image, image))
        changes += np.mean(np.abs(found - true)) / 3
    expected["change"] = changes
    total = 0.0
    for name, value in expected.items():
        assert terms[name].item() == pytest.approx(value, rel=1e-12)
        assert terms[f"{name}_weighted"].item() == pytest.approx(weights[f"{name}_weight"] * value, rel=1e-12)
        total += weights[f"{name}_weight"] * value
    assert terms["total"].item() == pytest.approx(total, rel=1e-12)
    assert set(terms) == {"total", *expected, *(f"{name}_weighted" for name in expected)}


def test_without_measnet_measurements_are_no_term(clips: Clips) -> None:
    film, image, _ = clips
    terms = loss(change_weight=0.5)(Film(film.image, NOTHING), image, NOTHING)
    assert set(terms) == {"total", "intensity", "intensity_weighted", "change", "change_weighted"}
    wanted = 5 * terms["intensity"] + 0.5 * terms["change"]
    assert terms["total"].item() == pytest.approx(wanted.item(), rel=1e-12)


def test_what_weighs_nothing_is_not_worked_out(clips: Clips) -> None:
    terms = loss()(*clips)
    assert set(terms) == {"total", *(f"{n}{end}" for n in ("measurement", "intensity") for end in ("", "_weighted"))}


def test_a_single_frame_does_not_change(clips: Clips) -> None:
    film, image, measured = (Film(*(v[:, :1] for v in clips[0])), clips[1][:, :1], clips[2][:, :1])
    assert not [name for name in loss(change_weight=1.0)(film, image, measured) if "change" in name]


def test_light_is_compared_at_three_scales(clips: Clips) -> None:
    """Frame by frame, as of stills; the mean of all."""
    film, image, measured = clips
    terms = loss(multiscale_weight=0.4)(film, image, measured)
    frames = [multiscale(film.image[b, n : n + 1], image[b, n : n + 1]).item() for b, n in np.ndindex(2, 4)]
    assert terms["multiscale"].item() == pytest.approx(np.mean(frames), rel=1e-12)
    assert terms["multiscale_weighted"].item() == pytest.approx(0.4 * np.mean(frames), rel=1e-12)
    weighted = sum(terms[f"{name}_weighted"] for name in ("measurement", "intensity", "multiscale"))
    assert terms["total"].item() == pytest.approx(float(weighted), rel=1e-12)


def test_features_are_compared_frame_by_frame(clips: Clips) -> None:
    film, image, measured = (Film(*(v.float() for v in clips[0])), clips[1].float(), clips[2].float())
    terms = loss(perceptual="random_vgg", perceptual_weight=0.3, perceptual_seed=7)(film, image, measured)
    features = PerceptualLoss("random_vgg", "vgg16", seed=7)
    frames = [features(film.image[b, n : n + 1], image[b, n : n + 1]).item() for b, n in np.ndindex(2, 4)]
    assert terms["perceptual"].item() == pytest.approx(np.mean(frames), rel=1e-4)  # float32 behind ten layers
    assert terms["perceptual_weighted"].item() == pytest.approx(0.3 * np.mean(frames), rel=1e-4)
    assert "perceptual" not in loss()(film, image, measured)


def test_gradients_reach_what_was_found_and_are_the_formulas(clips: Clips) -> None:
    film, image, measured = clips
    leaves = Film(*(each.clone().requires_grad_() for each in film))
    terms = loss(intensity="mse", change_weight=0.5, multiscale_weight=0.5)(leaves, image, measured)
    terms["total"].backward()
    assert leaves.measured.grad is not None
    wanted = 2 * (film.measured - measured) / measured.numel()
    torch.testing.assert_close(leaves.measured.grad, wanted, rtol=1e-12, atol=0)
    assert leaves.image.grad is not None
    assert bool((leaves.image.grad != 0).all())
    alone = film.image.clone().requires_grad_()
    loss(intensity="mse")(Film(alone, NOTHING), image, NOTHING)["total"].backward()
    assert alone.grad is not None
    torch.testing.assert_close(alone.grad, 5 * 2 * (film.image - image) / image.numel(), rtol=1e-12, atol=0)


def test_a_film_that_is_right_costs_nothing(clips: Clips) -> None:
    _, image, measured = clips
    terms = loss(change_weight=1.0, multiscale_weight=1.0)(Film(image, measured), image, measured)
    assert all(float(value) == 0 for value in terms.values())


def test_the_record_says_what_is_minimised() -> None:
    weights = {"measurement_weight": 1.0, "intensity_weight": 2.0, "change_weight": 0.5, "multiscale_weight": 0.1}
    record = loss(intensity="mse", **weights).record()
    assert record == {"intensity": "mse", "perceptual": "none", **weights}
    perceptual = loss(perceptual="random_vgg", perceptual_weight=0.3, perceptual_seed=7).record()
    assert perceptual["perceptual_weight"] == 0.3
    assert perceptual["perceptual"] != "none"


@pytest.mark.parametrize(
    "settings", [{}, {"perceptual_weight": 0.1}, {"change_weight": 1.0, "measurement_weight": 1.0}]
)
def test_a_loss_that_says_nothing_of_the_frames_is_refused(settings: dict[str, float]) -> None:
    with pytest.raises(ValidationError, match="intensity_weight"):
        ClipLossConfig(intensity_weight=0.0, **settings)  # pyright: ignore[reportArgumentType]
    ClipLossConfig(intensity_weight=0.0, multiscale_weight=0.1)
    ClipLossConfig(intensity_weight=0.0, perceptual="random_vgg")


def test_depth_counts_where_something_was_seen(clips: Clips, tiny_capture: CaptureModel) -> None:
    """Beside the terms of the frames, which are those of `ClipLoss`; 1 to 20 cm, Huber's beyond 1 cm by its formula."""
    film, image, _ = clips
    rng = np.random.default_rng(6)
    found, true = rng.uniform(0, 1, (2, 2, 4, 1, 32, 36))
    valid = rng.random(found.shape) < 0.7
    settings = {"depth_weight": 2.0, "depth_cm_weight": 0.3, "change_weight": 0.5}
    whole = ClipDepthLoss(Video3DLossConfig(**settings), tiny_capture)
    given = (torch.from_numpy(each) for each in (found, true, valid))
    first, *others = given
    terms = whole(Estimate(film.image, first), image, *others)
    depths_cm = [100 / (1 / 0.2 + each * (1 / 0.01 - 1 / 0.2)) for each in (found, true)]
    errors = {"depth": np.abs(found - true), "depth_cm": np.abs(depths_cm[0] - depths_cm[1])}
    far = errors["depth_cm"] > 1
    errors["depth_cm"] = np.where(far, errors["depth_cm"] - 0.5, errors["depth_cm"] ** 2 / 2)
    of_frames = ClipLoss(ClipLossConfig(change_weight=0.5))(Film(film.image, NOTHING), image, NOTHING)
    total = of_frames["total"].item()
    for name, values in errors.items():
        frames = ((clip, frame) for clip in range(2) for frame in range(4))
        expected = np.mean([values[at][valid[at]].mean() for at in frames])
        assert terms[name].item() == pytest.approx(expected, rel=1e-9)
        total += settings[f"{name}_weight"] * expected
    assert terms["total"].item() == pytest.approx(total, rel=1e-9)
    assert set(terms) == {*of_frames, *errors, *(f"{name}_weighted" for name in errors)}
    record = ClipLoss(ClipLossConfig(change_weight=0.5)).record()
    del record["measurement_weight"]  # it has no MeasNet
    assert whole.record() == record | {"depth_weight": 2.0, "depth_cm_weight": 0.3}
