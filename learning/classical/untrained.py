"""An untrained network as the prior of a film: convolutions find smooth, self-similar pictures before they find noise.

Monakhova et al., Untrained Networks for Compressive Lensless Photography, Opt. Express 29, 20913 (2021), after Ulyanov et
al., Deep Image Prior, CVPR 2018: a network's weights are moved until what it makes of fixed noise explains the capture;
nothing else is ever seen. Network and numbers are those of the authors' notebook for video (`Demo_single_shot_video` in
Waller-Lab/UDN) where it reconstructs real captures: two dimensions, the frames as channels of the output. It has a network
for each colour; here one has all colours. For simulated captures the notebook has three dimensions, at many times the cost.
"""

from __future__ import annotations

import math
from typing import Any

import torch
import torch.nn.functional as nnf
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.classical.fitting import FilmFitting, FilmNetwork, drawn_from
from simulator.errors import InputError

_INPUT = 0.1  # the fixed noise is uniform from 0 to this
_SLOPE = 0.2  # of the leaky ReLU below zero


class UntrainedNetwork(FilmFitting):
    """Films by networks that begin with random weights; see `FilmFitting` for what a fit gives besides."""

    def __init__(
        self,
        capture: CaptureModel,
        *,
        iterations: int,
        seed: int = 0,
        learning_rate: float = 1e-3,
        input_noise: float = 0.05,
        tv: float = 1e-20,
        filters: int = 128,
        levels: int = 5,
    ) -> None:
        """Prepare the fit; defaults are the notebook's, which has 20 000 iterations for simulated captures, 10 000 for real.

        Args:
            capture: the camera.
            iterations: of each capture.
            seed: of the weights, of the input and of its noise.
            learning_rate: of Adam.
            input_noise: standard deviation of what is added to the fixed input anew in each iteration.
            tv: weight of the sum of squared differences between neighbouring pixels, light 1 being white. That of the
                notebook is too little to matter.
            filters: of each level.
            levels: how often the network halves the image; a small image as often as there are two pixels left.

        Raises:
            InputError: numbers that make no sense, or a field of less than three pixels on a side.
        """
        numbers = {"learning_rate": learning_rate, "input_noise": input_noise, "tv": tv}
        super().__init__(capture, iterations=iterations, seed=seed, filters=filters, levels=levels, **numbers)
        for name, value in numbers.items():
            least = "positive" if name == "learning_rate" else "not negative"
            if not (math.isfinite(value) and (value > 0 or (value == 0 and name != "learning_rate"))):
                raise InputError(name, f"got {value!r}, expected a finite number that is {least}")
        for name, value in (("filters", filters), ("levels", levels)):
            if value < 1:
                raise InputError(name, f"got {value}, expected at least 1")
        rows, columns = self.problem.shape[-2:]
        if min(rows, columns) < 3:
            raise InputError("capture", f"got a field of {rows} x {columns} pixels, expected at least 3 x 3 to halve")

    def network(self, unit: Tensor, generator: torch.Generator) -> FilmNetwork:
        """Return a network with random weights; see `FilmFitting.network`."""
        levels = min(self.told["levels"], math.ceil(math.log2(min(self.problem.shape[-2:]))) - 1)
        with drawn_from(generator):
            body = SkipNetwork(self.problem.shape, filters=self.told["filters"], levels=levels)
        return _Untrained(body, self.problem.shape, unit, generator, self.told)


class _Untrained(FilmNetwork):
    """The light that a network makes of its fixed input and this iteration's noise.

    The output is softplus, in units of the capture's mean light: never below zero and without a greatest value. The notebook
    has a sigmoid and scales both measurements to norm 1, by which a film has no brightness of its own.
    """

    unit: Tensor
    fixed: Tensor

    def __init__(
        self,
        body: SkipNetwork,
        shape: tuple[int, ...],
        unit: Tensor,
        generator: torch.Generator,
        told: dict[str, Any],
    ) -> None:
        super().__init__()
        self.body, self._shape, self._generator, self._told = body, shape, generator, told
        self.register_buffer("unit", unit / math.log(2), persistent=False)
        fixed = _INPUT * torch.rand(1, body.inputs, *shape[-2:], generator=generator)
        self.register_buffer("fixed", fixed)

    def forward(self, share: float) -> Tensor:
        """Return light ``(N, K, 1, C, rows, columns)``."""
        del share
        noise = torch.randn(self.fixed.shape, generator=self._generator).to(self.fixed)
        found = self.body(self.fixed + self._told["input_noise"] * noise)
        return nnf.softplus(found.unflatten(1, self._shape[:3])[0])[:, :, None] * self.unit

    def penalty(self, light: Tensor) -> Tensor:
        """Return the weighted sum of squared differences between neighbours."""
        rows, columns = (torch.diff(light, dim=axis).square().sum() for axis in (-2, -1))
        return self._told["tv"] * (rows + columns)

    def optimiser(self) -> torch.optim.Optimizer:
        """Return Adam with one rate for all weights."""
        return torch.optim.Adam(self.parameters(), lr=self._told["learning_rate"])


class SkipNetwork(nn.Module):
    """Encoder and decoder with a narrow skip on each level: Ulyanov et al. 2018, supplement, figure 21."""

    def __init__(self, shape: tuple[int, ...], *, filters: int, levels: int, skip: int = 4) -> None:
        """Build it; weights are drawn by torch's own rules from its generator.

        Args:
            shape: N, K, C and more; its input has N channels, as in the notebook, its output N K C.
            filters: of each level.
            levels: how many.
            skip: channels of a skip.
        """
        super().__init__()
        self.inputs = shape[0]
        sources = [self.inputs, *[filters] * (levels - 1)]
        self.skips = nn.ModuleList(_step(source, skip, 1) for source in sources)
        self.down = nn.ModuleList(
            nn.Sequential(_step(source, filters, 3, stride=2), _step(filters, filters, 3)) for source in sources
        )
        self.up = nn.ModuleList(
            nn.Sequential(_norm(skip + filters), _step(skip + filters, filters, 3), _step(filters, filters, 1))
            for _ in sources
        )
        self.head = nn.Conv2d(filters, math.prod(shape[:3]), 1)

    def forward(self, image: Tensor) -> Tensor:
        """Return ``(1, N K C, rows, columns)`` of ``(1, N, rows, columns)``, without a last activation."""
        aside: list[Tensor] = []
        for skip, down in zip(self.skips, self.down, strict=True):
            aside.append(skip(image))
            image = down(image)
        for up in reversed(self.up):
            beside = aside.pop()
            image = nnf.interpolate(image, size=beside.shape[-2:], mode="bilinear", align_corners=False)
            image = up(torch.cat([beside, image], dim=1))
        return self.head(image)


def _step(inputs: int, outputs: int, side: int, stride: int = 1) -> nn.Sequential:
    conv = nn.Conv2d(inputs, outputs, side, stride, padding=side // 2, padding_mode="reflect")
    return nn.Sequential(conv, _norm(outputs), nn.LeakyReLU(_SLOPE))


def _norm(channels: int) -> nn.BatchNorm2d:
    """Return normalisation by the one image's own statistics: there is no other, and no test."""
    return nn.BatchNorm2d(channels, track_running_stats=False)
