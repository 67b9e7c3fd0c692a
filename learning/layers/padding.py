"""How measurement, PSF and scene lie in one period of the FFT, and how a cut-off measurement is continued."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as nnf
from numpy.typing import NDArray
from torch import Tensor

from learning.camera import CaptureModel
from simulator.arrays import next_fast_len
from simulator.errors import InputError


@dataclass(frozen=True)
class AxisPlan:
    """One axis of the FFT.

    Attributes:
        sensor: samples of the measurement, which lies at 0.
        length: period, so long that all of the light has a place, also what the sensor cuts off.
        offset: where the scene begins.
        size: samples of the scene.
    """

    sensor: int
    length: int
    offset: int
    size: int

    @classmethod
    def fit(cls, sensor: int, scene: int, psf: int, field: int | None = None) -> AxisPlan:
        """Return the plan for these numbers of samples: light of a field (None: the scene) falls on ``field + psf - 1``."""
        return cls(sensor, next_fast_len(max(sensor, (field or scene) + psf - 1)), (sensor - scene) // 2, scene)

    @property
    def scene(self) -> slice:
        """Where the scene lies."""
        return slice(self.offset, self.offset + self.size)

    def place(self, kernel: NDArray[np.floating], axis: int) -> NDArray[np.floating]:
        """Return the PSFs with their origin (sample ``n // 2``) at 0 of the period; what is longer folds over."""
        moved = np.moveaxis(kernel, axis, 0)
        placed = np.zeros((self.length, *moved.shape[1:]), kernel.dtype)
        places = (np.arange(len(moved)) - len(moved) // 2) % self.length
        for start in range(0, len(moved), self.length):
            part = slice(start, start + self.length)  # no place twice
            placed[places[part]] += moved[part]
        return np.moveaxis(placed, 0, axis)


def axis_plans(capture: CaptureModel) -> tuple[AxisPlan, AxisPlan]:
    """Return the plans of rows and columns for a camera; see `AxisPlan.fit`."""
    psf = capture.stack.values.shape[-2:]
    sizes = zip(capture.sensor_shape, capture.scene_shape, psf, capture.field_shape, strict=True)
    rows, columns = (AxisPlan.fit(*each) for each in sizes)
    return rows, columns


def spectrum_of(image: Tensor) -> Tensor:
    """Return the spectrum ``(..., L // 2 + 1, M)`` of real images ``(..., L, M)``.

    Half of the rows, not of the columns, so that the inverse begins with what lies side by side in memory.
    """
    return torch.fft.rfft2(image, dim=(-1, -2)).contiguous()


def scene_of(spectrum: Tensor, rows: AxisPlan, columns: AxisPlan) -> Tensor:
    """Return the scene ``(..., h, w)`` of an image's spectrum ``(..., L // 2 + 1, M)``: the rest is not transformed."""
    part = torch.fft.ifft(spectrum, dim=-1)[..., columns.scene]
    return torch.fft.irfft(part, rows.length, dim=-2)[..., rows.scene, :]


def spectrum_of_scene(scene: Tensor, rows: AxisPlan, columns: AxisPlan) -> Tensor:
    """Return the spectrum ``(..., L // 2 + 1, M)`` of a scene ``(..., h, w)`` in the dark: `scene_of` turned round."""
    tall = nnf.pad(scene, (0, 0, rows.offset, rows.length - rows.scene.stop))
    part = torch.fft.rfft(tall, dim=-2)
    return torch.fft.fft(nnf.pad(part, (columns.offset, columns.length - columns.scene.stop)), dim=-1)


def as_pairs(spectrum: Tensor) -> Tensor:
    """Return complex numbers ``(..., M)`` as real ones ``(..., 2 M)``, real and imaginary parts in turn."""
    return torch.view_as_real(spectrum.resolve_conj()).flatten(-2)


def from_pairs(pairs: Tensor) -> Tensor:
    """Return the complex numbers ``(..., M)`` of `as_pairs`."""
    return torch.view_as_complex(pairs.unflatten(-1, (-1, 2)))


def check_measurement(
    measurement: Tensor, offset: Tensor, rows: AxisPlan, columns: AxisPlan, *, frames: bool = False
) -> None:
    """Refuse measurements ``(B, C, H, W)``, with ``frames`` also ``(B, N, C, H, W)``, of another shape than the camera's."""
    wanted = (len(offset), rows.sensor, columns.sensor)
    if measurement.ndim not in ((4, 5) if frames else (4,)) or tuple(measurement.shape[-3:]) != wanted:
        came = f"got shape {tuple(measurement.shape)}, expected (B, C, H, W) with (C, H, W) = {wanted}"
        raise InputError("measurement", f"{came}: it is of another camera than the PSF stack")


def pad_measurement(measurement: Tensor, rows: AxisPlan, columns: AxisPlan) -> Tensor:
    """Continue a measurement ``(..., H, W)`` to a period ``(..., L, M)``.

    The first and last samples are repeated and fade out with a raised cosine: a hard end would ring in the division. Where
    the sensor catches nearly all of the light, zeros would be 0.2 dB better; where it cuts off much, 2 dB worse and more.
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
