"""FISTA with total variation over space and time: the film that best explains a capture, not below zero.

argmin 1/2 |A x - y|^2 + tv (|D_t x|_1 + |D_y x|_1 + |D_x x|_1), x >= 0: thesis 5.1, as published for rolling-shutter video by
Antipa et al., Video from Stills: Lensless Imaging with Rolling Shutter, ICCP 2019. Beck and Teboulle, A Fast Iterative
Shrinkage-Thresholding Algorithm, SIAM J. Imaging Sciences 2 (2009), with the restarts of O'Donoghue and Candes, Adaptive
Restart for Accelerated Gradient Schemes, Found. Comput. Math. 15 (2015).

The unknown is the field's light, not a period of the sensor's size (see `learning.layers.space_time`).
"""

from __future__ import annotations

import math
from typing import Literal

import torch
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.layers.space_time import ClipProblem, FirstLight
from learning.method import check_choices
from simulator.errors import InputError

_TIME, _ROWS, _COLUMNS = 0, -2, -1
_AXES = (_TIME, _ROWS, _COLUMNS)
_GREATEST = 4.0 * len(_AXES)  # bound of |D|^2: 4 for each axis (Chambolle 2004)
_POWER_STEPS = 30


class FistaTv(nn.Module):
    """Films from captures, one at a time.

    Attributes:
        curve: the objective after each iteration of the last capture; best-so-far is what is returned.
    """

    def __init__(
        self,
        capture: CaptureModel,
        *,
        tv: float,
        tv_over_time: float,
        iterations: int,
        prox: Literal["exact", "haar"],
        inner: int,
        start: FirstLight | None = None,
    ) -> None:
        """Prepare the problem and its step, the reciprocal of the greatest eigenvalue of A^T A, by power iteration.

        Args:
            capture: the camera.
            tv: weight of the total variation over rows and columns.
            tv_over_time: weight of that over frames, as a multiple.
            iterations: of each capture.
            prox: ``exact``: the proximal step of total variation and x >= 0 together, by ``inner`` steps of its dual, begun
                where the last one ended (Beck and Teboulle, Fast Gradient-Based Algorithms for Constrained Total Variation,
                IEEE TIP 18, 2009); ``haar``: the mean of soft-thresholded Haar differences over all axes and both shifts
                (Kamilov, A Parallel Proximal Algorithm for Anisotropic Total Variation Minimization, IEEE TIP 26, 2017), an
                approximation in one pass that published code of this kind of camera uses.
            inner: see ``prox``.
            start: gives the film that is begun with; None begins in the dark.

        Raises:
            InputError: negative weights, another prox, no iteration.
        """
        super().__init__()
        for name, value in (("tv", tv), ("tv_over_time", tv_over_time)):
            if not (math.isfinite(value) and value >= 0):
                raise InputError(name, f"got {value!r}, expected a finite number that is not negative")
        for name, value in (("iterations", iterations), ("inner", inner)):
            if value < 1:
                raise InputError(name, f"got {value}, expected at least 1")
        check_choices(("prox", prox, ("exact", "haar")))
        self.problem, self._start = ClipProblem(capture), start
        self.iterations, self._prox, self._inner = iterations, prox, inner
        self._weights = (tv * tv_over_time, tv, tv)
        self.curve: list[float] = []
        self._greatest: float | None = None

    @torch.no_grad()
    def forward(self, measurement: Tensor) -> Tensor:
        """Return ``(B, N, C, h, w)`` radiance / white in the camera's channels, of measurements ``(B, C, H, W)``."""
        return torch.cat([self.problem.film(self._solve(each))[:, :, 0] for each in measurement.split(1)])

    def _solve(self, measurement: Tensor) -> Tensor:
        problem, target = self.problem, self.problem.target(measurement)
        best = light = (problem.dark(1) if self._start is None else self._start.light(measurement)).clamp_min(0)
        seen = seen_ahead = problem.forward(light)
        ahead, momentum = light, 1.0
        step = 1 / self._eigenvalue(light)
        dual = tuple(torch.zeros_like(each) for each in _differences(light))
        self.curve = []
        for _ in range(self.iterations):
            gradient = problem.adjoint(seen_ahead - target)
            limits = [step * weight for weight in self._weights]
            if self._prox == "exact":
                new, dual = prox_tv(ahead - step * gradient, limits, dual, self._inner)
            else:
                new = prox_haar(ahead - step * gradient, limits).clamp_min(0)
            seen_new = problem.forward(new)
            if torch.sum((ahead - new) * (new - light)) > 0:  # momentum leads uphill
                momentum, ahead, seen_ahead = 1.0, new, seen_new
            else:
                after = (1 + math.sqrt(1 + 4 * momentum**2)) / 2
                further, momentum = (momentum - 1) / after, after
                ahead, seen_ahead = new + further * (new - light), seen_new + further * (seen_new - seen)
            light, seen = new, seen_new
            self.curve.append(self._value(light, seen - target))
            if self.curve[-1] <= min(self.curve):
                best = light
        return best

    def objective(self, light: Tensor, target: Tensor) -> float:
        """Return what is minimised, of x ``(N, K, 1, C, rows, columns)`` and y ``(1, C, H, W)``."""
        return self._value(light, self.problem.forward(light) - target)

    def _value(self, light: Tensor, residual: Tensor) -> float:
        misfit = 0.5 * float(residual.double().square().sum())
        variations = (weight * float(part.abs().double().sum()) for weight, part in self._weighed(light))
        return misfit + sum(variations)

    def _weighed(self, light: Tensor) -> zip[tuple[float, Tensor]]:
        return zip(self._weights, _differences(light), strict=True)

    def _eigenvalue(self, reference: Tensor) -> float:
        if self._greatest is None:
            light, norm = torch.ones_like(reference), 1.0
            for _ in range(_POWER_STEPS):
                light = self.problem.adjoint(self.problem.forward(light / light.norm()))
                norm = float(light.norm())
            self._greatest = 1.02 * norm  # from below it comes near in so many steps; light is positive, as A is
        return self._greatest


def prox_tv(
    light: Tensor, limits: list[float], dual: tuple[Tensor, ...], inner: int
) -> tuple[Tensor, tuple[Tensor, ...]]:
    """Return argmin_x 1/2 |x - light|^2 + sum_d limit_d |D_d x|_1, x >= 0, and the dual that it was found by."""
    ahead, momentum = dual, 1.0
    for _ in range(inner):
        primal = (light - _transposed(ahead, light)).clamp_min(0)
        new = tuple(
            (part + change / _GREATEST).clamp(-limit, limit)
            for part, change, limit in zip(ahead, _differences(primal), limits, strict=True)
        )
        after = (1 + math.sqrt(1 + 4 * momentum**2)) / 2
        ahead = tuple(one + (momentum - 1) / after * (one - other) for one, other in zip(new, dual, strict=True))
        dual, momentum = new, after
    return (light - _transposed(dual, light)).clamp_min(0), dual


def prox_haar(light: Tensor, limits: list[float]) -> Tensor:
    """Return the mean of the proximal steps of each axis' pairs of neighbours, even and odd ones, each for the sum of all."""
    parts, total = 2 * len(_AXES), torch.zeros_like(light)
    for axis, limit in zip(_AXES, limits, strict=True):
        length = light.shape[axis]
        for shift in (0, 1):
            found, pairs = light.clone(), (length - shift) // 2
            both = found.narrow(axis, shift, 2 * pairs).unflatten(axis, (pairs, 2))
            at = 1 if axis == _TIME else axis  # of the two of a pair
            first, second = both.select(at, 0), both.select(at, 1)
            # Of |a - b|, the proximal step moves both towards each other until they meet.
            move = ((first - second) / 2).clamp(-parts * limit, parts * limit)
            first -= move
            second += move
            total += found
    return total / parts


def _differences(light: Tensor) -> tuple[Tensor, ...]:
    return tuple(torch.diff(light, dim=axis) for axis in _AXES)


def _transposed(dual: tuple[Tensor, ...], light: Tensor) -> Tensor:
    total = torch.zeros_like(light)
    for part, axis in zip(dual, _AXES, strict=True):
        count = light.shape[axis] - 1
        total.narrow(axis, 1, count).add_(part)
        total.narrow(axis, 0, count).sub_(part)
    return total
