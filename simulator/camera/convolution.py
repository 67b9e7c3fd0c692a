"""Convolution of scene planes with their PSFs onto the sensor, and its adjoint.

y = crop sum_k H_k (*) V_k for every channel: summed over depth in the Fourier domain before one inverse transform, in
real arithmetic, with rows of zeros and (on NumPy) empty planes left out. NumPy or torch, gradients included.
"""

from __future__ import annotations

import numpy as np

from simulator.arrays import Array, fft, ifft, irfft, is_torch, namespace, next_fast_len, rfft
from simulator.errors import InputError


class StackConvolution:
    """The linear map from planes ``(K, C, h, w)`` to the sensor ``(C, H, W)``.

    Scene pixel (i, j) lies under sensor pixel ``(i + (H - h) / 2, j + (W - w) / 2)``; a PSF's origin is its sample
    ``(rows // 2, columns // 2)``.
    """

    def __init__(
        self, values: Array, sensor_shape: tuple[int, int], scene_shape: tuple[int, int], boundary: str = "linear"
    ) -> None:
        """Transform the PSFs once.

        Args:
            values: PSFs ``(K, C, rows, columns)``.
            sensor_shape: H, W.
            scene_shape: h, w; each of the same parity as the sensor's and not larger.
            boundary: ``linear``: light that misses the sensor is lost; ``circular``: it comes back on the other side
                (the thesis's assumption, under which closed-form inversions are exact).

        Raises:
            InputError: for other boundaries or shapes that do not fit.
        """
        if boundary not in ("linear", "circular"):
            msg = f"boundary: got {boundary!r}, expected 'linear' or 'circular'"
            raise InputError(msg)
        for axis, sensor, scene in zip(("rows", "columns"), sensor_shape, scene_shape, strict=True):
            if scene > sensor or (sensor - scene) % 2:
                msg = (
                    f"scene_shape: {scene} {axis} on a sensor of {sensor}; a scene is at most as large as the sensor and "
                    f"even or odd like it, so that pixels lie on pixels: use {scene - 1 if scene > 1 else scene + 1}"
                )
                raise InputError(msg)
        self.sensor_shape, self.scene_shape, self.boundary = sensor_shape, scene_shape, boundary
        axes = [
            _axis_plan(size, sensor, scene, boundary == "circular")
            for size, sensor, scene in zip(values.shape[-2:], sensor_shape, scene_shape, strict=True)
        ]
        self._lengths = tuple(length for length, _, _ in axes)
        kernel = values
        for axis, (length, target, source) in zip((-2, -1), axes, strict=True):
            kernel = _place(kernel, length, target, source, axis)
        self._spectrum = self._transform(kernel)

    def forward(self, planes: Array) -> Array:
        """Return the sensor image ``(C, H, W)`` of planes ``(K, C, h, w)``."""
        expected = (*self._spectrum.shape[:2], *self.scene_shape)
        if tuple(planes.shape) != tuple(expected):
            msg = f"planes must be (K, C, h, w) = {tuple(expected)}, got {tuple(planes.shape)}"
            raise InputError(msg)
        xp = namespace(planes)
        total = xp.zeros(self._spectrum.shape[1:], dtype=self._spectrum.dtype, device=planes.device)
        for plane, spectrum in zip(planes, self._spectrum, strict=True):
            if is_torch(planes):  # a plane of zeros may still want a gradient
                total = total + self._transform(plane) * spectrum
            elif plane.any():
                total += self._transform(plane) * spectrum
        return self._inverse(total, self.sensor_shape)

    def adjoint(self, image: Array) -> Array:
        """Return the planes ``(K, C, h, w)`` of a sensor image ``(C, H, W)``: the transpose of ``forward``."""
        xp = namespace(image)
        transformed = self._transform(image)
        planes = [self._inverse(transformed * xp.conj(spectrum), self.scene_shape) for spectrum in self._spectrum]
        return xp.stack(planes)

    def _transform(self, image: Array) -> Array:
        """Return the spectrum ``(..., columns, rows)``: transposed, so that each pass runs along contiguous memory."""
        columns = namespace(image).moveaxis(rfft(image, self._lengths[1], -1), -1, -2)
        return fft(columns, self._lengths[0], -1)

    def _inverse(self, spectrum: Array, shape: tuple[int, int]) -> Array:
        """Return the first ``shape`` rows and columns of a spectrum's image."""
        rows = namespace(spectrum).moveaxis(ifft(spectrum, -1)[..., : shape[0]], -1, -2)
        return irfft(rows, self._lengths[1], -1)[..., : shape[1]]


def _axis_plan(size: int, sensor: int, scene: int, circular: bool) -> tuple[int, np.ndarray, np.ndarray]:
    """Return FFT length, where kernel samples go, and which kernel samples they are, along one axis.

    A kernel sample of displacement s takes scene pixel j to sensor pixel s + offset + j. Displacements that no pair of
    pixels has are dropped, and the period is just long enough that no other one aliases onto the sensor.
    """
    offset = (sensor - scene) // 2
    source = np.arange(size)
    displacement = source - size // 2
    if circular:
        return sensor, (displacement + offset) % sensor, source
    least, most = -offset - scene + 1, sensor - 1 - offset
    used = (displacement >= least) & (displacement <= most)
    source, displacement = source[used], displacement[used]
    period = max(displacement.max() - least, most - displacement.min()) + 1
    length = next_fast_len(int(max(period, sensor)))
    return length, (displacement + offset) % length, source


def _place(kernel: Array, length: int, target: np.ndarray, source: np.ndarray, axis: int) -> Array:
    """Add kernel samples ``source`` into a zero array at ``target`` along an axis; equal targets add up."""
    xp = namespace(kernel)
    moved = xp.moveaxis(kernel, axis, 0)
    placed = xp.zeros((length, *moved.shape[1:]), dtype=kernel.dtype, device=kernel.device)
    for start in range(0, len(target), length):  # a kernel longer than the period folds over, one period at a time
        part = slice(start, start + length)
        index = xp.asarray(target[part], device=kernel.device)
        placed[index] = placed[index] + moved[xp.asarray(source[part], device=kernel.device)]
    return xp.moveaxis(placed, 0, axis)
