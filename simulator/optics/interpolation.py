"""A PSF stack at other depths: neighbouring planes brought to the wanted magnification, then blended in disparity.

A PSF from depth z is the one from infinity magnified by m = 1 + d/z, but for the change of its diffraction distance.
Magnification is undone exactly, energy kept; what is left changes slowly and is blended. m is linear in disparity 1/z.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import to_numpy
from simulator.errors import InputError
from simulator.optics.stack import PsfStack, check_depths
from simulator.text import length

_SAME_DEPTH = 1e-9  # relative: centimetres and metres of one depth differ by rounding


def interpolate_stack(
    stack: PsfStack, depths_m: Sequence[float], mask_to_sensor_m: float, *, extrapolate: bool = False
) -> PsfStack:
    """Return the stack at other depths; its own depths give its own values, bit by bit.

    The sources are taken to lie on the axis through the mask's centre, whose image is the grid's origin: that is the point
    about which PSFs are magnified.

    Args:
        stack: the stack to start from.
        depths_m: ``(K',)`` wanted depths, metres from the mask, strictly increasing; the last may be ``inf``.
        mask_to_sensor_m: d, distance from mask to sensor (in air), metres.
        extrapolate: whether depths outside the stack's are allowed: the outermost plane, magnified.

    Returns:
        The stack at ``depths_m``; ``provenance["interpolation"]`` states the relative L2 error of every new plane as the
        largest of its neighbours' ``left_out_errors`` and of what magnifying them to this depth and back costs: light
        finer than a pixel does not survive resampling, however near the planes. None where nothing can be said.

    Raises:
        InputError: for depths outside the stack's range that are not allowed, or an implausible distance.
    """
    wanted = np.asarray(depths_m, np.float64)
    check_depths(wanted)
    if not 0 < mask_to_sensor_m < np.inf:
        raise InputError("mask_to_sensor_m", f"got {mask_to_sensor_m!r}, expected positive metres")
    own = stack.depths_m
    outside = [float(depth) for depth in wanted if _same(own, depth) is None and not own[0] < depth < own[-1]]
    if outside and not extrapolate:
        span = length(own[0]) if len(own) == 1 else f"{length(own[0])} to {length(own[-1])}"
        raise InputError(
            "depths_m",
            f"got {', '.join(map(length, outside[:5]))}, outside the stack's {span}; choose depths within, or set "
            "extrapolate to magnify the outermost plane",
        )
    errors = left_out_errors(stack, mask_to_sensor_m)
    planes, records = [], []
    for depth in wanted:
        mixture = _mixture(own, float(depth))
        planes.append(_mixed(stack, mixture, float(depth), mask_to_sensor_m))
        records.append(
            {
                "depth_m": _json(depth),
                "from_planes": [k for k, _ in mixture],
                "extrapolated": float(depth) in outside,
                "error": _stated_error(stack, mixture, float(depth), mask_to_sensor_m, errors),
            }
        )
    interpolation = {
        "of": stack.fingerprint,
        "mask_to_sensor_m": mask_to_sensor_m,
        "measured_depths_m": [_json(depth) for depth in own],
        "left_out_errors": errors,
        "planes": records,
    }
    identity = repr((stack.fingerprint, wanted.tolist(), mask_to_sensor_m))
    return replace(
        stack,
        values=np.stack(planes),
        depths_m=wanted,
        fingerprint=hashlib.sha256(identity.encode()).hexdigest(),
        provenance=stack.provenance | {"interpolation": interpolation},
    )


def left_out_errors(stack: PsfStack, mask_to_sensor_m: float) -> list[float | None]:
    """Return, for every plane, the relative L2 error with which its neighbours alone would predict it.

    An inner plane is interpolated over twice the distance that interpolation has to bridge, an outermost one is extrapolated
    from its only neighbour: as far as PSFs change with depth, both are harder than what ``interpolate_stack`` does between
    planes. Noise and faults of the measured planes count in full. A single plane says nothing: None.
    """
    values, own = to_numpy(stack.values), stack.depths_m
    errors: list[float | None] = []
    for k, depth in enumerate(own):
        others = np.delete(np.arange(len(own)), k)
        if not len(others):
            return [None]
        mixture = [(int(others[j]), weight) for j, weight in _mixture(own[others], float(depth))]
        predicted = _mixed(stack, mixture, float(depth), mask_to_sensor_m)
        errors.append(float(np.linalg.norm(predicted - values[k]) / np.linalg.norm(values[k])))
    return errors


def _stated_error(
    stack: PsfStack,
    mixture: list[tuple[int, float]],
    depth_m: float,
    mask_to_sensor_m: float,
    left_out: list[float | None],
) -> float | None:
    """Return the error to state for a plane made from a mixture; zero for a plane of the stack, None if unknown."""
    values, own = to_numpy(stack.values), stack.depths_m
    if _same(own, depth_m) is not None:
        return 0.0
    found = [error for k, _ in mixture if (error := left_out[k]) is not None]
    if len(found) < len(mixture):
        return None
    for k, _ in mixture:
        factor = (1 + mask_to_sensor_m / depth_m) / (1 + mask_to_sensor_m / own[k])
        back = magnified(magnified(values[k], factor), 1 / factor)
        found.append(float(np.linalg.norm(back - values[k]) / np.linalg.norm(values[k])))
    return max(found)


def magnified(image: NDArray[Any], factor: float) -> NDArray[np.float64]:
    """Magnify images about sample ``(H // 2, W // 2)``, keeping energy (what leaves the grid is lost) and sign.

    Samples are integrals over pixels, so their running sum is known exactly at pixel edges. It is interpolated there by
    monotone cubics (Fritsch and Carlson, SIAM J. Numer. Anal. 17, 238, 1980) and its differences are the new pixels.

    Args:
        image: ``(..., H, W)``, not negative.
        factor: magnification, positive.
    """
    return _stretched(_stretched(np.asarray(image, np.float64), factor, -1), factor, -2)


def _stretched(image: NDArray[np.float64], factor: float, axis: int) -> NDArray[np.float64]:
    from scipy.interpolate import PchipInterpolator

    size = image.shape[axis]
    edges = np.arange(size + 1) - 0.5 - size // 2
    running = np.insert(np.cumsum(image, axis), 0, 0.0, axis)
    new = np.clip(edges / factor, edges[0], edges[-1])  # beyond the grid the running sum stands still
    # Monotone but for rounding, which must not make light negative.
    return np.maximum(np.diff(PchipInterpolator(edges, running, axis=axis)(new), axis=axis), 0)


def _mixed(stack: PsfStack, mixture: list[tuple[int, float]], depth_m: float, mask_to_sensor_m: float) -> NDArray[Any]:
    """Return the weighted sum of planes, each magnified to that of a depth, ``(C, H, W)``."""
    values, own = to_numpy(stack.values), stack.depths_m
    if len(mixture) == 1 and _same(own, depth_m) == mixture[0][0]:
        return values[mixture[0][0]]
    m = 1 + mask_to_sensor_m / depth_m
    mixed = sum(weight * magnified(values[k], m / (1 + mask_to_sensor_m / own[k])) for k, weight in mixture)
    return np.asarray(mixed, values.dtype)


def _mixture(own_m: NDArray[np.float64], depth_m: float) -> list[tuple[int, float]]:
    """Return the planes, and their weights, that make a depth: itself, two neighbours, or the outermost one."""
    same = _same(own_m, depth_m)
    if same is not None:
        return [(same, 1.0)]
    after = int(np.searchsorted(own_m, depth_m))
    if after in (0, len(own_m)):
        return [(min(after, len(own_m) - 1), 1.0)]
    near, far, here = 1 / own_m[after - 1], 1 / own_m[after], 1 / depth_m
    weight = float((here - far) / (near - far))
    return [(after - 1, weight), (after, 1 - weight)]


def _same(own_m: NDArray[np.float64], depth_m: float) -> int | None:
    """Return the plane at a depth, or None."""
    hits = np.flatnonzero(np.abs(1 / own_m - 1 / depth_m) <= _SAME_DEPTH / depth_m)
    return int(hits[0]) if len(hits) else None


def _json(depth_m: float) -> float | str:
    """JSON has no infinity."""
    return float(depth_m) if np.isfinite(depth_m) else "inf"
