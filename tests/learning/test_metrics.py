"""Scores against formulas written down here, and against what must hold for any estimate."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from skimage.color import rgb2lab
from skimage.metrics import peak_signal_noise_ratio
from torch import Tensor

from learning.camera import CaptureModel
from learning.data import Example
from learning.method import Estimate, linear_to_srgb
from learning.metrics import (
    DEFINITIONS,
    dark_mask,
    depth_scores,
    image_scores,
    measure,
    measure_over_time,
    moving_pixels,
    psnr,
    psnr_at,
)
from simulator.errors import InputError

Pixels = NDArray[np.float32]
OF_CLIPS = ("moving_psnr", "warping_error", "true_warping_error", "cvvdp")


@pytest.fixture
def wide(tiny_capture: CaptureModel) -> CaptureModel:
    """The camera with the thesis's range of depths, 3.6 to 20 cm."""
    return replace(tiny_capture, stack=replace(tiny_capture.stack, depths_m=np.array([0.036, 0.06, 0.2])))


@pytest.fixture
def batch(wide: CaptureModel) -> tuple[Estimate, Example]:
    """Three scenes of 20 x 24 pixels with depths in the range, brighter than white here and there, and a poor estimate."""
    generator = torch.Generator().manual_seed(3)
    depth = 0.036 + 0.164 * torch.rand(3, 1, 20, 24, generator=generator)
    valid = torch.rand(3, 1, 20, 24, generator=generator) < 0.8
    radiance = 1.2 * torch.rand(3, 3, 20, 24, generator=generator) ** 2
    example = Example(torch.zeros(3, 3, 48, 48), radiance, torch.where(valid, depth, torch.tensor(0.2)), valid)
    noise = 0.2 * torch.randn(3, 4, 20, 24, generator=generator)
    image = linear_to_srgb(radiance, wide.white) + noise[:, :3]
    return Estimate(image, wide.disparity(example.depth_m) + noise[:, 3:]), example


@pytest.fixture(scope="module")
def pair() -> tuple[Pixels, Pixels]:
    """A smooth image with edges, and the same blurred and noisy."""
    rng = np.random.default_rng(5)
    y, x = np.mgrid[:40, :52] / 40
    truth = np.stack([(np.sin(9 * x * (c + 1)) > np.cos(7 * y)) * 0.6 + 0.3 * y for c in range(3)], axis=-1)
    worse = (truth + np.roll(truth, 1, 0) + np.roll(truth, 1, 1)) / 3 + rng.normal(0, 0.08, truth.shape)
    return worse.clip(0, 1).astype(np.float32), truth.clip(0, 1).astype(np.float32)


def wang_2004(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """SSIM of a channel, equation 13, window by window: an 11 x 11 circular Gaussian, sigma 1.5, of unit sum."""
    taps = np.arange(11) - 5
    window = np.exp(-(taps[:, None] ** 2 + taps**2) / (2 * 1.5**2))
    window /= window.sum()
    values = []
    for row in range(one.shape[0] - 10):
        for column in range(one.shape[1] - 10):
            x, y = (image[row : row + 11, column : column + 11] for image in (one, other))
            mean_x, mean_y = (window * x).sum(), (window * y).sum()
            variance_x = (window * (x - mean_x) ** 2).sum()
            variance_y = (window * (y - mean_y) ** 2).sum()
            covariance = (window * (x - mean_x) * (y - mean_y)).sum()
            top = (2 * mean_x * mean_y + 0.01**2) * (2 * covariance + 0.03**2)
            values.append(top / ((mean_x**2 + mean_y**2 + 0.01**2) * (variance_x + variance_y + 0.03**2)))
    return float(np.mean(values))


def test_ssim_is_that_of_wang_2004(pair: tuple[Pixels, Pixels]) -> None:
    worse, truth = pair
    expected = np.mean([wang_2004(truth[..., c].astype(float), worse[..., c].astype(float)) for c in range(3)])
    assert image_scores(worse, truth)["ssim"] == pytest.approx(expected, abs=1e-9)


def hunt_lab(colour: NDArray[np.float64]) -> NDArray[np.float64]:
    """L*, and a*, b* that grow with lightness: FLIP's paper, section 4.1.2. White is sRGB's own, as rgb2lab's."""
    lab = rgb2lab(colour[None, None])[0, 0]
    return np.array([lab[0], 0.01 * lab[0] * lab[1], 0.01 * lab[0] * lab[2]])


def hyab(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    return float(abs(one[0] - other[0]) + math.hypot(one[1] - other[1], one[2] - other[2]))


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ((0, 0, 0), (1, 1, 1)),
        ((0.8, 0.2, 0.1), (0.8, 0.3, 0.1)),
        ((0.1, 0.2, 0.9), (0.9, 0.2, 0.1)),
        ((0, 1, 0), (0, 0, 1)),
    ],
)
def test_flip_of_uniform_images_is_the_papers(one: Any, other: Any) -> None:
    """Andersson et al. 2020, section 4.1.2: HyAB to the power 0.7, remapped at 0.4 of the greatest to 0.95; no edges there.

    rgb2lab rounds sRGB's matrix to other digits than FLIP: 2e-3. Channels in another order would miss by 0.05 and more.
    """
    colours = [np.array(colour, np.float64) for colour in (one, other)]
    greatest = hyab(hunt_lab(np.array([0.0, 1, 0])), hunt_lab(np.array([0.0, 0, 1]))) ** 0.7
    difference = hyab(*(hunt_lab(colour) for colour in colours)) ** 0.7
    knee = 0.4 * greatest
    expected = 0.95 * difference / knee
    if difference > knee:
        expected = 0.95 + 0.05 * (difference - knee) / (greatest - knee)
    images = [np.broadcast_to(colour, (16, 20, 3)).astype(np.float32).copy() for colour in colours]
    assert image_scores(images[0], images[1])["flip"] == pytest.approx(expected, abs=2e-3)


def test_flip_black_on_white_is_0_967_and_equal_is_0(pair: tuple[Pixels, Pixels]) -> None:
    black = np.zeros((16, 16, 3), np.float32)
    assert image_scores(black, black + 1)["flip"] == pytest.approx(0.967, abs=1e-3)
    assert image_scores(pair[1], pair[1]) == {"ssim": pytest.approx(1, abs=1e-12), "flip": 0}


def test_psnr_is_analytic_and_scikit_image_s(batch: tuple[Estimate, Example], wide: CaptureModel) -> None:
    one, other = torch.full((1, 3, 4, 4), 0.5), torch.full((1, 3, 4, 4), 0.6)
    assert psnr(one, other).item() == pytest.approx(20, abs=1e-5)  # float32's 0.6
    assert psnr(one, one).item() == math.inf
    estimate, example = batch
    for scene, scores in enumerate(measure(estimate, example, wide)):
        truth = (example.radiance[scene].numpy().astype(np.float64) / 0.9).clip(0, 1)
        codes = np.where(truth <= 0.0031308, 12.92 * truth, 1.055 * truth ** (1 / 2.4) - 0.055)
        found = estimate.image[scene].numpy().astype(np.float64).clip(0, 1)
        linear = np.where(found <= 0.04045, found / 12.92, ((found + 0.055) / 1.055) ** 2.4)
        # 1e-4 dB: codes are float32 there
        assert scores["psnr"] == pytest.approx(peak_signal_noise_ratio(codes, found, data_range=1), abs=1e-4)
        assert scores["linear_psnr"] == pytest.approx(peak_signal_noise_ratio(truth, linear, data_range=1), abs=1e-4)


@pytest.mark.parametrize("choose", [None, "valid", "bright"])
def test_depth_errors_are_their_formulas(batch: Any, wide: CaptureModel, choose: str | None) -> None:
    estimate, example = batch
    dark = dark_mask(example, wide, 0.2)
    pixels = {None: None, "valid": example.valid, "bright": example.valid & ~dark}[choose]
    luminance = np.einsum("c,bchw->bhw", [0.2126, 0.7152, 0.0722], example.radiance.numpy()) / 0.9
    chosen = {
        None: np.ones_like(luminance, bool),
        "valid": example.valid[:, 0].numpy(),
        "bright": example.valid[:, 0].numpy() & (luminance >= 0.2),
    }[choose]
    assert choose is None or 0.3 < chosen.mean() < 0.9
    for scene, scores in enumerate(measure(estimate, example, wide, pixels=pixels)):
        share = estimate.disparity[scene, 0].numpy().astype(np.float64).clip(0, 1)[chosen[scene]]
        found = 1 / 0.2 + share * (1 / 0.036 - 1 / 0.2)
        true = 1 / example.depth_m[scene, 0].numpy().astype(np.float64)[chosen[scene]]
        assert scores["depth_rmse_cm"] == pytest.approx(np.sqrt(np.mean((100 / found - 100 / true) ** 2)), rel=1e-9)
        assert scores["disparity_rmse_per_m"] == pytest.approx(np.sqrt(np.mean((found - true) ** 2)), rel=1e-9)
        span = 1 / 0.036 - 1 / 0.2  # the truth lies in the range, up to float32
        assert scores["disparity_rmse"] == pytest.approx(scores["disparity_rmse_per_m"] / span, rel=1e-6)


def test_the_best_constant_depth_of_3_6_to_20_cm_is_4_73_cm_off(wide: CaptureModel) -> None:
    """The standard deviation of a uniform distribution, 16.4 cm / sqrt(12); no other constant is better."""
    depth_m = torch.linspace(0.036, 0.2, 128 * 128, dtype=torch.float64).reshape(1, 1, 128, 128)
    black, everywhere = torch.zeros(1, 3, 128, 128), torch.ones_like(depth_m, dtype=torch.bool)
    example = Example(black, black, depth_m, everywhere)

    def error(constant_m: float) -> float:
        guess = torch.full_like(depth_m, float(wide.disparity(torch.tensor(constant_m, dtype=torch.float64))))
        return depth_scores(Estimate(black, guess), example, wide).depth_rmse_cm.item()

    best = error(0.118)
    assert best == pytest.approx(16.4 / math.sqrt(12), rel=1e-3)
    assert f"{best:.2f}" == "4.73"
    assert best < min(error(0.116), error(0.120))


def test_a_perfect_estimate_is_perfect(batch: tuple[Estimate, Example], wide: CaptureModel) -> None:
    _, example = batch
    estimate = Estimate(linear_to_srgb(example.radiance, wide.white), wide.disparity(example.depth_m))
    for scores in measure(estimate, example, wide):
        assert list(scores) == [name for name in DEFINITIONS if name not in ("lpips", *OF_CLIPS)]
        assert scores["psnr"] == math.inf
        assert scores["linear_psnr"] > 130  # float32 through both curves
        assert scores["ssim"] == pytest.approx(1, abs=1e-12)
        assert scores["flip"] == 0
        assert scores["depth_rmse_cm"] < 1e-5
        assert scores["disparity_rmse"] < 1e-6


def test_scores_are_of_their_scene_and_clamped(batch: tuple[Estimate, Example], wide: CaptureModel) -> None:
    estimate, example = batch
    together = measure(estimate, example, wide)
    order = [2, 0, 1]
    turned = measure(Estimate(*(v[order] for v in estimate)), Example(*(v[order] for v in example)), wide)
    assert turned == [together[n] for n in order]
    assert measure(estimate.clamped(), example, wide) == together
    assert not torch.equal(estimate.clamped().disparity, estimate.disparity)


def test_the_far_plane_may_be_at_infinity(tiny_capture: CaptureModel) -> None:
    capture = replace(tiny_capture, stack=replace(tiny_capture.stack, depths_m=np.array([0.1, 0.2, np.inf])))
    depth_m = torch.tensor([0.1, 0.2, math.inf]).repeat(2, 1, 1, 1).reshape(2, 1, 1, 3)
    black, everywhere = torch.zeros(2, 3, 1, 3), torch.ones_like(depth_m, dtype=torch.bool)
    example = Example(black, black, depth_m, everywhere)
    guess = torch.tensor([[1.0, 0.5, 0.0], [1.0, 0.5, 0.1]]).reshape(2, 1, 1, 3)
    scores = depth_scores(Estimate(black, guess), example, capture)
    assert scores.depth_rmse_cm[0] < 1e-5
    assert scores.depth_rmse_cm[1] == math.inf
    assert scores.disparity_rmse_per_m.tolist() == pytest.approx([0, 1 / math.sqrt(3)], abs=1e-6)


def test_without_pixels_there_is_no_depth_score(batch: tuple[Estimate, Example], wide: CaptureModel) -> None:
    pixels = batch[1].valid.clone()
    pixels[1] = False
    scores = measure(*batch, wide, pixels=pixels)
    assert [math.isnan(scene["depth_rmse_cm"]) for scene in scores] == [False, True, False]


def test_lpips_is_a_score_of_each_scene(batch: tuple[Estimate, Example], wide: CaptureModel) -> None:
    """What comes is the clamped image and the true one; a stand-in, for the weights may be absent."""

    def distance(image: Tensor, truth: Tensor) -> Tensor:
        assert float(image.min()) == 0
        assert float(image.max()) == 1
        return (image - truth).abs().mean(dim=(1, 2, 3))

    estimate, example = batch
    expected = (estimate.image.clamp(0, 1) - linear_to_srgb(example.radiance, 0.9)).abs().mean(dim=(1, 2, 3))
    scores = measure(estimate, example, wide, lpips=distance)  # pyright: ignore[reportArgumentType]
    assert [scene["lpips"] for scene in scores] == expected.tolist()
    assert list(scores[0]) == [name for name in DEFINITIONS if name not in OF_CLIPS]


def test_nonsense_is_refused(batch: tuple[Estimate, Example], wide: CaptureModel) -> None:
    estimate, example = batch
    disparity = estimate.disparity.clone()
    disparity[1, 0, 3, 4] = math.nan
    with pytest.raises(InputError, match=r"^estimate\.disparity: "):
        measure(Estimate(estimate.image, disparity), example, wide)
    with pytest.raises(InputError, match=r"^estimate\.image: "):
        measure(Estimate(estimate.image[..., 1:], estimate.disparity), example, wide)
    with pytest.raises(InputError, match=r"^estimate\.image: "):
        measure(Estimate(*(v[..., :10] for v in estimate)), Example(*(v[..., :10] for v in example)), wide)
    with pytest.raises(InputError, match=r"^share: "):
        dark_mask(example, wide, 2)


@pytest.fixture
def clips(clip_capture: CaptureModel) -> tuple[Estimate, Example]:
    """Three clips of four frames of 20 x 24 pixels: one moves in a window, one by less than counts, one not at all."""
    rng = np.random.default_rng(6)
    codes = np.repeat(rng.uniform(0.2, 0.8, (3, 1, 3, 20, 24)), 4, axis=1)
    for frame in range(4):
        codes[0, frame, :, 3:9, 4 : 6 + 2 * frame] = rng.uniform(0, 1, (3, 1, 1))
        codes[1, frame, 1, 5:10, 5:10] += 0.08 * (-1) ** frame  # less than 0.1 from the mean
    linear = np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)
    radiance = torch.from_numpy(linear * clip_capture.white).float()
    depth = torch.full((3, 4, 1, 20, 24), 0.02)
    example = Example(torch.zeros(3, 3, 48, 48), radiance, depth, torch.ones_like(depth, dtype=torch.bool))
    found = torch.from_numpy(codes + rng.normal(0, 0.1, codes.shape)).float()
    return Estimate(found, torch.zeros(3, 4, 1, 20, 24)), example


def true_codes(example: Example, white: float) -> NDArray[np.float64]:
    """Return sRGB codes by the standard's curve, in float64."""
    linear = (example.radiance.numpy().astype(np.float64) / white).clip(0, 1)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def test_psnr_of_clips_is_over_all_frames_and_over_moving_pixels(
    clips: tuple[Estimate, Example], clip_capture: CaptureModel
) -> None:
    estimate, example = clips
    scores, truth = measure(estimate, example, clip_capture), true_codes(example, clip_capture.white)
    found = estimate.image.numpy().astype(np.float64).clip(0, 1)
    assert len(scores) == 3
    for clip, score in enumerate(scores):
        # 1e-4 dB: codes are float32 there
        assert score["psnr"] == pytest.approx(peak_signal_noise_ratio(truth[clip], found[clip], data_range=1), abs=1e-4)
        linear = np.where(found[clip] <= 0.04045, found[clip] / 12.92, ((found[clip] + 0.055) / 1.055) ** 2.4)
        true = (example.radiance[clip].numpy().astype(np.float64) / clip_capture.white).clip(0, 1)
        assert score["linear_psnr"] == pytest.approx(peak_signal_noise_ratio(true, linear, data_range=1), abs=1e-4)
    moves = np.zeros((20, 24), bool)
    for row, column in np.ndindex(20, 24):
        here = truth[0, :, :, row, column]
        moves[row, column] = np.abs(here - here.mean(axis=0)).max() > 0.1
    assert 10 < moves.sum() < 60
    squares = (truth[0] - found[0])[:, :, moves] ** 2
    assert scores[0]["moving_psnr"] == pytest.approx(-10 * np.log10(squares.mean()), abs=1e-4)
    assert [math.isnan(score["moving_psnr"]) for score in scores] == [False, True, True]
    mask = moving_pixels(torch.from_numpy(truth))
    assert mask.shape == (3, 1, 1, 20, 24)
    assert (mask[0, 0, 0].numpy() == moves).all()
    assert not mask[1:].any()


def test_a_clips_ssim_and_flip_are_means_of_its_frames(
    clips: tuple[Estimate, Example], clip_capture: CaptureModel
) -> None:
    estimate, example = clips
    scores, truth = measure(estimate, example, clip_capture), linear_to_srgb(example.radiance, clip_capture.white)
    for clip, score in enumerate(scores):
        frames = [
            image_scores(*(each[clip, frame].permute(1, 2, 0).numpy() for each in (estimate.image.clamp(0, 1), truth)))
            for frame in range(4)
        ]
        for name in ("ssim", "flip"):
            assert score[name] == pytest.approx(sum(each[name] for each in frames) / 4, rel=1e-12)


def test_a_clips_lpips_is_a_mean_of_its_frames(clips: tuple[Estimate, Example], clip_capture: CaptureModel) -> None:
    """A stand-in that sees images of frames, clips one after the other."""

    def distance(image: Tensor, truth: Tensor) -> Tensor:
        assert image.shape == truth.shape == (12, 3, 20, 24)
        return (image - truth).abs().mean(dim=(1, 2, 3))

    estimate, example = clips
    scores = measure(estimate, example, clip_capture, lpips=distance)  # pyright: ignore[reportArgumentType]
    errors = np.abs(estimate.image.numpy().clip(0, 1) - true_codes(example, clip_capture.white))
    # float32
    assert [score["lpips"] for score in scores] == pytest.approx(errors.mean(axis=(1, 2, 3, 4)).tolist(), rel=1e-5)


def test_a_clip_is_seen_whole(clips: tuple[Estimate, Example], clip_capture: CaptureModel) -> None:
    """A stand-in for ColorVideoVDP that sees clips, clamped."""

    def quality(film: Tensor, truth: Tensor) -> Tensor:
        assert film.shape == truth.shape == (3, 4, 3, 20, 24)
        assert 0 <= float(film.min()) <= float(film.max()) <= 1
        return 10 - (film - truth).abs().mean(dim=(1, 2, 3, 4))

    estimate, example = clips
    scores = measure(estimate, example, clip_capture, cvvdp=quality)  # pyright: ignore[reportArgumentType]
    errors = np.abs(estimate.image.numpy().clip(0, 1) - true_codes(example, clip_capture.white))
    assert [10 - score["cvvdp"] for score in scores] == pytest.approx(errors.mean(axis=(1, 2, 3, 4)).tolist(), rel=1e-4)


def test_one_plane_has_no_depth_to_be_scored(clips: tuple[Estimate, Example], clip_capture: CaptureModel) -> None:
    for score in measure(*clips, clip_capture):
        assert list(score) == ["psnr", "ssim", "linear_psnr", "flip", "moving_psnr"]


def test_a_perfect_clip_and_one_that_is_wrong_where_it_moves(
    clips: tuple[Estimate, Example], clip_capture: CaptureModel
) -> None:
    _, example = clips
    truth = linear_to_srgb(example.radiance, clip_capture.white)
    perfect = measure(Estimate(truth, torch.zeros_like(truth[:, :, :1])), example, clip_capture)[0]
    assert perfect["psnr"] == perfect["moving_psnr"] == math.inf
    # The mean over time, which a static method would give, costs more where things move than anywhere.
    static = truth.mean(dim=1, keepdim=True).expand_as(truth)
    score = measure(Estimate(static, torch.zeros_like(truth[:, :, :1])), example, clip_capture)[0]
    assert score["moving_psnr"] < score["psnr"] - 5


def test_psnr_at_counts_the_pixels_that_it_is_told() -> None:
    rng = np.random.default_rng(1)
    image, truth = (torch.from_numpy(rng.random((3, 4, 3, 5, 6))) for _ in range(2))
    counted = torch.from_numpy(rng.random((3, 1, 1, 5, 6)) < 0.4)
    counted[2] = False
    found = psnr_at(image, truth, counted)
    for clip in range(2):
        squares = ((image[clip] - truth[clip]).numpy() ** 2)[..., counted[clip, 0, 0].numpy()]
        assert found[clip].item() == pytest.approx(-10 * np.log10(squares.mean()), rel=1e-12)
    assert math.isnan(found[2].item())
    everywhere = torch.ones(1, 1, 1, 1, 1, dtype=torch.bool)
    torch.testing.assert_close(psnr_at(image, truth, everywhere), psnr(image, truth), rtol=1e-12, atol=0)


def test_clips_that_are_not_like_the_truth_are_refused(
    clips: tuple[Estimate, Example], clip_capture: CaptureModel
) -> None:
    estimate, example = clips
    with pytest.raises(InputError, match=r"^estimate\.image: "):
        measure(Estimate(estimate.image[:, :3], estimate.disparity), example, clip_capture)
    with pytest.raises(InputError, match=r"^estimate\.disparity: "):
        measure(Estimate(estimate.image, estimate.disparity[:, :, 0]), example, clip_capture)


def test_scores_over_time_are_those_of_each_frame(wide: CaptureModel) -> None:
    """Two clips of three frames, frame by frame in NumPy; of a frame in which nothing was seen there is no depth."""
    rng = np.random.default_rng(4)
    radiance, image = (rng.random((2, 3, 3, 12, 14)).astype(np.float32) for _ in range(2))
    depth_m = rng.uniform(0.04, 0.18, (2, 3, 1, 12, 14)).astype(np.float32)
    valid, disparity = rng.random(depth_m.shape) < 0.7, rng.random(depth_m.shape).astype(np.float32)
    valid[1, 2] = False
    tensors = [torch.from_numpy(each) for each in (radiance, depth_m, valid)]
    example = Example(torch.zeros(2, 3, 48, 48), *tensors)
    estimate = Estimate(torch.from_numpy(image), torch.from_numpy(disparity))
    found = measure_over_time(estimate, example, wide, tensors[2])
    truth = np.clip(linear_to_srgb(torch.from_numpy(radiance), wide.white).numpy(), 0, 1)
    found_m = 1 / (1 / 0.2 + disparity.astype(np.float64) * (1 / 0.036 - 1 / 0.2))
    for clip in range(2):
        for frame in range(3):
            expected = peak_signal_noise_ratio(truth[clip, frame], image[clip, frame], data_range=1)
            assert found[clip]["psnr"][frame] == pytest.approx(expected, abs=1e-3)
            seen = valid[clip, frame]
            error = found[clip]["depth_rmse_cm"][frame]
            if not seen.any():
                assert math.isnan(error)
                continue
            squares = (100 * (found_m - depth_m)[clip, frame][seen]) ** 2
            assert error == pytest.approx(np.sqrt(squares.mean()), rel=1e-5)
