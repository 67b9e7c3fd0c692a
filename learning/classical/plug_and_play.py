"""Plug-and-play ADMM: the volume that explains one measurement, with a denoiser of its planes as the prior.

Venkatakrishnan et al., Plug-and-Play Priors for Model Based Reconstruction, GlobalSIP 2013: in place of the proximal step of
a penalty, a denoiser, followed here by the projection onto S >= 0. The splitting, the grid and the units are those of
`learning.classical.admm`, without total variation and sparsity.

With an unknown penalty R, weighted by ``prior`` times the variance s^2 of the measurement's noise, and a weight c of the
volume's copy, prox of prior s^2 R / c is a denoiser for noise of variance prior s^2 / c. As in DPIR (Zhang et al.,
Plug-and-Play Image Restoration with Deep Denoiser Prior, TPAMI 2021, section 4.2) the denoiser's noise falls from step to
step, evenly in its logarithm, and c rises: coarse structure first. In units of s, which is found in the measurement, the same
numbers serve from little noise to much: s decides how strongly is denoised, and c = prior / noise^2 does not depend on it.
"""

from __future__ import annotations

from typing import Literal, Protocol

import numpy as np
import torch
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.classical.admm import Admm, Leave
from learning.layers.noise import noise_level
from simulator.errors import InputError


class PlaneDenoiser(Protocol):
    """What a prior is: see `learning.models.denoiser.Denoiser.planes`."""

    def planes(self, volume: Tensor, noise: Tensor) -> Tensor:
        """Return volumes ``(B, K, C, h, w)``, 1 for white, without noise of standard deviations ``(B,)``."""
        ...


class PlugAndPlay(Admm):
    """Volumes of all planes at once from measurements; see `learning.classical.admm.Admm`."""

    def __init__(
        self,
        capture: CaptureModel,
        *,
        denoiser: PlaneDenoiser,
        prior: float,
        noise_first: float,
        noise_last: float,
        iterations: int,
        light: Literal["scene", "anywhere"] = "scene",
        image_weight: float = 0.5,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        """Prepare the spectra.

        Args:
            capture: the camera.
            denoiser: the prior; see `learning.checkpoint.load_denoiser`.
            prior: weight of the prior against half the squared misfit over the noise's variance.
            noise_first: standard deviation of what the first step takes away, as a multiple of the measurement's noise.
            noise_last: of the last step.
            iterations: of each call.
            light: see `Admm`.
            image_weight: of the copy of the image: how fast it converges, not where to.
            dtype: float32 or float64.

        Raises:
            InputError: numbers that are not positive, noise that rises.
        """
        for name, value in (("prior", prior), ("noise_first", noise_first), ("noise_last", noise_last)):
            if not 0 < value < np.inf:
                raise InputError(name, f"got {value!r}, expected a positive number")
        if noise_last > noise_first:
            raise InputError(
                "noise_last", f"got {noise_last:g} above noise_first, {noise_first:g}; expected at most that"
            )
        weights = (image_weight, 0.0, prior / noise_first**2)
        super().__init__(
            capture, tv=0.0, sparsity=0.0, iterations=iterations, light=light, weights=weights, dtype=dtype
        )
        self.denoiser = denoiser.to(dtype) if isinstance(denoiser, nn.Module) else denoiser
        self.noise = np.geomspace(noise_first, noise_last, iterations).tolist()
        self._prior = prior

    def _weights(self, number: int) -> tuple[tuple[float, float, float], float]:
        """Return the weights of a step, and the volume's before it over this one."""
        now, before = self.noise[number], self.noise[max(number - 1, 0)]
        return (self.weights[0], 0.0, self._prior / now**2), (now / before) ** 2

    def _multiplier_of_volume(self, target: Tensor) -> Leave:
        """Return what takes the denoised copy, not below zero, from the volume plus its multiplier."""
        measured = noise_level(target[:, 0])

        def leave(light: Tensor, number: int) -> Tensor:
            return light.sub_(self.denoiser.planes(light, self.noise[number] * measured).clamp_min_(0))

        return leave
