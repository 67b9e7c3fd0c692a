"""How far an estimate is from the truth, scene by scene: image in sRGB codes and in linear light, depth in cm and in 1 / z.

Every method's estimate is clamped to its ranges first. Images are judged at all pixels; depth at those that are asked for.
"""

from __future__ import annotations

from typing import Any, NamedTuple, cast

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from learning.camera import CaptureModel
from learning.data import Example
from learning.method import Estimate, linear_to_srgb, srgb_to_linear
from learning.perceptual import PIXELS_PER_DEGREE, LpipsDistance
from learning.video_quality import VideoQuality
from simulator.errors import InputError

SSIM_PIXELS = 11
"""Side of SSIM's window: smaller images have none."""

SSIM_DEFINITION = (
    "Wang et al. 2004 on sRGB codes 0..1, channel by channel, then their mean: Gaussian window of 11 x 11 pixels, sigma 1.5, "
    "K1 0.01, K2 0.03, population covariance, data range 1, windows that lie wholly inside (scikit-image)"
)

DEFINITIONS = {
    "psnr": "PSNR of sRGB codes 0..1 in dB, peak 1, over all pixels and channels of a scene; inf where they are equal",
    "ssim": SSIM_DEFINITION,
    "linear_psnr": "PSNR of linear radiance / white in dB, peak 1; the truth is clipped at white, as images are",
    "flip": f"mean FLIP (LDR) of Andersson et al. 2020 at {PIXELS_PER_DEGREE:.2f} pixels per degree; lower is better",
    "lpips": "LPIPS 0.1 of Zhang et al. 2018; lower is better",
    "cvvdp": "ColorVideoVDP of Mantiuk et al. 2024 of a clip in just-objectionable differences: 10 is perfect, less is worse",
    "moving_psnr": "PSNR at pixels where, in any frame, a true sRGB code differs from its mean over time by more than 0.1",
    "warping_error": "of a clip, root mean square change of sRGB codes along the true motion, frame to frame: "
    "flicker; the truth's is right, less is blur",
    "true_warping_error": "the same of the truth",
    "depth_rmse_cm": "root mean square error of depth in cm",
    "disparity_rmse": "root mean square error of disparity, evenly in 1 / z from 0 (far) to 1 (near)",
    "disparity_rmse_per_m": "root mean square error of 1 / z in 1 / m",
}
"""Of each score that `measure` gives, in words for a table."""

_MOVES = 0.1  # sRGB codes, well above the noise of rendered images

_LUMINANCE = (0.2126, 0.7152, 0.0722)  # of linear sRGB: IEC 61966-2-1, ITU-R BT.709


class DepthScores(NamedTuple):
    """Root mean square errors of each scene, ``(B,)`` float64; NaN where no pixel counts. See `DEFINITIONS`."""

    depth_rmse_cm: Tensor
    disparity_rmse: Tensor
    disparity_rmse_per_m: Tensor


def measure(
    estimate: Estimate,
    example: Example,
    capture: CaptureModel,
    *,
    lpips: LpipsDistance | None = None,
    cvvdp: VideoQuality | None = None,
    pixels: Tensor | None = None,
) -> list[dict[str, float]]:
    """Return the scores of each of B scenes by name; see `DEFINITIONS`. The estimate is clamped here.

    Of clips, SSIM, FLIP and LPIPS are means over the frames. Depth has scores where the camera tells several depths apart.
    ``pixels``, bool like ``example.valid``, are where depth counts; None is everywhere.

    Raises:
        InputError: shapes that differ, images below 11 x 11 pixels, or an estimate with NaN or infinite numbers.
    """
    _check(estimate, example)
    estimate = estimate.clamped()
    truth = linear_to_srgb(example.radiance, capture.white)
    scenes, frames = len(truth), truth.shape[1] if truth.ndim == 5 else 1
    pairs = zip(_channels_last(estimate.image), _channels_last(truth), strict=True)
    of_frames = [image_scores(one, other) for one, other in pairs]
    linear = psnr(srgb_to_linear(estimate.image, 1.0), (example.radiance / capture.white).clamp(0, 1))
    columns = {"psnr": psnr(estimate.image, truth), "linear_psnr": linear}
    if truth.ndim == 5:
        columns["moving_psnr"] = psnr_at(estimate.image, truth, moving_pixels(truth))
        if cvvdp is not None:
            columns["cvvdp"] = cvvdp(estimate.image, truth)
    if lpips is not None:
        every = lpips(*(each.flatten(0, -4) for each in (estimate.image, truth)))
        columns["lpips"] = every.unflatten(0, (scenes, -1)).mean(dim=1)
    if len(capture.stack.depths_m) > 1:
        columns |= depth_scores(estimate, example, capture, pixels)._asdict()
    by_scene = []
    for scene in range(scenes):
        own = of_frames[scene * frames : (scene + 1) * frames]
        means = {name: float(np.mean([each[name] for each in own])) for name in own[0]}
        by_scene.append({name: values[scene].item() for name, values in columns.items()} | means)
    return [{name: scene[name] for name in DEFINITIONS if name in scene} for scene in by_scene]


def measure_over_time(
    estimate: Estimate, example: Example, capture: CaptureModel, pixels: Tensor | None = None
) -> list[dict[str, list[float]]]:
    """Return ``psnr`` and, where the camera tells depths apart, ``depth_rmse_cm`` of every frame of each of B clips.

    See `measure`, which has their checks; a frame without pixels that count has NaN for depth.
    """
    frames = example.radiance.shape[1]
    image, disparity = (values.flatten(0, 1) for values in estimate.clamped())
    columns = {"psnr": psnr(image, linear_to_srgb(example.radiance, capture.white).flatten(0, 1))}
    if len(capture.stack.depths_m) > 1:
        alone = example._replace(depth_m=example.depth_m.flatten(0, 1), valid=example.valid.flatten(0, 1))
        counted = None if pixels is None else pixels.flatten(0, 1)
        columns["depth_rmse_cm"] = depth_scores(Estimate(image, disparity), alone, capture, counted).depth_rmse_cm
    by_clip = (values.unflatten(0, (-1, frames)).tolist() for values in columns.values())
    return [dict(zip(columns, clip, strict=True)) for clip in zip(*by_clip, strict=True)]


def psnr(image: Tensor, truth: Tensor) -> Tensor:
    """Return the PSNR of each image or clip, ``(B,)`` float64, in dB with peak 1; infinite where both are equal."""
    return -10 * (image.double() - truth.double()).square().flatten(1).mean(dim=1).log10()


def psnr_at(image: Tensor, truth: Tensor, counted: Tensor) -> Tensor:
    """Return the same at the pixels that count, bool like ``image`` or broadcast to it; NaN where none does."""
    counted = counted.expand_as(image).flatten(1)
    squares = (image.double() - truth.double()).square().flatten(1)
    return -10 * (torch.where(counted, squares, 0).sum(dim=1) / counted.sum(dim=1)).log10()


def moving_pixels(truth: Tensor) -> Tensor:
    """Return where clips ``(B, N, 3, h, w)``, sRGB codes, move: ``(B, 1, 1, h, w)`` bool; see `DEFINITIONS`."""
    return (truth - truth.mean(dim=1, keepdim=True)).abs().amax(dim=(1, 2), keepdim=True) > _MOVES


def image_scores(image: NDArray[np.float32], truth: NDArray[np.float32]) -> dict[str, float]:
    """Return ``ssim`` and ``flip`` of an image ``(h, w, 3)``, sRGB codes 0..1, float32."""
    import flip_evaluator
    from skimage.metrics import structural_similarity

    window: Any = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    exact = (truth.astype(np.float64), image.astype(np.float64))
    similarity = structural_similarity(*exact, channel_axis=-1, data_range=1.0, **window)
    _, error, _ = flip_evaluator.evaluate(truth, image, "LDR", applyMagma=False, parameters={"ppd": PIXELS_PER_DEGREE})
    return {"ssim": float(cast("float", similarity)), "flip": float(error)}


def depth_scores(
    estimate: Estimate, example: Example, capture: CaptureModel, pixels: Tensor | None = None
) -> DepthScores:
    """Return the depth errors of each scene; the estimate is clamped to the range, the truth's depth in cm is not.

    ``pixels``, bool like ``example.valid``, are those that count, None are all.
    """
    disparity, true_m = estimate.disparity.double().clamp(0, 1), example.depth_m.double()
    found_m = capture.depth_m(disparity)
    # Of a pixel at infinity that was found there, the difference is not a number.
    error_cm = torch.where(found_m == true_m, 0.0, 100 * (found_m - true_m))
    counted = torch.ones_like(example.valid) if pixels is None else pixels
    return DepthScores(
        _rms(error_cm, counted),
        _rms(disparity - capture.disparity(true_m), counted),
        _rms(1 / found_m - 1 / true_m, counted),
    )


def dark_mask(example: Example, capture: CaptureModel, share: float) -> Tensor:
    """Return where scenes are darker than a share (0..1) of white's luminance, bool like ``example.valid``."""
    if not 0 <= share <= 1:
        raise InputError("share", f"got {share!r}, expected 0 to 1: a share of white's luminance")
    weights = torch.tensor(_LUMINANCE, dtype=example.radiance.dtype, device=example.radiance.device)
    return torch.einsum("c,b...chw->b...hw", weights, example.radiance).unsqueeze(-3) < share * capture.white


def _rms(error: Tensor, counted: Tensor) -> Tensor:
    squares = torch.where(counted, error.square(), 0.0).flatten(1).sum(dim=1)
    return (squares / counted.flatten(1).sum(dim=1)).sqrt()


def _channels_last(images: Tensor) -> NDArray[np.float32]:
    """Return all images or frames ``(n, h, w, 3)``."""
    every = images.detach().float().cpu().flatten(0, -4)
    return np.ascontiguousarray(every.permute(0, 2, 3, 1).numpy())


def _check(estimate: Estimate, example: Example) -> None:
    for name, found, wanted in zip(Estimate._fields, estimate, (example.radiance, example.depth_m), strict=True):
        if found.shape != wanted.shape or found.ndim not in (4, 5):
            shapes = f"got shape {tuple(found.shape)}, expected {tuple(wanted.shape)}"
            raise InputError(f"estimate.{name}", f"{shapes} of a batch of examples")
        if not bool(found.isfinite().all()):
            count = int((~found.isfinite()).sum())
            raise InputError(f"estimate.{name}", f"{count} of {found.numel()} numbers are NaN or infinite")
    height, width = estimate.image.shape[-2:]
    if min(height, width) < SSIM_PIXELS:
        raise InputError("estimate.image", f"got {height} x {width} pixels, expected {SSIM_PIXELS} per side for SSIM")
