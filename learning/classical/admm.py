"""ADMM with total variation, sparsity and non-negativity: the volume that best explains one measurement.

argmin 1/2 |Y - crop sum_z H(z) * S(z)|^2 + tv |grad S|_1 + sparsity |S|_1, S >= 0: thesis 5.4. Copies of the image before its
crop, of the gradient and of the volume, as in Antipa et al., DiffuserCam: lensless single-exposure 3D imaging, Optica 5
(2018), make the convolution linear and every step a closed form.

With A S = (sum_z H S on the sensor, D S, S), copies Z of it, scaled multipliers U and weights M, ADMM (Boyd et al.,
Distributed Optimization and Statistical Learning via ADMM, 2011, section 3.1.1) is

    S = (A^T M A)^-1 A^T M (Z - U);    Z = prox(A S + U);    U = U + A S - Z.

Z need not be kept: Z - U = A S + U_old - 2 U, so S moves by (A^T M A)^-1 A^T M (U_old - 2 U), and the multipliers become
(A S + U - Y) / (1 + weight) for the image, and A S + U clipped to the pull of its term for gradient and volume. Where a copy
is free (the image off the sensor, differences across the border of the light) its multiplier is zero and stays so.

|grad S|_1 = sum |S[i + 1, j] - S[i, j]| + |S[i, j + 1] - S[i, j]| is the anisotropic total variation over rows and columns,
differences inside the light only. Not over depth: a surface lies in one plane and not in the next, and planes are not evenly
spaced.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
import torch
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.layers.padding import AxisPlan, as_pairs, check_measurement, from_pairs
from learning.method import check_choices, threads_for
from simulator.arrays import next_fast_len, to_numpy
from simulator.errors import InputError

Leave: TypeAlias = Callable[[Tensor, int], Tensor]
"""Of A S + U and a step's number, the multiplier, in place."""


class Admm(nn.Module):
    """Volumes of all planes at once from measurements.

    The objective is that of a normalised problem, so that ``tv`` and ``sparsity`` mean the same for every mask, gain,
    exposure and reference white: S = 1 is white in the middle of the scene (vignetting is part of S), and the measurement of
    each channel is divided by what such a pixel gives, sqrt(sum H^2), the root of the mean over depths.
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
        dtype: torch.dtype = torch.float32,
    ) -> None:
        """Prepare the spectra.

        Args:
            capture: the camera.
            tv: weight of the total variation.
            sparsity: weight of the sum of absolute values.
            iterations: of each call.
            light: ``scene``: none comes from outside the field that was simulated, the image and its margin; ``anywhere``: it
                comes from around it, too, on all of a period twice as large, as published: for real captures.
            weights: of the copies of image, gradient and volume (mu1, mu2, mu3 of the publication): how fast it converges,
                not where to; None takes `planar_weights` for one plane, else `default_weights`. Where ``tv`` is 0, a 0 leaves
                the gradient's copy out.
            dtype: float32 or float64.

        Raises:
            InputError: negative or infinite ``tv`` or ``sparsity``, weights that are not positive, no iteration, or another
                name for ``light``.
        """
        super().__init__()
        for name, value in (("tv", tv), ("sparsity", sparsity)):
            if not 0 <= value < np.inf:
                raise InputError(name, f"got {value!r}, expected a finite number that is not negative")
        least = (0, 0 if tv > 0 else -1, 0)
        if weights is not None and (
            len(weights) != 3 or not all(a < b < np.inf for a, b in zip(least, weights, strict=True))
        ):
            raise InputError("weights", f"got {weights}, expected three positive numbers")
        if iterations < 1:
            raise InputError("iterations", f"got {iterations}, expected at least 1")
        check_choices(("light", light, ("scene", "anywhere")))
        self.tv, self.sparsity, self.iterations = tv, sparsity, iterations
        self.grid = AdmmGrid(capture, light, dtype)
        if weights is None:
            flat = len(capture.stack.depths_m) == 1
            weights = planar_weights(tv, float(self.grid.power.max())) if flat else default_weights(tv)
        self.weights = weights
        brightest = float(capture.scene_irradiance.max())
        exposed = np.ones(1) if capture.row_exposure is None else capture.row_exposure
        scale = 1 / (capture.gain * capture.white * brightest * self.grid.norm[:, None] * exposed)
        brightness = brightest / capture.scene_irradiance.astype(np.float64)
        buffers = {"scale": scale[..., None], "offset": capture.offset[:, None, None], "brightness": brightness}
        for name, values in buffers.items():
            self.register_buffer(name, torch.from_numpy(np.asarray(values)).to(dtype), persistent=False)

    @torch.no_grad()
    def forward(self, measurement: Tensor) -> Tensor:
        """Return ``(B, K, C, h, w)`` radiance / white in the camera's channels of measurements ``(B, C, H, W)``."""
        return self.light(measurement)[self.grid.scene_in_light] * self.brightness

    @torch.no_grad()
    def light(self, measurement: Tensor) -> Tensor:
        """Return S, ``(B, K, C, ...)``, wherever light may come from; see `AdmmGrid.light`."""
        check_measurement(measurement, self.offset, *self.grid.plans)
        target = ((measurement.to(self.scale) - self.offset) * self.scale)[:, None]
        at, leave = self._start(target), self._multiplier_of_volume(target)
        with threads_for(at.new.volume.numel()):
            for number in range(self.iterations):
                at = self._step(at, target, number, leave)
            # The copy of the volume, not the volume itself: it keeps the constraints exactly.
            inside = self.grid.light
            return self.grid.inverse(at.volume)[inside] + at.old.volume[inside] - at.new.volume[inside]

    def _start(self, target: Tensor) -> Iterate:
        """Return S = 0 and its multipliers."""
        (batch, _, channels, *_), spectrum = target.shape, self.grid.spectrum
        volume = spectrum.new_zeros((batch, len(spectrum), channels, *spectrum.shape[-2:]))
        dark = target.new_zeros((batch, len(spectrum), channels, *self.grid.shape))
        zero = Parts(torch.zeros_like(target), *differences(dark[self.grid.light]), dark)
        seen = zero._replace(image=-target / (1 + self.weights[0]))
        return Iterate(volume, torch.zeros_like(volume[:, :1]), zero, seen)

    def _step(self, at: Iterate, target: Tensor, number: int, leave: Leave) -> Iterate:
        """Return the next iterate."""
        weights, rescaled = self._weights(number)
        of_image, of_gradient, of_volume = weights
        # Scaled by another weight than before, the volume's multiplier is another number.
        new = at.new if rescaled == 1 else at.new._replace(volume=at.new.volume * rescaled)
        pull = torch.sub(at.old.volume, at.new.volume, alpha=1 + rescaled).mul_(of_volume)
        if of_gradient:
            moves = (torch.sub(old, new, alpha=2) for old, new in zip(at.old[1:3], at.new[1:3], strict=True))
            add_adjoint(pull[self.grid.light], *(move.mul_(of_gradient) for move in moves))
        image = torch.sub(at.old.image, at.new.image, alpha=2).mul_(of_image)
        step, seen = self.grid.solve(torch.fft.rfft2(pull), torch.fft.rfft2(image, self.grid.shape), weights)
        volume, image = step.add_(at.volume), seen.add_(at.image)
        return Iterate(volume, image, new, self._multipliers(volume, image, new, target, number, leave))

    def _multipliers(
        self, volume: Tensor, image: Tensor, old: Parts, target: Tensor, number: int, leave: Leave
    ) -> Parts:
        """Return U after a step."""
        (of_image, of_gradient, _), _ = self._weights(number)
        light = self.grid.inverse(volume)
        rows, columns = old.rows, old.columns
        if of_gradient:
            limit = self.tv / of_gradient
            rows, columns = (
                part.add_(multiplier).clamp_(-limit, limit)
                for part, multiplier in zip(differences(light[self.grid.light]), (rows, columns), strict=True)
            )
        seen = self.grid.inverse(image)[self.grid.sensor]
        light = light.add_(old.volume)
        leave(light[self.grid.light], number)
        return Parts((seen + old.image).sub_(target).div_(1 + of_image), rows, columns, light)

    def _weights(self, number: int) -> tuple[tuple[float, float, float], float]:
        """Return the weights of a step, and the volume's before it over this one; here the same for all steps."""
        del number
        return self.weights, 1.0

    def _multiplier_of_volume(self, target: Tensor) -> Leave:
        """Return what takes prox(A S + U), the volume's copy, from A S + U; here of sparsity and non-negativity."""
        del target
        limit = self.sparsity / self.weights[2]
        return lambda light, number: light.clamp_max_(limit)


def default_weights(tv: float) -> tuple[float, float, float]:
    """Return weights of the copies for many planes.

    Where ``tv`` is 0.05 or more, near those at which residual balancing settled on rendered scenes (Wohlberg, ADMM Penalty
    Parameter Selection by Residual Balancing, 2017, arXiv 1704.06209). Below, the volume's is smaller: with 5 in place of
    0.5, telling 13 planes apart at 50 dB (``tv`` 0.005) takes four times the iterations, 240 in place of 60.
    """
    return 0.5, 60 * tv + 1e-3, 50 * tv + 0.5


def planar_weights(tv: float, greatest_power: float) -> tuple[float, float, float]:
    """Return weights for one plane, where less is to be told apart; ``greatest_power`` is of |FH|^2, at frequency zero.

    Found by search on a real capture at two sizes, and on a photograph through PhlatCam, DiffuserCam and 25 points, light
    from anywhere: after 60 iterations all are nearer to the solution than after 100 with a weight of 5 for the volume. The
    wider the PSF, the more its frequency zero stands out, and the more must hold it.
    """
    return 0.15, 6 * tv + 1e-3, 5e-4 * greatest_power + 0.3


class Parts(NamedTuple):
    """A S, or its multipliers: the image on the sensor ``(B, 1, C, H, W)``, differences, the volume ``(B, K, C, L, M)``."""

    image: Tensor
    rows: Tensor
    columns: Tensor
    volume: Tensor


class Iterate(NamedTuple):
    """Where the iteration stands: the spectra of S ``(B, K, C, L, M // 2 + 1)`` and of sum_z H S, the image, with one plane.

    ``old`` and ``new`` are the multipliers before and after the last step.
    """

    volume: Tensor
    image: Tensor
    old: Parts
    new: Parts


class AdmmGrid(nn.Module):
    """Spectra of the PSFs, each channel divided by the root of its mean energy, on a period without wrap-around.

    Attributes:
        power: sum_z |FH|^2, ``(C, L, M // 2 + 1)``.
        differences: |FD|^2, ``(L, M // 2 + 1)``.
        norm: what the channels' PSFs were divided by, ``(C,)`` float64.
        plans: of rows and columns.
        shape: L, M.
        sensor: rows and columns of the measurement.
        light: rows and columns where light may come from.
        scene_in_light: rows and columns of the scene within the light.
    """

    spectrum_pairs: Tensor
    conjugate_pairs: Tensor
    power: Tensor
    differences: Tensor

    def __init__(self, capture: CaptureModel, light: Literal["scene", "anywhere"], dtype: torch.dtype) -> None:
        """Transform the PSFs once; see `Admm`."""
        super().__init__()
        values = to_numpy(capture.stack.values).astype(np.float64)
        self.norm = np.sqrt(np.mean(np.sum(values**2, axis=(-2, -1)), axis=0))
        within = light == "scene"
        sizes = (capture.sensor_shape, capture.field_shape if within else capture.scene_shape, values.shape[-2:])
        rows, columns = ((_shortest if within else AxisPlan.fit)(*axis) for axis in zip(*sizes, strict=True))
        self.plans, self.shape = (rows, columns), (rows.length, columns.length)
        self.sensor = (..., slice(rows.sensor), slice(columns.sensor))
        # A field larger than the sensor begins before it: light is counted from the field's first sample, by PSFs moved so.
        before = [max(0, -plan.offset) for plan in self.plans]
        begins = [plan.offset + moved for plan, moved in zip(self.plans, before, strict=True)]
        lit = (..., *(slice(at, at + plan.size) for at, plan in zip(begins, self.plans, strict=True)))
        everywhere = (..., slice(None), slice(None))
        self.light, self.scene_in_light = (lit, (..., *capture.scene_in_field)) if within else (everywhere, lit)
        kernel = columns.place(rows.place(values / self.norm[:, None, None], -2), -1)
        kernel = np.roll(kernel, [-moved for moved in before], axis=(-2, -1))
        spectrum = torch.fft.rfft2(torch.from_numpy(kernel))
        self.register_buffer("power", spectrum.abs().square().sum(dim=0).to(dtype), persistent=False)
        # As pairs of real numbers, in three axes: so they follow a module to another precision or memory format unharmed.
        self._planes = values.shape[:2]
        for name, part in (("spectrum_pairs", spectrum), ("conjugate_pairs", spectrum.conj())):
            self.register_buffer(name, as_pairs(part).flatten(0, 1).to(dtype), persistent=False)
        self.register_buffer("differences", difference_power(*self.shape, dtype), persistent=False)

    @property
    def spectrum(self) -> Tensor:
        """FH, ``(K, C, L, M // 2 + 1)``."""
        return from_pairs(self.spectrum_pairs).unflatten(0, self._planes)

    def inverse(self, spectrum: Tensor) -> Tensor:
        """Return what has the spectrum ``(..., L, M // 2 + 1)``, ``(..., L, M)``."""
        # In two calls, of which torch's own irfft2 takes 1.4 times as long.
        return torch.fft.irfft(torch.fft.ifft(spectrum, dim=-2), self.shape[1], dim=-1)

    def solve(self, volume: Tensor, image: Tensor, weights: tuple[float, float, float]) -> tuple[Tensor, Tensor]:
        """Solve (A^T M A) X = volume + H^H image at every frequency, in the Fourier domain.

        A^T M A = a H^H H + q with one row H of K numbers, one weight a of the image and one number q = b |FD|^2 + c of the
        other two: with n = H H^H, by Sherman and Morrison, X = (volume + H^H (q image - a H volume) / (q + a n)) / q.
        ``volume`` and ``image`` are spectra as in `Iterate`, ``weights`` a, b, c. Returns X, in the memory of ``volume``, and
        its image H X.
        """
        a, b, c = weights
        own = b * self.differences + c
        share = (own + a * self.power).reciprocal()  # a complex division costs several times a product
        seen = (self.spectrum * volume).sum(dim=1, keepdim=True)
        conjugate = from_pairs(self.conjugate_pairs).unflatten(0, self._planes)
        volume.addcmul_(conjugate, (own * image - a * seen) * share).mul_(1 / own)
        return volume, (seen + self.power * image) * share


def _shortest(sensor: int, scene: int, psf: int) -> AxisPlan:
    """Return the plan whose period is just long enough that no light from the scene comes round onto the sensor."""
    offset = (sensor - scene) // 2
    first, last = offset - psf // 2, offset + scene - 1 + (psf - 1 - psf // 2)
    return AxisPlan(sensor, next_fast_len(max(sensor, scene, sensor - first, last + 1)), offset, scene)


def differences(values: Tensor) -> tuple[Tensor, Tensor]:
    """Return D S of ``(..., h, w)``: between rows ``(..., h - 1, w)`` and between columns ``(..., h, w - 1)``."""
    return values.diff(dim=-2), values.diff(dim=-1)


def add_adjoint(values: Tensor, rows: Tensor, columns: Tensor) -> None:
    """Add D^T of differences to ``(..., h, w)``, in place."""
    values[..., 1:, :] += rows
    values[..., :-1, :] -= rows
    values[..., 1:] += columns
    values[..., :-1] -= columns


def difference_power(rows: int, columns: int, dtype: torch.dtype) -> Tensor:
    """Return |F D|^2, ``(rows, columns // 2 + 1)``: the spectrum of D^T D on a periodic grid."""
    tall = 2 - 2 * torch.cos(2 * math.pi * torch.arange(rows, dtype=torch.float64) / rows)
    wide = 2 - 2 * torch.cos(2 * math.pi * torch.arange(columns // 2 + 1, dtype=torch.float64) / columns)
    return (tall[:, None] + wide).to(dtype)
