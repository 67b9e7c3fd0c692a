"""Plug-and-play over space and time: the film that explains a capture, with a denoiser of its frames as the prior.

The splitting is that of `learning.classical.plug_and_play` (Venkatakrishnan et al., Plug-and-Play Priors for Model Based
Reconstruction, GlobalSIP 2013), the falling noise that of DPIR (Zhang et al., Plug-and-Play Image Restoration with Deep
Denoiser Prior, TPAMI 2021, section 4.2). The least squares in between are those of `learning.layers.data_consistency`, which
begin where the last ones ended.

A denoiser of pictures knows nothing of time. So the static picture, a robust mean of the frames (Huber, Robust Estimation of
a Location Parameter, Ann. Math. Statist. 35, 1964), is denoised by itself, with less noise than a frame has; and each frame
becomes this picture plus its own difference from it, as far as that has more energy around a pixel than noise has: the filter
of local statistics (Lee, IEEE PAMI 2, 1980) with the static picture for the mean.
"""

from __future__ import annotations

import math

import numpy as np
import torch
import torch.nn.functional as nnf
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.classical.plug_and_play import PlaneDenoiser
from learning.layers.data_consistency import DataConsistency
from learning.layers.inversion import samples_at_once
from learning.layers.noise import noise_level
from learning.layers.space_time import FirstLight
from simulator.errors import InputError

_WINDOW = 5  # pixels on a side, over which the energy of a difference is averaged


class ClipPlugAndPlay(nn.Module):
    """Films of all frames at once: argmin 1/2 |(A x - y) / s|^2 + prior R(x), x >= 0, by ADMM.

    s is the standard deviation of the measurement's noise, which is found in it. A step that takes away noise of standard
    deviation d belongs to a copy of x of weight prior / d^2. As d falls from step to step, evenly in its logarithm, the copy
    is held more firmly to x: coarse structure first. d is in units of white, not of s: a capture says less than there are
    unknowns, so what is wrong with the first film does not follow from the noise.
    """

    def __init__(
        self,
        capture: CaptureModel,
        *,
        denoiser: PlaneDenoiser,
        start: FirstLight,
        prior: float,
        level_first: float,
        level_last: float,
        over_time: float,
        iterations: int,
        inner: int,
    ) -> None:
        """Prepare the problem.

        Args:
            capture: the camera.
            denoiser: of pictures; see `learning.checkpoint.load_denoiser`.
            start: gives the film that is begun with.
            prior: weight of the prior against half the squared misfit over the noise's variance.
            level_first: standard deviation of what the first step takes away, 1 for white.
            level_last: of the last step.
            over_time: how strongly frames are drawn to the static picture: what differs from it by a mean square of less than
                this many times the variance of the step's noise is taken for noise. 0 denoises each frame by itself.
            iterations: of each capture.
            inner: steps of conjugate gradients in each.

        Raises:
            InputError: numbers that are not positive, ``over_time`` below zero, levels that rise.
        """
        super().__init__()
        positive = {"prior": prior, "level_first": level_first, "level_last": level_last}
        for name, value in positive.items():
            if not 0 < value < math.inf:
                raise InputError(name, f"got {value!r}, expected a positive number")
        if level_last > level_first:
            raise InputError(
                "level_last", f"got {level_last:g} above level_first, {level_first:g}; expected at most that"
            )
        if not 0 <= over_time < math.inf:
            raise InputError("over_time", f"got {over_time!r}, expected a finite number that is not negative")
        for name, value in (("iterations", iterations), ("inner", inner)):
            if value < 1:
                raise InputError(name, f"got {value}, expected at least 1")
        self.data, self.denoiser, self._start = DataConsistency(capture), denoiser, start
        self.problem = self.data.problem
        self.levels = np.geomspace(level_first, level_last, iterations).tolist()
        self._prior, self._over_time, self._inner = prior, over_time, inner

    @torch.no_grad()
    def forward(self, measurement: Tensor) -> Tensor:
        """Return ``(B, N, C, h, w)`` radiance / white in the camera's channels, of measurements ``(B, C, H, W)``."""
        return torch.cat([self._film(part) for part in measurement.split(samples_at_once(measurement))])

    def _film(self, measurement: Tensor) -> Tensor:
        target = self.problem.target(measurement)
        seen = self.problem.adjoint(target)
        measured = noise_level(measurement).clamp_min(1e-6)[:, None, None, None] * self.problem.scale
        light = copy = self._start.light(measurement).clamp_min(0)
        multiplier, before = torch.zeros_like(light), self.levels[0]
        for noise in self.levels:
            weight = self._prior * (measured / noise) ** 2
            multiplier *= (noise / before) ** 2
            light = self.data(light, seen + weight * (copy - multiplier), weight, self._inner)
            copy = self.denoised(light + multiplier, noise).clamp_min(0)
            multiplier += light - copy
            before = noise
        return self.problem.film(copy)[:, :, 0]

    def denoised(self, light: Tensor, noise: float) -> Tensor:
        """Return x ``(N, K, B, C, rows, columns)`` without noise of a standard deviation, 1 for white."""
        pictures = self._pictures(light, noise)
        if self._over_time == 0 or len(light) == 1:
            return pictures
        middle = light.sort(dim=0).values[(len(light) - 1) // 2 : len(light) // 2 + 1].mean(dim=0)
        # One step of Huber's estimate from the median: what passes by counts as if it were no more than noise.
        mean = middle + (light - middle).clamp(-noise, noise).mean(dim=0)
        static = self._pictures(mean[None], noise / math.sqrt(len(light)))
        energy = (light - static).square().mean(dim=(1, 3))
        energy = nnf.avg_pool2d(energy, _WINDOW, stride=1, padding=_WINDOW // 2, count_include_pad=False)
        kept = (1 - self._over_time * noise**2 / energy.clamp_min(torch.finfo(energy.dtype).tiny)).clamp_min(0)
        return static + kept[:, None, :, None] * (pictures - static)

    def _pictures(self, light: Tensor, noise: float) -> Tensor:
        """Return frames, each denoised by itself."""
        volume = light.movedim(2, 0).flatten(1, 2)
        found = self.denoiser.planes(volume, volume.new_full((len(volume),), noise))
        return found.unflatten(1, light.shape[:2]).movedim(0, 2)
