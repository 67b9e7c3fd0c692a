"""What a capture says near a guess: preconditioned conjugate gradients, the data step of unrolled and plug-and-play methods.

Rows of a rolling shutter see different frames, so the least squares have no closed form in frequencies, as those of stills
have. "Data consistency" is the term of Aggarwal et al., MoDL, TMI 2019.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.layers.space_time import ClipProblem
from simulator.arrays import next_fast_len, to_numpy


class DataConsistency(nn.Module):
    """Steps of preconditioned conjugate gradients (Hestenes and Stiefel 1952) towards (A^T A + weight) x = wanted.

    With A^T y + weight x0 for ``wanted``, x explains the capture y and stays near x0: the larger the weight, the nearer.

    Attributes:
        problem: A.
        inverse: what they are preconditioned with.
    """

    def __init__(self, capture: CaptureModel) -> None:
        """Prepare the numbers; an InputError refuses the camera of stills."""
        super().__init__()
        self.problem = ClipProblem(capture)
        self.inverse: nn.Module = MeanInverse(capture, self.problem)

    def forward(self, light: Tensor, wanted: Tensor, weight: Tensor, steps: int) -> Tensor:
        """Return x after so many steps from ``light``, both ``(N, K, B, C, rows, columns)`` like ``wanted``.

        ``weight`` is ``(B, C, 1, 1)``; each capture and channel is a problem of its own.
        """
        problem = self.problem
        residual = wanted - problem.adjoint(problem(light)) - weight * light
        ahead = direction = self.inverse(residual, weight)
        power = _products(residual, ahead)
        for _ in range(steps):
            image = problem.adjoint(problem(direction)) + weight * direction
            step = power / _products(direction, image)
            light = light + step * direction
            residual = residual - step * image
            ahead = self.inverse(residual, weight)
            after = _products(residual, ahead)
            direction, power = ahead + after / power * direction, after
        return light


class MeanInverse(nn.Module):
    """About the inverse of A^T A + weight, to precondition with: as if in every row frames overlapped as in the mean of rows.

    Then A^T A is a matrix over frames, how much they overlap, times a Toeplitz one over places: the PSF's autocorrelation.
    For the latter stands the nearest circulant matrix, of the field's size or, for fast FFTs, slightly larger (T. Chan, An
    Optimal Circulant Preconditioner for Toeplitz Systems, SIAM J. Sci. Stat. Comput. 9, 1988).
    """

    overlap: Tensor
    mixing: Tensor
    power: Tensor

    def __init__(self, capture: CaptureModel, problem: ClipProblem) -> None:
        """Prepare the eigenvalues."""
        super().__init__()
        values, field = to_numpy(capture.stack.values).astype(np.float64), problem.shape[-2:]
        self._period = tuple(map(next_fast_len, field))
        whole = tuple(2 * size for size in values.shape[-2:])  # lags of both signs
        alike = np.fft.irfft2(np.abs(np.fft.rfft2(values, whole)) ** 2, whole)
        for axis, period in zip((-2, -1), self._period, strict=True):
            alike = _nearest_circulant(alike, period, axis)
        power = np.fft.rfft2(alike).real.clip(0) / problem.norm.double().numpy() ** 2
        shares = capture.row_weights
        overlap, mixing = np.linalg.eigh(shares @ shares.T / shares.shape[1])
        buffers = {
            "overlap": overlap.clip(0)[:, None, None, None, None, None],
            "mixing": mixing,
            "power": power[:, None],
        }
        for name, numbers in buffers.items():
            self.register_buffer(name, torch.from_numpy(numbers).to(torch.get_default_dtype()), persistent=False)

    def forward(self, light: Tensor, weight: Tensor) -> Tensor:
        """Return it times x ``(N, K, B, C, rows, columns)``; the weight is ``(B, C, 1, 1)``."""
        apart = torch.einsum("nm,n...->m...", self.mixing, light)
        spectrum = torch.fft.rfft2(apart, s=self._period) / (self.overlap * self.power + weight)
        apart = torch.fft.irfft2(spectrum, s=self._period)[..., : light.shape[-2], : light.shape[-1]]
        return torch.einsum("nm,m...->n...", self.mixing, apart)


def _nearest_circulant(kernel: NDArray[np.float64], period: int, axis: int) -> NDArray[np.float64]:
    """Return the first column of the circulant matrix nearest to a Toeplitz one of so many rows as the period.

    Along the axis lie the lags of the Toeplitz matrix: 0, 1, ..., -2, -1.
    """
    moved = np.moveaxis(kernel, axis, -1)
    lags = np.rint(np.fft.fftfreq(moved.shape[-1], 1 / moved.shape[-1])).astype(int)
    shared = moved * (1 - np.abs(lags) / period).clip(0)  # of all rows, those that have this lag
    found = np.zeros((period, *moved.shape[:-1]))
    np.add.at(found, lags % period, np.moveaxis(shared, -1, 0))
    return np.moveaxis(found, 0, axis)


def _products(one: Tensor, other: Tensor) -> Tensor:
    """Return the inner product of each capture's and channel's, ``(B, C, 1, 1)``; never 0, by which is divided."""
    return (one * other).sum(dim=(0, 1, 4, 5))[..., None, None].clamp_min(torch.finfo(one.dtype).tiny)
