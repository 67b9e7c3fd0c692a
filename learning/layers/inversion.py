"""Inversion of a lensless measurement at every depth: a regularised division in the Fourier domain, learned or fixed.

S(z) = F^-1{F(Y) conj(FH(z)) / (|FH(z)|^2 + lambda(z) |FP(z)|^2)}: thesis equations 4.10 and 4.11; with the Laplacian for P
and a fixed lambda, the constrained least squares of 5.2 and 5.3 (Gonzalez and Woods, Digital Image Processing, section 5.9).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from learning.capture import CaptureModel
from learning.layers.padding import AxisPlan, pad_measurement
from simulator.errors import InputError

LAPLACIAN = ((0.0, -1.0, 0.0), (-1.0, 4.0, -1.0), (0.0, -1.0, 0.0))


class RegularisedInversion(nn.Module):
    """From a measurement to one estimate of the whole scene per depth plane: sharp where the depth is right.

    Learned are P, a 3 x 3 filter per plane that the channels share, and lambda per plane and channel,
    ``lambda = exp(log_lambda) mean |FH|^2``, so that the same number means the same strength for every mask and scale.
    """

    spectrum: Tensor
    power: Tensor
    scale: Tensor
    offset: Tensor

    def __init__(
        self,
        capture: CaptureModel,
        planes: Sequence[int] | None = None,
        *,
        strength: float = 1e-2,
        learned: bool = True,
    ) -> None:
        """Prepare the spectra of the PSFs.

        Args:
            capture: the camera.
            planes: indices of the planes to invert at; None takes all.
            strength: initial lambda as a multiple of the PSF's mean spectral power.
            learned: whether P and lambda are parameters or stay as they are.

        Raises:
            InputError: a strength that is not positive.
        """
        super().__init__()
        if not strength > 0:
            msg = f"strength: got {strength!r}, expected a positive multiple of the PSF's mean spectral power"
            raise InputError(msg)
        self.planes = tuple(range(len(capture.stack.depths_m))) if planes is None else tuple(planes)
        values = np.asarray(capture.stack.values)[list(self.planes)]
        self.rows, self.columns = (
            AxisPlan.fit(sensor, scene, size)
            for sensor, scene, size in zip(capture.sensor_shape, capture.scene_shape, values.shape[-2:], strict=True)
        )
        kernel = torch.from_numpy(self.columns.place(self.rows.place(values, -2), -1)).to(torch.float32)
        self.register_buffer("spectrum", torch.fft.rfft2(kernel), persistent=False)
        # Parseval: the mean over all frequencies, without transforming.
        power = (kernel.double() ** 2).sum(dim=(-2, -1), keepdim=True).float()
        self.register_buffer("power", power, persistent=False)
        scale = 1 / (capture.gain * capture.white * capture.irradiance)
        self.register_buffer("scale", torch.from_numpy(np.asarray(scale, np.float32)), persistent=False)
        offset = torch.from_numpy(capture.offset.astype(np.float32))[:, None, None]
        self.register_buffer("offset", offset, persistent=False)
        kernels, channels = values.shape[:2]
        filters = torch.tensor(LAPLACIAN).repeat(kernels, 1, 1)
        log_lambda = torch.full((kernels, channels), math.log(strength))
        self.filters = nn.Parameter(filters, requires_grad=learned)
        self.log_lambda = nn.Parameter(log_lambda, requires_grad=learned)

    def forward(self, measurement: Tensor) -> Tensor:
        """Invert measurements.

        Args:
            measurement: ``(B, C, H, W)`` DN / 2^bits.

        Returns:
            ``(B, K, C, h, w)``, irradiance-corrected radiance in the camera's channels, 1 for white.
        """
        padded = pad_measurement(measurement - self.offset, self.rows, self.columns)
        spectrum = torch.fft.fft(torch.fft.rfft(padded, dim=-1), dim=-2)[:, None] * self.inverse()
        rows = torch.fft.ifft(spectrum, dim=-2)[..., self.rows.scene, :]
        scene = torch.fft.irfft(rows, self.columns.length, dim=-1)[..., self.columns.scene]
        return scene * self.scale

    def inverse(self) -> Tensor:
        """Return W(z), ``(K, C, L, M // 2 + 1)`` complex, of equation 4.11."""
        strength = self.log_lambda.exp()[..., None, None] * self.power
        penalty = self._filter_power()[:, None]
        # Of a P without response at a frequency where the PSF has none either, nothing is left to divide by.
        denominator = self.spectrum.abs().square() + strength * penalty + 1e-8 * self.power
        return self.spectrum.conj() / denominator

    def _filter_power(self) -> Tensor:
        """Return |FP|^2, ``(K, L, M // 2 + 1)``: nine terms, by the definition of the transform."""
        tall, wide = self._phases(self.rows.length), self._phases(self.columns.length)
        wide = wide[: self.columns.length // 2 + 1]
        return torch.einsum("ya,kab,xb->kyx", tall, self.filters.to(tall.dtype), wide).abs().square()

    def _phases(self, length: int) -> Tensor:
        taps = torch.arange(-1, 2, device=self.filters.device, dtype=self.filters.dtype)
        turns = torch.arange(length, device=self.filters.device, dtype=self.filters.dtype) / length
        return torch.polar(torch.ones_like(turns)[:, None].expand(-1, 3), -2 * math.pi * turns[:, None] * taps)
