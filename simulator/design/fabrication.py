"""What fabrication makes of a designed height map: steps, height errors, roughness and rounded edges."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from simulator.arrays import Array, is_torch, namespace, require_memory, to_numpy
from simulator.errors import InputError
from simulator.optics.mask import Mask

# Gaussian rounding of std s meets a step of J turns with a slope of J / (s sqrt(2 pi)): with samples of at most s / 1.25 a
# step of 1.5 turns stays below the half turn per sample that a smooth mask may have.
_SAMPLES_PER_ROUNDING = 1.25


def quantise(height_m: Array, step_m: float) -> Array:
    """Round heights down to whole steps.

    On torch the gradient passes straight through, as if heights were not rounded (Bengio et al., arXiv:1308.3432): the
    true one is zero almost everywhere and would teach nothing.

    Args:
        height_m: heights, metres, any shape; NumPy or torch.
        step_m: height of a step, metres; 0 leaves heights as they are.

    Returns:
        Multiples of ``step_m`` in the input's kind, shape and precision. Heights that are steps already stay.

    Example:
        >>> (quantise(np.array([0.0, 0.39e-6, 0.4e-6]), 0.2e-6) * 1e6).round(9).tolist()
        [0.0, 0.2, 0.4]
    """
    if not 0 <= step_m < math.inf:
        raise InputError("step_m", f"got {step_m:g}, expected metres from 0 (no steps) up; 0.2 um is 2e-7")
    if step_m == 0:
        return height_m
    xp = namespace(height_m)
    steps = height_m / step_m
    # A millionth of a step more: 0.6 um divided by 0.2 um is 2.9999998 in float32 and still means three steps.
    stepped = xp.floor(steps + 1e-6 * xp.abs(steps)) * step_m
    return stepped.detach() + (height_m - height_m.detach()) if is_torch(height_m) else stepped


def fabricate(
    mask: Mask,
    *,
    step_m: float = 0.0,
    height_error: float = 0.0,
    roughness_m: float = 0.0,
    rounding_m: float = 0.0,
    seed: int = 0,
) -> Mask:
    """Return the mask that a machine makes of a design, in the order in which a machine errs.

    Heights become whole steps; all of them come out too high or too low by one factor (dose, shrinkage); each mask pixel
    errs by a random amount of its own; and the finite voxel or resist blurs the height. The blur is isotropic and works
    on height, not on light. It takes place on the mask's own pixels divided until they are finer than the blur, so its
    result is a ``smooth`` mask of that finer pitch. Outside the mask the rim's height goes on.

    Args:
        mask: the design, NumPy arrays.
        step_m: height step, metres, rounded down; 0: continuous heights.
        height_error: relative error of all heights; 0.05 makes them 5 % too high.
        roughness_m: standard deviation of the random error of each mask pixel's height, metres.
        rounding_m: standard deviation of the Gaussian that rounds the edges, metres.
        seed: of the random error.

    Returns:
        The mask as made, with these numbers in its notes.

    Raises:
        InputError: for a negative length, or a height error of -1 or below.
    """
    for name, value in (("roughness_m", roughness_m), ("rounding_m", rounding_m)):
        if not 0 <= value < math.inf:
            raise InputError(name, f"got {value:g}, expected metres from 0 (perfect) up; 0.5 um is 5e-7")
    if not -1 < height_error < math.inf:
        raise InputError("height_error", f"got {height_error:g}, expected a share above -1; 5 % is 0.05")
    asked = {"step_m": step_m, "height_error": height_error, "roughness_m": roughness_m, "rounding_m": rounding_m}
    mask = replace(mask, notes={**mask.notes, "fabrication": {**asked, "seed": seed}})
    height = quantise(to_numpy(mask.height_m), step_m)
    if height_error:
        height = height * height.dtype.type(1 + height_error)
    if roughness_m:
        noise = np.random.default_rng(seed).standard_normal(height.shape)
        height = height + (roughness_m * noise).astype(height.dtype)
    if not rounding_m:
        return replace(mask, height_m=height)
    return _rounded(replace(mask, height_m=height), rounding_m)


def _rounded(mask: Mask, rounding_m: float) -> Mask:
    from scipy.ndimage import gaussian_filter

    finer = max(1, math.ceil(_SAMPLES_PER_ROUNDING * mask.pitch_m / rounding_m))
    shape = (mask.shape[0] * finer, mask.shape[1] * finer)
    # Height, amplitude and the filter's own copies, float64.
    require_memory("rounding_m", shape, 6, 8, "round more coarsely, or fabricate a crop of the mask")
    height, amplitude = (
        np.repeat(np.repeat(to_numpy(part), finer, axis=0), finer, axis=1) for part in (mask.height_m, mask.amplitude)
    )
    pitch_m = mask.pitch_m / finer
    height = gaussian_filter(height, rounding_m / pitch_m, mode="nearest")
    return replace(mask, height_m=height, amplitude=amplitude, pitch_m=pitch_m, profile="smooth")
