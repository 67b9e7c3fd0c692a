"""The periodic grid on which ADMM works: where sensor and scene lie, the PSFs' spectra, and the normal equations there."""

from __future__ import annotations

from typing import Literal

import numpy as np
import torch
from torch import Tensor, nn

from learning.baselines.total_variation import difference_power
from learning.capture import CaptureModel
from learning.layers.padding import AxisPlan, as_pairs, from_pairs
from simulator.arrays import next_fast_len, to_numpy


class AdmmGrid(nn.Module):
    """Spectra of the PSFs, each channel divided by the root of its mean energy, on a period without wrap-around.

    Attributes:
        power: sum_z |FH|^2, ``(C, L, M // 2 + 1)``.
        differences: |FD|^2, ``(L, M // 2 + 1)``.
        norm: what the channels' PSFs were divided by, ``(C,)`` float64.
        shape: L, M.
        sensor: rows and columns of the measurement.
        scene: rows and columns of the scene.
        light: rows and columns where light may come from.
    """

    spectrum_pairs: Tensor
    conjugate_pairs: Tensor
    power: Tensor
    differences: Tensor

    def __init__(self, capture: CaptureModel, light: Literal["scene", "anywhere"], dtype: torch.dtype) -> None:
        """Transform the PSFs once.

        Args:
            capture: the camera.
            light: see `learning.baselines.admm.Admm`.
            dtype: float32 or float64.
        """
        super().__init__()
        values = to_numpy(capture.stack.values).astype(np.float64)
        self.norm = np.sqrt(np.mean(np.sum(values**2, axis=(-2, -1)), axis=0))
        fit = _shortest if light == "scene" else AxisPlan.fit
        plans = [
            fit(*sizes) for sizes in zip(capture.sensor_shape, capture.scene_shape, values.shape[-2:], strict=True)
        ]
        rows, columns = plans
        self.shape = (rows.length, columns.length)
        self.sensor = (..., slice(rows.sensor), slice(columns.sensor))
        self.scene = (..., rows.scene, columns.scene)
        self.light = self.scene if light == "scene" else (..., slice(rows.length), slice(columns.length))
        kernel = columns.place(rows.place(values / self.norm[:, None, None], -2), -1)
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

    @property
    def conjugate(self) -> Tensor:
        """Its complex conjugate, laid out in memory once."""
        return from_pairs(self.conjugate_pairs).unflatten(0, self._planes)

    def image(self, volume: Tensor) -> Tensor:
        """Return the spectrum of sum_z H S, ``(B, 1, C, L, M // 2 + 1)``, of a volume's ``(B, K, C, L, M // 2 + 1)``."""
        return (self.spectrum * volume).sum(dim=1, keepdim=True)

    def pictures(self, spectrum: Tensor) -> Tensor:
        """Return the pictures ``(..., L, M)`` of spectra ``(..., L, M // 2 + 1)``."""
        # In two calls, of which torch's own irfft2 takes 1.4 times as long.
        return torch.fft.irfft(torch.fft.ifft(spectrum, dim=-2), self.shape[1], dim=-1)

    def on_sensor(self, image: Tensor) -> Tensor:
        """Return the spectrum of images ``(..., H, W)`` with zeros around them."""
        return torch.fft.rfft2(image, self.shape)

    def solve(self, volume: Tensor, image: Tensor, weights: tuple[Tensor, Tensor, Tensor]) -> tuple[Tensor, Tensor]:
        """Solve (A^T M A) X = volume + H^H image at every frequency, in the Fourier domain.

        A^T M A = a H^H H + q with one row H of K numbers, one weight a of the image and one number q = b |FD|^2 + c of the
        other two: with n = H H^H, by Sherman and Morrison, X = (volume + H^H (q image - a H volume) / (q + a n)) / q.

        Args:
            volume: spectrum ``(B, K, C, L, M // 2 + 1)``; overwritten with X.
            image: spectrum ``(B, 1, C, L, M // 2 + 1)``.
            weights: a, b, c, each ``(B, 1, C, 1, 1)``.

        Returns:
            X, and the image H X of it.
        """
        a, b, c = weights
        own = b * self.differences + c
        both = own + a * self.power
        seen = self.image(volume)
        volume.addcmul_(self.conjugate, (own * image - a * seen) / both).mul_(1 / own)
        return volume, (seen + self.power * image) / both


def _shortest(sensor: int, scene: int, psf: int) -> AxisPlan:
    """Return the plan whose period is just long enough that no light from the scene comes round onto the sensor."""
    offset = (sensor - scene) // 2
    first = offset - psf // 2
    last = offset + scene - 1 + (psf - 1 - psf // 2)
    return AxisPlan(sensor, next_fast_len(max(sensor, sensor - first, last + 1)), offset, scene)
