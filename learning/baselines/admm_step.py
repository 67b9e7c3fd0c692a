"""The steps of ADMM on a normalised problem, what they leave behind, and how far they still are from the solution.

With A S = (sum_z H S on the sensor, D S, S), copies Z of it, scaled multipliers U and weights M, ADMM (Boyd et al.,
Distributed Optimization and Statistical Learning via ADMM, 2011, section 3.1.1) is

    S = (A^T M A)^-1 A^T M (Z - U);    Z = prox(A S + U);    U = U + A S - Z.

Z need not be kept: Z - U = A S + U_old - 2 U, so S moves by (A^T M A)^-1 A^T M (U_old - 2 U), and the multipliers become
(A S + U - Y) / (1 + weight) for the image, and A S + U clipped to the pull of its term for gradient and volume. Where a copy
is free (the image off the sensor, differences across the border of the light) its multiplier is zero and stays so.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from learning.baselines.admm_grid import AdmmGrid
from learning.baselines.total_variation import add_adjoint, differences, total_variation

_BALANCE_LIMIT = 2.0
_TINY = 1e-30


class Parts(NamedTuple):
    """A S, or its multipliers: the image on the sensor ``(B, 1, C, H, W)``, differences, the volume ``(B, K, C, L, M)``."""

    image: Tensor
    rows: Tensor
    columns: Tensor
    volume: Tensor


class Weights(NamedTuple):
    """M: weights of the copies, ``(B, 1, C, 1, 1)`` each."""

    image: Tensor
    gradient: Tensor
    volume: Tensor

    def of_parts(self) -> Parts:
        """Return the weight of each part."""
        return Parts(self.image, self.gradient, self.gradient, self.volume)


class Iterate(NamedTuple):
    """Where the iteration stands.

    Attributes:
        volume: spectrum of S, ``(B, K, C, L, M // 2 + 1)``.
        image: spectrum of sum_z H S, ``(B, 1, C, L, M // 2 + 1)``.
        old: multipliers before the last step.
        new: multipliers after it.
    """

    volume: Tensor
    image: Tensor
    old: Parts
    new: Parts


@dataclass(frozen=True)
class AdmmProblem:
    """argmin 1/2 |target - crop sum_z H(z) * S(z)|^2 + tv |grad S|_1 + sparsity |S|_1, S >= 0; no light off ``grid.light``.

    Attributes:
        grid: the spectra.
        target: measurement, ``(B, 1, C, H, W)``.
        tv: weight of the total variation.
        sparsity: weight of the sum.
    """

    grid: AdmmGrid
    target: Tensor
    tv: float
    sparsity: float

    def start(self, weights: Weights) -> Iterate:
        """Return S = 0 and its multipliers."""
        batch, _, channels, *_ = self.target.shape
        planes = self.grid.spectrum.shape[0]
        volume = self.grid.spectrum.new_zeros((batch, planes, channels, *self.grid.spectrum.shape[-2:]))
        dark = self.target.new_zeros((batch, planes, channels, *self.grid.shape))
        zero = Parts(torch.zeros_like(self.target), *differences(dark[self.grid.light]), dark)
        new = zero._replace(image=-self.target / (1 + weights.image))
        return Iterate(volume, torch.zeros_like(volume[:, :1]), zero, new)

    def step(self, at: Iterate, weights: Weights) -> Iterate:
        """Return the next iterate."""
        move = Parts(*(torch.sub(old, new, alpha=2) for old, new in zip(at.old, at.new, strict=True)))
        pull = move.volume.mul_(weights.volume)
        add_adjoint(pull[self.grid.light], weights.gradient * move.rows, weights.gradient * move.columns)
        step, seen = self.grid.solve(torch.fft.rfft2(pull), self.grid.on_sensor(weights.image * move.image), weights)
        volume, image = step.add_(at.volume), seen.add_(at.image)
        return Iterate(volume, image, at.new, self._multipliers(self._parts(volume, image), at.new, weights))

    def found(self, at: Iterate) -> Tensor:
        """Return the copy of the volume where light may be, ``(B, K, C, h, w)``: it keeps the constraints exactly."""
        inside = self.grid.light
        volume = self.grid.pictures(at.volume)[inside]
        return volume + at.old.volume[inside] - at.new.volume[inside]

    def objective(self, at: Iterate) -> Tensor:
        """Return the objective of `found`, ``(B, C)``."""
        found = self.found(at)
        whole = torch.zeros_like(at.new.volume)
        whole[self.grid.light] = found
        image = self.grid.pictures(self.grid.image(torch.fft.rfft2(whole)))[self.grid.sensor]
        misfit = (image - self.target).square().sum(dim=(1, 3, 4)) / 2
        return misfit + self.tv * total_variation(found).sum(dim=1) + self.sparsity * found.sum(dim=(1, 3, 4))

    def residuals(self, at: Iterate, weights: Weights) -> tuple[Tensor, Tensor]:
        """Return the relative primal and dual residuals, ``(B, C)`` each.

        |A S - Z| / max(|A S|, |Z|), and |A^T M U| over the root of the summed squares of its three terms, which cancel at
        the solution (Boyd et al. 2011, section 3.3; their scale, |A^T M U| itself, would be zero there).
        """
        parts, gaps, copies = self._copies(at)
        primal = _norm(*gaps) / torch.maximum(_norm(*parts), _norm(*copies)).clamp_min(_TINY)
        image = self.grid.conjugate * self.grid.on_sensor(weights.image * at.new.image)
        gradient = torch.zeros_like(at.new.volume)
        add_adjoint(gradient[self.grid.light], weights.gradient * at.new.rows, weights.gradient * at.new.columns)
        terms = [self.grid.pictures(image), gradient, weights.volume * at.new.volume]
        return primal, _norm(terms[0] + terms[1] + terms[2]) / _norm(*terms).clamp_min(_TINY)

    def balanced(self, before: Iterate, at: Iterate, weights: Weights) -> tuple[Iterate, Weights]:
        """Return weights that bring each copy's relative residuals together, |A S - Z| / |Z| and |Z - Z_before| / |U|.

        Source: Wohlberg, ADMM Penalty Parameter Selection by Residual Balancing, 2017 (arXiv 1704.06209), for each copy
        apart as in the publication's code; a weight at most doubles or halves.
        """
        parts, gaps, copies = self._copies(at)
        moves = [new - old for old, new in zip(self._copies(before)[2], copies, strict=True)]
        factors = []
        for first, last in ((0, 1), (1, 3), (3, 4)):  # the gradient has two parts
            here = slice(first, last)
            size = torch.maximum(_norm(*parts[here]), _norm(*copies[here]))
            primal, dual = _norm(*gaps[here]) * _norm(*at.new[here]), _norm(*moves[here]) * size
            factor = (primal / dual).sqrt().clamp(1 / _BALANCE_LIMIT, _BALANCE_LIMIT)
            factors.append(torch.where((primal > 0) & (dual > 0), factor, 1.0)[:, None, :, None, None])
        new = Parts(*(u / f for u, f in zip(at.new, Weights(*factors).of_parts(), strict=True)))
        # Z stays where it is: of it, only A S and old - new are known.
        old = Parts(*(scaled - gap for scaled, gap in zip(new, gaps, strict=True)))
        return at._replace(old=old, new=new), Weights(*(w * f for w, f in zip(weights, factors, strict=True)))

    def _copies(self, at: Iterate) -> tuple[Parts, list[Tensor], list[Tensor]]:
        """Return A S, A S - Z, and Z."""
        parts = self._parts(at.volume, at.image)
        gaps = [new - old for old, new in zip(at.old, at.new, strict=True)]
        return parts, gaps, [part - gap for part, gap in zip(parts, gaps, strict=True)]

    def _parts(self, volume: Tensor, image: Tensor) -> Parts:
        """Return A S."""
        picture = self.grid.pictures(volume)
        return Parts(self.grid.pictures(image)[self.grid.sensor], *differences(picture[self.grid.light]), picture)

    def _multipliers(self, parts: Parts, old: Parts, weights: Weights) -> Parts:
        """Return U after a step; ``parts`` is overwritten."""
        image = (parts.image + old.image).sub_(self.target).div_(1 + weights.image)
        limit = self.tv / weights.gradient
        rows, columns = (
            torch.clamp(part.add_(multiplier), -limit, limit)
            for part, multiplier in ((parts.rows, old.rows), (parts.columns, old.columns))
        )
        volume = parts.volume.add_(old.volume)
        inside = volume[self.grid.light]
        torch.minimum(inside, self.sparsity / weights.volume, out=inside)
        return Parts(image, rows, columns, volume)


def _norm(*tensors: Tensor) -> Tensor:
    """Return the norm over all of several parts ``(B, ?, C, ?, ?)``, ``(B, C)``."""
    return torch.stack([part.square().sum(dim=(1, 3, 4)) for part in tensors]).sum(dim=0).sqrt()
