"""What depth planes cost: light from between two of them is blended from both, though its own PSF is another."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import to_numpy
from simulator.optics.mask import Mask
from simulator.optics.psf import Progress, PsfConfig, depth_images, psf_lines, stack_size
from simulator.optics.stack import PsfStack, depth_planes
from simulator.types import CameraGeometry, View

WARN = 0.05
GOAL = 0.03
"""The largest error that a number of planes which is named as the cure leaves."""
_ROUNDS = 5
_MOST = 400  # planes: a cure that needs more is none


def planes_error(
    mask: Mask,
    camera: CameraGeometry,
    psf_config: PsfConfig,
    stack: PsfStack | None = None,
    view: View | None = None,
    *,
    every: bool = False,
    threads: int = 1,
    progress: Progress | None = None,
) -> dict[str, Any] | None:
    """Measure the relative L2 difference of two planes' mean from the PSF half-way between them in disparity.

    The whole mask is judged, since its rim moves the most, in the middle one of the channels. Planes do not know the depth
    model, so the fast one stands for ``exact``. A single plane is judged at both ends of the scene's depths.

    Args:
        mask: the mask.
        camera: distance or layers, binned pixel pitch, spectral response.
        psf_config: depths, model, wavelengths, oversampling.
        stack: the PSFs of these arguments, where they are there already.
        view: gives the scene's range of depths, for a stack of one plane.
        every: judge all gaps between planes; else the first, the middle and the last: the error changes slowly with depth.
        threads: as in ``compute_psf_stack``.
        progress: called with (done, total) after every PSF of the planes that are there.

    Returns:
        ``error`` (the largest), ``rms`` and ``table``, one row per gap; above ``WARN`` also ``enough``, a number of planes
        at even steps of disparity, and ``enough_error``, what was measured with it, at most ``GOAL``. JSON-serialisable;
        None where one plane is all that the scene has.
    """
    if psf_config.model == "exact":
        psf_config, stack = replace(psf_config, model="scaled_distance"), None
    ends = _scene_ends(psf_config, view)
    if not ends and len(psf_config.depths_m) == 1:
        return None
    table = _judged(mask, camera, psf_config, stack, ends, every, threads, progress)
    errors = np.array([row["error"] for row in table])
    report = {"error": float(errors.max()), "rms": float(np.sqrt(np.mean(errors**2))), "table": table}
    if report["error"] > WARN:
        found = _enough(mask, camera, psf_config, ends, report["error"], threads)
        if found is not None:
            report |= dict(zip(("enough", "enough_error"), found, strict=True))
    return report


def _scene_ends(psf_config: PsfConfig, view: View | None) -> tuple[float, ...]:
    """Return the nearest and the farthest depth of the scene, metres, for a stack of one plane; none for another."""
    first, *others = psf_config.depths_m
    if view is None or others:
        return ()
    return tuple(end for end in (view.near_m, view.far_m) if not math.isclose(end, first))


def _judged(
    mask: Mask,
    camera: CameraGeometry,
    psf_config: PsfConfig,
    stack: PsfStack | None,
    ends: tuple[float, ...],
    every: bool,
    threads: int,
    progress: Progress | None = None,
) -> list[dict[str, float]]:
    """Return a row per judged gap: between which planes, at which depth, with which error."""
    planes = psf_config.depths_m
    if len(planes) == 1:
        gaps = [(planes[0], end, planes[0]) for end in ends]
    else:
        disparity = 1 / np.asarray(planes)
        middles = 2 / (disparity[1:] + disparity[:-1])
        gaps = list(zip(planes[:-1], middles.tolist(), planes[1:], strict=True))
        last = len(gaps) - 1
        gaps = gaps if every else [gaps[k] for k in sorted({0, last // 2, last})]
    wanted = sorted({middle for _, middle, _ in gaps} | (set() if stack else {z for a, _, b in gaps for z in (a, b)}))
    channel = len(camera.response.channels) // 2
    size = stack_size(mask, camera, replace(psf_config, depths_m=tuple(wanted)))
    images: dict[float, NDArray[np.floating]] = {}
    if stack is not None:
        size = max(size, stack.values.shape[-1])
        shown = to_numpy(stack.values[:, channel])
        margin = (size - shown.shape[-1]) // 2
        images = {z: np.pad(shown[k], margin) for k, z in enumerate(planes)}
    config = replace(psf_config, depths_m=tuple(wanted))
    lines = [line for line in psf_lines(camera.response, psf_config) if line.channel == channel]
    for number, line in enumerate(lines):
        made = depth_images(mask, camera, config, line.wavelength_m, size, threads=threads)
        for k, (depth_m, image) in enumerate(zip(wanted, made, strict=True)):
            images[depth_m] = images.get(depth_m, 0.0) + line.weight * image
            if progress is not None:
                progress(number * len(wanted) + k + 1, len(lines) * len(wanted))
    return [
        {"near_m": near, "depth_m": middle, "far_m": far, "error": _blend_error(images, near, middle, far)}
        for near, middle, far in gaps
    ]


def _blend_error(images: dict[float, NDArray[np.floating]], near: float, middle: float, far: float) -> float:
    own = images[middle]
    return float(np.linalg.norm((images[near] + images[far]) / 2 - own) / np.linalg.norm(own))


def _enough(
    mask: Mask, camera: CameraGeometry, psf_config: PsfConfig, ends: tuple[float, ...], error: float, threads: int
) -> tuple[int, float] | None:
    """Return a number of planes that was found to err by at most ``GOAL``, and its error; None where there is none.

    The error falls like the step between planes to the power of 1.5 to 2: begun with the latter, so that no number is
    passed by far, the search takes from then on the power that it meets.
    """
    near, far = min((*psf_config.depths_m, *ends)), max((*psf_config.depths_m, *ends))
    gaps, power = max(len(psf_config.depths_m) - 1, 1), 2.0
    if len(psf_config.depths_m) == 1:
        error *= 0.25  # from the farthest plane to the middle of two
    for _ in range(_ROUNDS):
        finer = math.ceil(max(gaps * (error / GOAL) ** (1 / power), gaps + 1))
        if finer >= _MOST:
            return None
        depths = tuple(depth_planes(near, far, finer + 1).tolist())
        rows = _judged(mask, camera, replace(psf_config, depths_m=depths), None, (), False, threads)
        found = max(row["error"] for row in rows)
        if found <= GOAL:
            return finer + 1, found
        power = min(max(math.log(error / found) / math.log(finer / gaps), 0.5), 2.0) if found < error else 1.0
        gaps, error = finer, found
    return None
