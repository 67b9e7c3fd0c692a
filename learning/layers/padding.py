"""How measurement, PSF and scene lie in one period of the FFT, and how a cut-off measurement is continued."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from simulator.arrays import next_fast_len


@dataclass(frozen=True)
class AxisPlan:
    """One axis of the FFT.

    Attributes:
        sensor: samples of the measurement, which lies at 0.
        length: period: the sensor where it holds all of the light, else long enough that what is cut off has a place.
        offset: where the scene begins.
        size: samples of the scene.
    """

    sensor: int
    length: int
    offset: int
    size: int

    @classmethod
    def fit(cls, sensor: int, scene: int, psf: int) -> AxisPlan:
        """Return the plan for these sizes: light of a scene falls on ``scene + psf - 1`` samples."""
        return cls(sensor, next_fast_len(max(sensor, scene + psf - 1)), (sensor - scene) // 2, scene)

    @property
    def scene(self) -> slice:
        """Where the scene lies."""
        return slice(self.offset, self.offset + self.size)

    def place(self, kernel: NDArray[np.floating], axis: int) -> NDArray[np.floating]:
        """Return the PSFs with their origin (sample ``n // 2``) at 0 of the period; what is longer folds over."""
        moved = np.moveaxis(kernel, axis, 0)
        placed = np.zeros((self.length, *moved.shape[1:]), kernel.dtype)
        np.add.at(placed, (np.arange(len(moved)) - len(moved) // 2) % self.length, moved)
        return np.moveaxis(placed, 0, axis)


def pad_measurement(measurement: Tensor, rows: AxisPlan, columns: AxisPlan) -> Tensor:
    """Continue a measurement ``(..., H, W)`` to a period ``(..., L, M)``.

    The first and last samples are repeated and fade out with a raised cosine: a hard end would ring in the division.
    """
    return _continued(_continued(measurement, rows, -2), columns, -1)


def _continued(values: Tensor, plan: AxisPlan, dim: int) -> Tensor:
    gap = plan.length - plan.sensor
    if gap == 0:
        return values
    steps = (torch.arange(gap, device=values.device, dtype=values.dtype) + 1) / (gap + 1)
    shape = [1] * values.ndim
    shape[dim] = gap
    # Both ends have half of the gap: the last sample fades out by its middle, the first rises from there.
    fading = (torch.cos(torch.pi * steps) ** 2 * (steps < 0.5)).reshape(shape)
    last, first = values.narrow(dim, plan.sensor - 1, 1), values.narrow(dim, 0, 1)
    return torch.cat([values, last * fading + first * fading.flip(dim)], dim=dim)
