"""What a capture says of a clip, and the joint least squares over space and time that follow from it.

A capture of a rolling shutter is linear in the frames: y = A x, with A from `learning.camera.CaptureModel.row_weights`. The
unknown is what shone in the field that was simulated, image and margin, in each frame: fewer numbers than a period of the
sensor's size has, though still more than the sensor's pixels (ten frames of a field of 72 x 72 in a capture of 160 x 192:
1.7 times as many). So every method of clips has a prior.
"""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np
import torch
from torch import Tensor, nn

from learning.camera import CaptureModel, SpaceTime, check_lit
from learning.layers.inversion import samples_at_once
from learning.layers.noise import noise_level
from learning.layers.padding import AxisPlan, axis_plans, check_measurement
from simulator.arrays import to_numpy
from simulator.errors import InputError


class ClipProblem(nn.Module):
    """What a capture says of its frames, in units that mean the same for every mask, gain, exposure and reference white.

    x, ``(N, K, B, C, rows, columns)``, is light over the field: 1 is white in the middle of the image (vignetting is part of
    x). Each channel of the measurement is divided by what such a pixel gives if its rows are open, sqrt(sum H^2), the root of
    the mean over depths.
    """

    scale: Tensor
    offset: Tensor
    brightness: Tensor
    norm: Tensor

    def __init__(self, capture: CaptureModel) -> None:
        """Prepare the numbers; an InputError refuses the camera of stills, and an image with parts that send no light."""
        super().__init__()
        if capture.timing is None:
            raise InputError("capture", "got the camera of stills, expected clips: a shutter with frames to tell apart")
        check_lit(capture)
        self._capture, self._model = capture, None
        self.plans: tuple[AxisPlan, AxisPlan] = axis_plans(capture)
        self.shape = (capture.frames, len(capture.stack.depths_m), len(capture.stack.channels), *capture.field_shape)
        values = to_numpy(capture.stack.values).astype(np.float64)
        norm = np.sqrt(np.mean(np.sum(values**2, axis=(-2, -1)), axis=0))
        brightest = float(capture.scene_irradiance.max())
        buffers = {
            "scale": 1 / (capture.gain * capture.white * brightest * norm)[:, None, None],
            "norm": norm[:, None, None],
            "offset": capture.offset[:, None, None],
            "brightness": brightest / capture.scene_irradiance.astype(np.float64),
        }
        for name, numbers in buffers.items():
            self.register_buffer(name, torch.from_numpy(numbers).to(torch.get_default_dtype()), persistent=False)

    def target(self, measurement: Tensor) -> Tensor:
        """Return y ``(B, C, H, W)`` of measurements, DN / 2^bits."""
        check_measurement(measurement, self.offset, *self.plans)
        return (measurement.to(self.scale) - self.offset) * self.scale

    def forward(self, light: Tensor) -> Tensor:
        """Return A x ``(B, C, H, W)``."""
        return self._operator(light).forward(light) / self.norm

    def adjoint(self, image: Tensor) -> Tensor:
        """Return the transpose of A times an image ``(B, C, H, W)``."""
        return self._operator(image).adjoint(image / self.norm)

    def instead(self, measurement: Tensor, light: Tensor, other: Tensor) -> Tensor:
        """Return measurements as they would be with ``other`` light in place of x; one frame may stand for all."""
        return measurement + self(other - light) / self.scale

    def film(self, light: Tensor) -> Tensor:
        """Return the image ``(B, N, K, C, h, w)`` of x: radiance / white in the camera's channels."""
        rows, columns = self._capture.scene_in_field
        return light[..., rows, columns].movedim(2, 0) * self.brightness

    def light(self, film: Tensor) -> Tensor:
        """Return x of an image ``(B, N, K, C, h, w)``, continued over the margin by its last pixels."""
        light = (film / self.brightness).movedim(0, 2)
        margins = [(whole - part) // 2 for whole, part in zip(self.shape[-2:], film.shape[-2:], strict=True)]
        padding = [side for margin in reversed(margins) for side in (margin, margin)]
        return nn.functional.pad(light.flatten(0, 2), padding, mode="replicate").unflatten(0, light.shape[:3])

    def dark(self, batch: int) -> Tensor:
        """Return x = 0 for so many captures."""
        frames, planes, *rest = self.shape
        return self.scale.new_zeros((frames, planes, batch, *rest))

    def _operator(self, reference: Tensor) -> SpaceTime:
        if self._model is None or self._model[0] != (reference.device, reference.dtype):
            self._model = (reference.device, reference.dtype), self._capture.space_time(reference)
        return self._model[1]


class FirstLight(Protocol):
    """What gives the light that an iteration begins with."""

    def light(self, measurement: Tensor) -> Tensor:
        """Return x ``(N, K, B, C, rows, columns)`` of measurements ``(B, C, H, W)``; see `ClipProblem`."""
        ...


JOINT: dict[str, float | int | str] = {
    "iterations": 20,
    "static": 0.1,
    "moving": 0.2,
    "memory": 10.0,
    "sharpest": 0.05,
    "decay": 2.0,
    "correlation": 0.0,
    "noise": 1.0,
}
"""Numbers of `JointLeastSquares` that suit rendered scenes of 64 x 64 pixels."""


class JointLeastSquares(nn.Module):
    """All frames at once: the mean of what they may be, given the capture, were they Gaussian.

    The light is x_n = S sum_m L_nm u_m with white u. S S^T, the covariance over space, has the power spectrum
    1 / (1 + (f / f0)^2)^p at frequencies f in cycles per pixel, scaled to a variance of 1; L L^T, the covariance over
    frames, is static^2 + moving^2 exp(-|n - m| / memory): a picture that stands still and changes that are forgotten, whose
    inverse penalises differences between frames. Channels may be correlated, too. With T for x = T u and the noise's standard
    deviation s, which is found in the measurement, (T^T A^T A T + s^2) u = T^T A^T y by conjugate gradients (Hestenes and
    Stiefel 1952). As T precedes A, these begin with what is most likely, a smooth static picture, and a few steps serve.

    Attributes:
        told: the numbers of the prior and of the iterations.
    """

    spectrum: Tensor
    mixing: Tensor

    def __init__(
        self,
        capture: CaptureModel,
        *,
        iterations: int,
        static: float,
        moving: float,
        memory: float,
        sharpest: float,
        decay: float,
        correlation: float,
        noise: float,
    ) -> None:
        """Prepare the prior.

        Args:
            capture: the camera.
            iterations: of conjugate gradients.
            static: standard deviation of the picture that stands still, 1 for white.
            moving: of what changes.
            memory: over how many frames changes are forgotten (e-fold).
            sharpest: f0, cycles per pixel.
            decay: p.
            correlation: of any two of the camera's channels, 0 or more. Without it, noise becomes vivid colours.
            noise: s as a multiple of the noise that is found. 1 suits few iterations; with many, what the model leaves out,
                such as motion while a frame lasts, would be taken for detail: at 5 the mean itself is a good answer.

        Raises:
            InputError: numbers that are not positive.
        """
        super().__init__()
        self.told = {"iterations": iterations, "static": static, "moving": moving, "memory": memory}
        self.told |= {"sharpest": sharpest, "decay": decay, "noise": noise}
        for name, value in self.told.items():
            if not (math.isfinite(value) and value > 0):
                raise InputError(name, f"got {value!r}, expected a positive number")
        if not 0 <= correlation < 1:
            raise InputError("correlation", f"got {correlation!r}, expected 0 or more, and less than 1")
        self.told["correlation"] = correlation
        self.problem, self.iterations = ClipProblem(capture), iterations
        frames, _, channels, rows, columns = self.problem.shape
        square = np.fft.fftfreq(rows)[:, None] ** 2 + np.fft.fftfreq(columns) ** 2
        power = (1 + square / sharpest**2) ** -decay
        half = np.sqrt(power / power.mean())[:, : columns // 2 + 1]
        apart = np.abs(np.subtract.outer(np.arange(frames), np.arange(frames)))
        try:
            mixing = np.linalg.cholesky(static**2 + moving**2 * np.exp(-apart / memory))
        except np.linalg.LinAlgError:
            reason = "changes vanish beside the static picture or are never forgotten, as far as numbers tell"
            text = f"got {static:g}, {moving:g}, {memory:g}: {reason}; take more for moving, or less for memory"
            raise InputError("static, moving, memory", text) from None
        hues = np.linalg.cholesky((1 - correlation) * np.eye(channels) + correlation)
        mixing = np.einsum("nm,cd->ncmd", mixing, hues)
        for name, numbers in (("spectrum", half), ("mixing", mixing)):
            self.register_buffer(name, torch.from_numpy(numbers).to(torch.get_default_dtype()), persistent=False)

    def forward(self, measurement: Tensor) -> Tensor:
        """Return ``(B, N, C, h, w)`` radiance / white in the camera's channels, of measurements ``(B, C, H, W)``.

        Of a camera with several planes, that of the nearest: see `volumes`.
        """
        return self.volumes(measurement)[:, :, 0]

    @torch.no_grad()
    def volumes(self, measurement: Tensor) -> Tensor:
        """Return the same of all planes, ``(B, N, K, C, h, w)``."""
        return self.problem.film(self.light(measurement))

    @torch.no_grad()
    def light(self, measurement: Tensor) -> Tensor:
        """Return x ``(N, K, B, C, rows, columns)``; see `ClipProblem`."""
        # Sums of a batch round otherwise, and few steps of conjugate gradients in float32 amplify that to some 1e-3: on a
        # CPU, where a batch saves no time, a capture gives the same whatever else is in its batch.
        parts = measurement.split(samples_at_once(measurement))
        return torch.cat([self._light(part) for part in parts], dim=2)

    def _light(self, measurement: Tensor) -> Tensor:
        target = self.problem.target(measurement)
        # Without noise it would be the fine detail's; never 0, because it is a divisor.
        noise = self.told["noise"] * noise_level(measurement).clamp_min(1e-6)[:, None, None, None] * self.problem.scale
        found = self._solve(target / noise, noise)
        return self._synthesised(found)

    def _solve(self, target: Tensor, noise: Tensor) -> Tensor:
        """Return u, ``(N, K, B, C, rows, columns)``; target and forward model in units of the noise."""
        residual = self._analysed(self.problem.adjoint(target / noise))
        found, direction = torch.zeros_like(residual), residual.clone()
        power = _squares(residual)
        for _ in range(self.iterations):
            seen = self.problem.forward(self._synthesised(direction)) / noise
            image = self._analysed(self.problem.adjoint(seen / noise)) + direction
            step = power / _products(direction, image)
            found += step * direction
            residual -= step * image
            after = _squares(residual)
            direction = residual + after / power * direction
            power = after
        return found

    def _synthesised(self, white: Tensor) -> Tensor:
        """Return T u."""
        return torch.einsum("ncmd,mkbd...->nkbc...", self.mixing, self._smoothed(white))

    def _analysed(self, light: Tensor) -> Tensor:
        """Return the transpose of T times x."""
        return torch.einsum("ncmd,nkbc...->mkbd...", self.mixing, self._smoothed(light))

    def _smoothed(self, light: Tensor) -> Tensor:
        return torch.fft.irfft2(torch.fft.rfft2(light) * self.spectrum, light.shape[-2:])


def _products(one: Tensor, other: Tensor) -> Tensor:
    """Return the inner product of each capture's, ``(B, 1, 1, 1)``; captures lie along the third axis."""
    return (one * other).sum(dim=(0, 1, 3, 4, 5))[:, None, None, None].clamp_min(torch.finfo(one.dtype).tiny)


def _squares(values: Tensor) -> Tensor:
    return _products(values, values)
