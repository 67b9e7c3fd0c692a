"""A PSF stack at other depths: neighbouring planes brought to the wanted magnification, then blended in disparity.

A PSF from depth z is the one from infinity magnified by m = 1 + d/z, but for the change of its diffraction distance.
Magnification is undone exactly, energy kept; what is left changes slowly and is blended. m is linear in disparity 1/z.
Measured planes are laid on one axis and brought to one exposure on the way, in the same resampling.
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
from simulator.optics.registration import Registration
from simulator.optics.resample import magnified
from simulator.optics.stack import PsfStack, check_depths
from simulator.text import length, share

MOST_ERROR = 1.0
"""Relative L2 error from which on a plane is worse than none at all."""
_SAME_DEPTH = 1e-9  # relative: centimetres and metres of one depth differ by rounding


def interpolate_stack(
    stack: PsfStack,
    depths_m: Sequence[float],
    mask_to_sensor_m: float,
    *,
    extrapolate: bool = False,
    registration: Registration | None = None,
    accept_error: float = MOST_ERROR,
) -> PsfStack:
    """Return the stack at other depths; its own depths give its own values, bit by bit where no registration moves them.

    The sources are taken to lie on the axis through the mask's centre, whose image is the grid's origin: that is the point
    about which PSFs are magnified. Of a measured stack, ``registration`` says where they lay instead.

    Args:
        stack: the stack to start from.
        depths_m: ``(K',)`` wanted depths, metres from the mask, strictly increasing; the last may be ``inf``.
        mask_to_sensor_m: d, distance from mask to sensor (in air), metres.
        extrapolate: whether depths outside the stack's are allowed: the outermost plane, magnified.
        registration: of a measured stack (``register_stack``): shifts and exposures that are taken out.
        accept_error: greatest stated error that a plane may have.

    Returns:
        The stack at ``depths_m``; ``provenance["interpolation"]`` states the relative L2 error of every new plane as the
        largest of its neighbours' ``left_out_errors`` and of what magnifying them to this depth and back costs: light
        finer than a pixel does not survive resampling, however near the planes. None where nothing can be said.

    Raises:
        InputError: for depths outside the stack's range that are not allowed, an implausible distance, or a plane whose
            stated error is beyond ``accept_error``.
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
    planes_of = _Planes(stack, mask_to_sensor_m, registration or Registration.none(len(own)))
    errors = planes_of.left_out_errors()
    planes, records = [], []
    for depth in wanted:
        mixture = _mixture(own, float(depth))
        planes.append(planes_of.mixed(mixture, float(depth)))
        error = planes_of.stated_error(mixture, float(depth), errors)
        if error is not None and error > accept_error:
            raise InputError("accept_error", _too_far_off(float(depth), error, accept_error, registration))
        records.append(
            {
                "depth_m": _json(depth),
                "from_planes": [k for k, _ in mixture],
                "extrapolated": float(depth) in outside,
                "error": error,
            }
        )
    interpolation = {
        "of": stack.fingerprint,
        "mask_to_sensor_m": mask_to_sensor_m,
        "measured_depths_m": [_json(depth) for depth in own],
        "left_out_errors": errors,
        "planes": records,
    }
    told = {} if registration is None else {"registration": registration.record()}
    identity = repr((stack.fingerprint, wanted.tolist(), mask_to_sensor_m, *told.values()))
    return replace(
        stack,
        values=np.stack(planes),
        depths_m=wanted,
        fingerprint=hashlib.sha256(identity.encode()).hexdigest(),
        provenance=stack.provenance | {"interpolation": interpolation} | told,
    )


def left_out_errors(
    stack: PsfStack, mask_to_sensor_m: float, registration: Registration | None = None
) -> list[float | None]:
    """Return, for every plane, the relative L2 error with which its neighbours alone would predict it.

    An inner plane is interpolated over twice the distance that interpolation has to bridge, an outermost one is extrapolated
    from its only neighbour: as far as PSFs change with depth, both are harder than what ``interpolate_stack`` does between
    planes. Noise and faults of the measured planes count in full, but for the shifts and exposures of a ``registration``:
    each plane is predicted where it lies, as bright as it is. A single plane says nothing: None.
    """
    return _Planes(stack, mask_to_sensor_m, registration or Registration.none(len(stack.depths_m))).left_out_errors()


class _Planes:
    """The planes of a stack: each is the common pattern, magnified by m about the origin, shifted by t, e times as bright."""

    def __init__(self, stack: PsfStack, mask_to_sensor_m: float, registration: Registration) -> None:
        self._values, self._own, self._d = to_numpy(stack.values), stack.depths_m, mask_to_sensor_m
        self._shifts, self._exposures = registration.shifts_px, registration.exposures

    def mixed(self, mixture: list[tuple[int, float]], depth_m: float, onto: int | None = None) -> NDArray[Any]:
        """Return the weighted sum of planes magnified to a depth, ``(C, H, W)``; where and as bright as plane ``onto`` is."""
        shift, exposure = (0.0, 1.0) if onto is None else (self._shifts[onto], self._exposures[onto])
        if onto is None and len(mixture) == 1 and self._as_it_is(mixture[0][0], depth_m):
            return self._values[mixture[0][0]]
        mixed: Any = 0
        for k, weight in mixture:
            scale = self._scale(k, depth_m)
            moved = magnified(self._values[k], scale, shift - scale * self._shifts[k])
            mixed = mixed + weight * exposure / self._exposures[k] * moved
        return np.asarray(mixed, self._values.dtype)

    def left_out_errors(self) -> list[float | None]:
        if len(self._own) == 1:
            return [None]
        errors: list[float | None] = []
        for k, depth in enumerate(self._own):
            others = np.delete(np.arange(len(self._own)), k)
            mixture = [(int(others[j]), weight) for j, weight in _mixture(self._own[others], float(depth))]
            errors.append(_relative(self.mixed(mixture, float(depth), onto=k), self._values[k]))
        return errors

    def stated_error(
        self, mixture: list[tuple[int, float]], depth_m: float, left_out: list[float | None]
    ) -> float | None:
        """Return the error to state for a plane made from a mixture, None if unknown.

        A plane of the stack errs by its resampling alone, and not at all where it stays as it is.
        """
        if len(mixture) == 1 and self._as_it_is(mixture[0][0], depth_m):
            return 0.0
        own = _same(self._own, depth_m) is not None
        found = [] if own else [error for k, _ in mixture if (error := left_out[k]) is not None]
        if not own and len(found) < len(mixture):
            return None
        for k, _ in mixture:
            scale, shift = self._scale(k, depth_m), self._shifts[k]
            back = magnified(magnified(self._values[k], scale, -scale * shift), 1 / scale, shift)
            found.append(_relative(back, self._values[k]))
        return max(found)

    def _scale(self, k: int, depth_m: float) -> float:
        return 1.0 if _same(self._own, depth_m) == k else (1 + self._d / depth_m) / (1 + self._d / self._own[k])

    def _as_it_is(self, k: int, depth_m: float) -> bool:
        return _same(self._own, depth_m) == k and self._exposures[k] == 1 and not self._shifts[k].any()


def _relative(found: NDArray[Any], true: NDArray[Any]) -> float:
    return float(np.linalg.norm(found - true) / np.linalg.norm(true))


def _too_far_off(depth_m: float, error: float, accepted: float, registration: Registration | None) -> str:
    """Say what to do about a plane whose error is too great to be of use."""
    cures = [
        "measure more planes around it",
        f"set psf.planes.accept_error above {share(error)} to take it all the same",
    ]
    if registration is None:
        cures.insert(1, "register the planes, if they were measured")
    return (
        f"the plane at {length(depth_m)} would be wrong by {share(error)} (relative L2, as planes near it are "
        f"that are predicted from their neighbours), more than the {share(accepted)} that are accepted; {', or '.join(cures)}"
    )


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
