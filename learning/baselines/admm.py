"""ADMM with total variation, sparsity and non-negativity: the volume that best explains one measurement.

argmin 1/2 |Y - crop sum_z H(z) * S(z)|^2 + tv |grad S|_1 + sparsity |S|_1, S >= 0: thesis 5.4. Copies of the image before its
crop, of the gradient and of the volume, as in Antipa et al., DiffuserCam: lensless single-exposure 3D imaging, Optica 5
(2018), make the convolution linear and every step a closed form; see `learning.baselines.admm_step`.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from learning.baselines.admm_grid import AdmmGrid
from learning.baselines.admm_step import AdmmProblem, Weights
from learning.capture import CaptureModel
from simulator.errors import InputError


class AdmmResult(NamedTuple):
    """What `Admm.solve` found and how it got there: N iterations; B measurements of C channels, each a problem of its own.

    Attributes:
        volume: ``(B, K, C, h, w)`` radiance / white in the camera's channels.
        objective: ``(N, B, C)``; see `Admm`.
        primal: ``(N, B, C)``, relative primal residual; see `AdmmProblem.residuals`.
        dual: ``(N, B, C)``, relative dual residual.
        iterations: N.
    """

    volume: Tensor
    objective: Tensor
    primal: Tensor
    dual: Tensor
    iterations: int


class Admm(nn.Module):
    """Volumes of all planes at once from measurements.

    The objective is that of a normalised problem, so that ``tv`` and ``sparsity`` mean the same for every mask, gain,
    exposure and white: S = 1 is white in the middle of the scene (vignetting is part of S), and the measurement of each
    channel is divided by what such a pixel gives, sqrt(sum H^2), the root of the mean over depths.
    """

    scale: Tensor
    offset: Tensor
    brightness: Tensor

    def __init__(
        self,
        capture: CaptureModel,
        *,
        tv: float,
        sparsity: float,
        iterations: int,
        light: Literal["scene", "anywhere"] = "scene",
        weights: tuple[float, float, float] | None = None,
        balance: int = 0,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        """Prepare the spectra.

        Args:
            capture: the camera.
            tv: weight of the total variation over rows and columns; see `learning.baselines.total_variation`.
            sparsity: weight of the sum of absolute values.
            iterations: of each call.
            light: ``scene``: none comes from outside the picture, as in the data sets; ``anywhere``: it comes from around it
                too, on all of a period twice as large, as published: for real captures.
            weights: of the copies of image, gradient and volume (mu1, mu2, mu3 of the publication): how fast it converges,
                not where to; None takes `default_weights`.
            balance: for so many first iterations the weights follow the residuals, for each measurement and channel: to
                find weights for other problems, as `default_weights` were found.
            dtype: float32 or float64.

        Raises:
            InputError: negative or infinite ``tv`` or ``sparsity``, weights that are not positive, no iteration, or another
                name for ``light``.
        """
        super().__init__()
        self.weights = default_weights(tv) if weights is None else weights
        _check(tv, sparsity, iterations, light, self.weights, balance)
        self.tv, self.sparsity, self.iterations, self.balance = tv, sparsity, iterations, balance
        self.grid = AdmmGrid(capture, light, dtype)
        brightest = float(capture.irradiance.max())
        scale = 1 / (capture.gain * capture.white * brightest * self.grid.norm)
        for name, values in (
            ("scale", scale[:, None, None]),
            ("offset", capture.offset[:, None, None]),
            ("brightness", brightest / capture.irradiance.astype(np.float64)),
        ):
            self.register_buffer(name, torch.from_numpy(np.asarray(values)).to(dtype), persistent=False)

    @torch.no_grad()
    def forward(self, measurement: Tensor) -> Tensor:
        """Return ``(B, K, C, h, w)`` radiance / white in the camera's channels of measurements ``(B, C, H, W)``.

        Raises:
            InputError: measurements of another shape.
        """
        problem, weights = self._problem(measurement)
        at = problem.start(weights)
        for step in range(self.iterations):
            before, at = at, problem.step(at, weights)
            if step < self.balance:
                at, weights = problem.balanced(before, at, weights)
        return problem.found(at)[self._picture] * self.brightness

    @torch.no_grad()
    def solve(self, measurement: Tensor, *, tolerance: float = 0.0) -> AdmmResult:
        """Do the same and watch it, to study how fast it converges and how far `forward` stops from the solution.

        It costs about as much again.

        Args:
            measurement: ``(B, C, H, W)`` DN / 2^bits.
            tolerance: both residuals of all problems below it end the iteration; 0 runs all of ``iterations``.

        Raises:
            InputError: measurements of another shape.
        """
        problem, weights = self._problem(measurement)
        at = problem.start(weights)
        objective, primal, dual = [], [], []
        for step in range(self.iterations):
            before, at = at, problem.step(at, weights)
            residuals = problem.residuals(at, weights)
            objective.append(problem.objective(at))
            primal.append(residuals[0])
            dual.append(residuals[1])
            if max(float(residual.max()) for residual in residuals) < tolerance:
                break
            if step < self.balance:
                at, weights = problem.balanced(before, at, weights)
        volume = problem.found(at)[self._picture] * self.brightness
        return AdmmResult(volume, torch.stack(objective), torch.stack(primal), torch.stack(dual), len(objective))

    @property
    def _picture(self) -> tuple:
        """Where the scene lies in the light."""
        _, *scene = self.grid.scene
        _, *light = self.grid.light
        return (
            ...,
            *(slice(s.start - (m.start or 0), s.stop - (m.start or 0)) for s, m in zip(scene, light, strict=True)),
        )

    def _problem(self, measurement: Tensor) -> tuple[AdmmProblem, Weights]:
        """Return the normalised problem of measurements and the weights of each."""
        channels, (rows, columns) = len(self.scale), (part.stop for part in self.grid.sensor[1:])
        if measurement.ndim != 4 or tuple(measurement.shape[1:]) != (channels, rows, columns):
            msg = f"measurement: got {tuple(measurement.shape)}, expected (B, {channels}, {rows}, {columns}) of this camera"
            raise InputError(msg)
        target = ((measurement.to(self.scale) - self.offset) * self.scale)[:, None]
        alike = torch.ones_like(target[..., :1, :1])
        return AdmmProblem(self.grid, target, self.tv, self.sparsity), Weights(*(w * alike for w in self.weights))


def default_weights(tv: float) -> tuple[float, float, float]:
    """Return weights of the copies near those at which residual balancing settled on rendered scenes.

    64 x 64 pixels, 8 planes, 40 dB, ``tv`` 0.01 to 1: with them the objective after 100 iterations lies 1 to 2 % above that
    after 500 (``tv`` 0.01 and 0.1).
    """
    return 0.5, 60 * tv + 1e-3, 50 * tv + 5


def _check(tv: float, sparsity: float, iterations: int, light: str, weights: tuple[float, ...], balance: int) -> None:
    for name, value in (("tv", tv), ("sparsity", sparsity)):
        if not 0 <= value < np.inf:
            msg = f"{name}: got {value!r}, expected a finite number that is not negative"
            raise InputError(msg)
    if len(weights) != 3 or not all(0 < weight < np.inf for weight in weights):
        msg = f"weights: got {weights}, expected three positive numbers"
        raise InputError(msg)
    for name, value, least in (("iterations", iterations, 1), ("balance", balance, 0)):
        if value < least:
            msg = f"{name}: got {value}, expected at least {least}"
            raise InputError(msg)
    if light not in ("scene", "anywhere"):
        msg = f"light: got {light!r}, expected 'scene' or 'anywhere'"
        raise InputError(msg)
