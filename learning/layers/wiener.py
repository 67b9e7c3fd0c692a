"""Trainable inversion of one PSF: a filter W of the whole measurement's size, which starts as Wiener's.

S = F^-1{F(W) F(Y)}, W = F^-1{conj(FH) / (K + |FH|^2)} at first: thesis equation 4.1; Khan et al., FlatNet, TPAMI 2020.
"""

from __future__ import annotations

import math

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


class WienerInversion(nn.Module):
    """From measurements of a scene at one depth to the scene, frame by frame.

    Learned is the spectrum of W, every frequency of its own, in units of its initial root mean square: one learning rate then
    serves it and the networks behind it, whatever the scale of the PSF. A spectrum rather than W itself saves two transforms
    per step; the transform is unitary but for a constant, so that gradient steps are the same.
    """

    root: Tensor
    scale: Tensor
    offset: Tensor

    def __init__(
        self, capture: CaptureModel, plane: int = 0, *, noise_to_signal: float = 1e-2, learned: bool = True
    ) -> None:
        """Prepare Wiener's filter.

        Args:
            capture: the camera.
            plane: index of the plane whose PSF is inverted.
            noise_to_signal: K as a multiple of the PSF's mean spectral power.
            learned: whether W is a parameter or stays as it is.

        Raises:
            InputError: a plane that the stack does not have, or a ratio that is not positive.
        """
        super().__init__()
        if not (math.isfinite(noise_to_signal) and noise_to_signal > 0):
            msg = f"noise_to_signal: got {noise_to_signal!r}, expected a positive multiple of the PSF's mean spectral power"
            raise InputError(msg)
        if not 0 <= plane < len(capture.stack.depths_m):
            msg = f"plane: got {plane}, expected 0 to {len(capture.stack.depths_m) - 1}, the planes of the stack"
            raise InputError(msg)
        self.rows, self.columns = axis_plans(capture)
        values = to_numpy(capture.stack.values)[plane].astype(np.float64)
        kernel = torch.from_numpy(self.columns.place(self.rows.place(values, -2), -1))
        power = kernel.square().sum(dim=(-2, -1), keepdim=True)
        spectrum = spectrum_of(kernel)
        wiener = spectrum.conj() / (spectrum.abs().square() + noise_to_signal * power)
        root = wiener.abs().square().mean(dim=(-2, -1), keepdim=True).sqrt()
        dtype = torch.get_default_dtype()
        self.register_buffer("root", root.to(dtype), persistent=False)
        scale = 1 / (capture.gain * capture.white * capture.irradiance.astype(np.float64))
        self.register_buffer("scale", torch.from_numpy(scale).to(dtype), persistent=False)
        offset = torch.from_numpy(capture.offset)[:, None, None]
        self.register_buffer("offset", offset.to(dtype), persistent=False)
        # Pairs of real numbers on three axes: optimisers, checkpoints and memory formats take nothing else.
        self.weight = nn.Parameter(as_pairs(wiener / root).to(dtype), requires_grad=learned)

    def forward(self, measurements: Tensor) -> Tensor:
        """Invert measurements.

        Args:
            measurements: ``(B, C, H, W)``, or frames ``(B, N, C, H, W)``; DN / 2^bits.

        Returns:
            ``(B, C, h, w)`` or ``(B, N, C, h, w)``, irradiance-corrected radiance in the camera's channels, 1 for white.

        Raises:
            InputError: measurements of another shape than the camera's.
        """
        check_measurement(measurements, self.offset, self.rows, self.columns, frames=True)
        with torch.autocast(measurements.device.type, enabled=False):
            light = measurements.to(self.offset.dtype) - self.offset
            spectrum = spectrum_of(pad_measurement(light, self.rows, self.columns))
            return scene_of(spectrum * self.inverse(), self.rows, self.columns) * self.scale

    def inverse(self) -> Tensor:
        """Return F(W), ``(C, L // 2 + 1, M)`` complex."""
        return from_pairs(self.weight) * self.root
