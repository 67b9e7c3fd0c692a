"""Inversion of a lensless measurement at every depth: a regularised division in the Fourier domain, learned or fixed.

S(z) = F^-1{F(Y) conj(FH(z)) / (|FH(z)|^2 + lambda(z) |FP(z)|^2)}: thesis equations 4.10 and 4.11; with the Laplacian for P
and a fixed lambda, the constrained least squares of 5.2 and 5.3 (Gonzalez and Woods, Digital Image Processing, section 5.9).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

import numpy as np
import torch
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.layers.padding import (
    as_pairs,
    axis_plans,
    check_measurement,
    from_pairs,
    pad_measurement,
    scene_of,
    spectrum_of,
)
from simulator.arrays import to_numpy
from simulator.errors import InputError

_LEAST = 1e-8
"""Least denominator as a share of the PSF's mean spectral power: far below any noise, above float32's rounding of sums."""

LAPLACIAN = ((0.0, -1.0, 0.0), (-1.0, 4.0, -1.0), (0.0, -1.0, 0.0))


class RegularisedInversion(nn.Module):
    """From a measurement to one estimate of the whole scene per depth plane: sharp where the depth is right.

    Learned are P, a 3 x 3 filter per plane that the channels share, and lambda per plane and channel,
    ``lambda = exp(log_lambda) mean |FH|^2``, so that the same number means the same for every mask and scale.
    The arithmetic is float32 under autocast too, and torch's default precision at construction otherwise.

    Attributes:
        planes: indices of the stack's planes that it inverts at.
        disparities: of these planes, 0 to 1.
        channels: names of the camera's.
    """

    power: Tensor
    numerator: Tensor
    scale: Tensor
    offset: Tensor

    def __init__(
        self,
        capture: CaptureModel,
        planes: Sequence[int] | None = None,
        *,
        regularisation_lambda: float = 1e-2,
        tikhonov: float = 0.0,
        learned: bool = True,
        boundary: Literal["linear", "circular"] = "linear",
    ) -> None:
        """Prepare the spectra of the PSFs.

        Args:
            capture: the camera.
            planes: indices of the planes to invert at; None takes all.
            regularisation_lambda: initial, as a multiple of the PSF's mean spectral power.
            tikhonov: Tikhonov term that P begins with beside the Laplacian, its response at frequency zero. A mask as wide as
                the scene and more has zeros of FH so near to frequency zero that the Laplacian hardly holds them.
            learned: whether P and lambda are parameters or stay as they are.
            boundary: ``circular`` takes light that misses the sensor to come back on its other side, as the thesis does:
                nothing is padded, and the inverse is exact for such a camera.

        Raises:
            InputError: a lambda that is not positive, or another boundary.
        """
        super().__init__()
        if not (math.isfinite(regularisation_lambda) and regularisation_lambda > 0):
            given = f"got {regularisation_lambda!r}"
            msg = f"regularisation_lambda: {given}, expected a positive multiple of the PSF's mean spectral power"
            raise InputError(msg)
        self.planes = tuple(range(len(capture.stack.depths_m))) if planes is None else tuple(planes)
        self.disparities = capture.plane_disparities()[list(self.planes)]
        self.channels = capture.stack.channels
        values = to_numpy(capture.stack.values)[list(self.planes)].astype(np.float64)
        self.rows, self.columns = axis_plans(capture, boundary)
        kernel = torch.from_numpy(self.columns.place(self.rows.place(values, -2), -1))
        # Parseval: the mean over all frequencies. PSFs of power 1 keep float32 far from its limits.
        root = kernel.square().sum(dim=(-2, -1), keepdim=True).sqrt()
        spectrum = spectrum_of(kernel / root)
        dtype = torch.get_default_dtype()
        # Three axes at most and pairs of real numbers: what follows a module to another memory format or precision unharmed.
        self.register_buffer("power", spectrum.abs().square().flatten(0, 1).to(dtype), persistent=False)
        numerator = as_pairs(spectrum.conj() / root)
        self.register_buffer("numerator", numerator.flatten(0, 1).to(dtype), persistent=False)
        scale = 1 / (capture.gain * capture.white * capture.irradiance.astype(np.float64))
        self.register_buffer("scale", torch.from_numpy(scale).to(dtype), persistent=False)
        offset = torch.from_numpy(capture.offset)[:, None, None]
        self.register_buffer("offset", offset.to(dtype), persistent=False)
        kernels, channels = values.shape[:2]
        begin = torch.tensor(LAPLACIAN)
        begin[1, 1] += tikhonov
        self.filters = nn.Parameter(begin.repeat(kernels, 1, 1), requires_grad=learned)
        self.log_lambda = nn.Parameter(
            torch.full((kernels, channels), math.log(regularisation_lambda)), requires_grad=learned
        )

    def forward(self, measurement: Tensor, inverse: Tensor | None = None) -> Tensor:
        """Invert measurements.

        Args:
            measurement: ``(B, C, H, W)`` DN / 2^bits.
            inverse: what `inverse` returned for the present parameters, on this device; None works it out.

        Returns:
            ``(B, K, C, h, w)``, irradiance-corrected radiance in the camera's channels, 1 for white.

        Raises:
            InputError: a measurement of another shape than the camera's.
        """
        check_measurement(measurement, self.offset, self.rows, self.columns)
        with torch.autocast(measurement.device.type, enabled=False):
            light = measurement.to(self.offset.dtype) - self.offset
            spectrum = spectrum_of(pad_measurement(light, self.rows, self.columns))
            inverses = self.inverse() if inverse is None else inverse
            # One plane at a time: what lies between stays in the processor's cache, three times faster than all at once.
            planes = [scene_of(spectrum * one, self.rows, self.columns) for one in inverses]
            return torch.stack(planes, dim=1) * self.scale

    def inverse(self) -> Tensor:
        """Return W(z), ``(K, C, L // 2 + 1, M)`` complex, of equation 4.11."""
        penalty = self.log_lambda.exp()[..., None, None] * self._filter_power()[:, None]
        # Of a P without response at a frequency where the PSF has none either, nothing is left to divide by.
        denominator = self.power.view_as(penalty) + penalty + _LEAST
        # Times the reciprocal: a complex division costs twice the time, forwards and backwards.
        return from_pairs(self.numerator).view_as(penalty) * denominator.reciprocal()

    def _filter_power(self) -> Tensor:
        """Return |FP|^2, ``(K, L // 2 + 1, M)``: nine terms, by the definition of the transform."""
        tall = self._phases(self.rows.length)[: self.rows.length // 2 + 1]
        response = torch.einsum("ya,kab,xb->kyx", tall, self.filters.to(tall.dtype), self._phases(self.columns.length))
        return response.real.square() + response.imag.square()

    def _phases(self, length: int) -> Tensor:
        taps = torch.arange(-1, 2, device=self.filters.device, dtype=self.filters.dtype)
        turns = torch.arange(length, device=self.filters.device, dtype=self.filters.dtype) / length
        angles = -2 * math.pi * turns[:, None] * taps
        return torch.complex(angles.cos(), angles.sin())
