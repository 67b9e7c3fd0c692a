"""Depth from focus: what it costs a pixel to lie at a plane of a volume, and the all-in-focus image at the planes chosen.

The unary cost is that of thesis equation 5.5, or one for volumes that share the light out among their planes.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from learning.camera import CaptureModel
from learning.method import Estimate, check_choices, linear_to_srgb
from simulator.arrays import like
from simulator.errors import InputError

MEASURES = ("gradient", "laplacian", "light")
COSTS = ("defocus", "spread")


def sharpness(volume: Tensor, measure: str = "gradient") -> Tensor:
    """Return how sharp or how bright each pixel is, ``(B, K, h, w)``; squares, in the volume's unit squared.

    Args:
        volume: ``(B, K, C, h, w)``; channels are summed.
        measure: ``gradient``, |grad I|^2, the mean of both neighbours' squared differences per axis, as the thesis;
            ``laplacian``, (Delta I)^2 with the five-point stencil, which weighs fine detail more; ``light``, I^2, for volumes
            such as ADMM's whose light lies at its plane.

    """
    if volume.ndim != 5:
        raise InputError("volume", f"got shape {tuple(volume.shape)}, expected (B, K, C, h, w)")
    if measure == "light":
        return volume.square().sum(dim=2)
    if measure == "laplacian":
        bent = [after - before for before, after in (_differences(volume, dim) for dim in (-2, -1))]
        return (bent[0] + bent[1]).square().sum(dim=2)
    check_choices(("measure", measure, MEASURES))
    return torch.stack([_squared_slope(volume, dim) for dim in (-2, -1)]).sum(dim=0).sum(dim=2)


def unary_cost(
    volume: Tensor, *, cost: str, measure: str, contrast: float, window_px: float, steps_between_planes: int
) -> Tensor:
    """Return the cost of each label at each pixel, ``(B, L, h, w)``, free of the volume's unit.

    Labels lie evenly from the first plane to the last. With s the sharpness and G a Gaussian window, whose weights add up to
    one at edges too:

    - ``defocus``, the thesis: ``G exp(-contrast s / mean s)``. The thesis writes exp(-|grad I|^2), which depends on the
      image's unit; here s is relative to its mean over the scene's stack. Alone, a pixel chooses where it is sharpest.
      Labels are the planes, L = K, however many steps: interpolated linearly, its least energy would lie at planes as well.
    - ``spread``: ``sum_k w_k (x - k)^2 / (K - 1)^2``, weights ``w = (G s)^contrast`` that add up to one over the planes.
      Labels x lie between planes too, L = steps (K - 1) + 1. Alone, a pixel chooses the centroid of its light. For volumes
      in which the light of a surface lies on several planes, to both sides of it: ADMM's, whose outer planes attract what
      the inner ones cannot tell apart; and for noisy ones.

    Args:
        volume: ``(B, K, C, h, w)``, any unit.
        cost: ``defocus`` or ``spread``.
        measure: s; see `sharpness`.
        contrast: small ones let the planes count nearly alike, large ones let the sharpest decide.
        window_px: the window's standard deviation; 0 for none.
        steps_between_planes: labels from one plane to the next, for ``spread``; 1 has the planes alone.

    Raises:
        InputError: another shape, cost or measure, a contrast that is not positive, a negative window, or no step.
    """
    if not (math.isfinite(contrast) and contrast > 0):
        raise InputError("contrast", f"got {contrast!r}, expected a positive number: of 0 all planes cost the same")
    if not (math.isfinite(window_px) and window_px >= 0):
        raise InputError("window_px", f"got {window_px!r}, expected 0 (no average) or a standard deviation in pixels")
    if steps_between_planes < 1:
        raise InputError("steps_between_planes", f"got {steps_between_planes!r}, expected 1 (the planes alone) or more")
    sharp = sharpness(volume, measure)
    if cost == "defocus":
        mean = sharp.mean(dim=(1, 2, 3), keepdim=True)
        # A black stack is equally sharp everywhere; NaN stays NaN, for the graph cut to refuse.
        return gaussian_mean(torch.exp(-contrast * sharp / torch.where(mean == 0, 1.0, mean)), window_px)
    check_choices(("cost", cost, COSTS))
    return _spread(gaussian_mean(sharp, window_px), contrast, steps_between_planes)


def _spread(sharp: Tensor, contrast: float, steps: int) -> Tensor:
    """Return the mean squared distance of each label to the light, in units of the whole stack."""
    highest = sharp.amax(dim=1, keepdim=True)
    # Where there is no light, all planes have the same share of it. The scale keeps high powers from vanishing.
    weights = torch.where(highest == 0, 1.0, sharp / highest) ** contrast
    weights = weights / weights.sum(dim=1, keepdim=True)
    intervals = max(sharp.shape[1] - 1, 1)
    labels = torch.arange(steps * (sharp.shape[1] - 1) + 1, device=sharp.device, dtype=sharp.dtype)
    labels /= steps * intervals
    return torch.einsum("xk,bkhw->bxhw", (labels[:, None] - labels[::steps]).square(), weights)


def gaussian_mean(values: Tensor, window_px: float) -> Tensor:
    """Return the average of ``(..., h, w)`` in a Gaussian window, whose weights add up to one at edges too."""
    rows, columns = (_window(size, window_px, values) for size in values.shape[-2:])
    return rows @ values @ columns.mT


def _differences(volume: Tensor, dim: int) -> tuple[Tensor, Tensor]:
    """Return the differences to the neighbour before and to that after, 0 where there is none."""
    step = torch.diff(volume, dim=dim)
    none = torch.zeros_like(volume.narrow(dim, 0, 1))
    return torch.cat([none, step], dim=dim), torch.cat([step, none], dim=dim)


def _squared_slope(volume: Tensor, dim: int) -> Tensor:
    """Return the mean of the squared differences to the neighbours that there are."""
    before, after = _differences(volume, dim)
    neighbours = torch.full((volume.shape[dim],), 2.0, device=volume.device, dtype=volume.dtype)
    neighbours[0] -= 1
    neighbours[-1] -= 1
    shape = [1] * volume.ndim
    shape[dim] = -1
    return (before.square() + after.square()) / neighbours.clamp_min(1).reshape(shape)


def _window(size: int, sigma_px: float, like: Tensor) -> Tensor:
    """Return the matrix ``(size, size)`` that averages along an axis, rows adding up to one."""
    places = torch.arange(size, device=like.device, dtype=like.dtype)
    if sigma_px == 0:
        return torch.diag(torch.ones_like(places))
    weights = torch.exp(-0.5 * ((places[:, None] - places) / sigma_px).square())
    return weights / weights.sum(dim=1, keepdim=True)


LIGHT = ("label", "sum")


def assemble(volume: Tensor, places: Tensor, capture: CaptureModel, light: str) -> Estimate:
    """Return the all-in-focus image and the depth map.

    Args:
        volume: ``(B, K, C, h, w)`` in the camera's channels, 1 for white, free of the irradiance map.
        places: ``(B, h, w)``, 0 at the capture's first plane to K - 1 at its last, fractions between two; disparity goes
            linearly from plane to plane.
        capture: the camera.
        light: ``label`` takes each pixel from its place, as the thesis, linearly between the two planes around it; ``sum``
            adds up the planes, for volumes that share the light out among them, such as ADMM's.

    Raises:
        InputError: shapes that do not fit, places outside the volume, or another ``light``.
    """
    planes = len(capture.stack.depths_m)
    if volume.ndim != 5 or volume.shape[1] != planes or places.shape != (*volume.shape[:1], *volume.shape[3:]):
        got, wanted = f"{tuple(volume.shape)} and {tuple(places.shape)}", f"(B, K, C, h, w) and (B, h, w), K = {planes}"
        raise InputError("volume, places", f"got shapes {got}, expected {wanted} as in the capture's stack")
    low, high = float(places.min()), float(places.max())
    if not (low >= 0 and high <= planes - 1):
        raise InputError("places", f"got {low:g} to {high:g}, expected 0 to {planes - 1}, first plane to last")
    before = places.floor().long()
    after = (before + 1).clamp_max(planes - 1)
    share = (places - before).to(volume)
    disparities = like(capture.plane_disparities(), volume)
    disparity = torch.lerp(disparities[before], disparities[after], share)[:, None]
    check_choices(("light", light, LIGHT))
    if light == "sum":
        combined = volume.sum(dim=1)
    else:
        one, other = (torch.take_along_dim(volume, at[:, None, None], dim=1)[:, 0] for at in (before, after))
        combined = torch.lerp(one, other, share[:, None])
    return Estimate(linear_to_srgb(capture.to_srgb(combined), 1.0, clip=False), disparity)
