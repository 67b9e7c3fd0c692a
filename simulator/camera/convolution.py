"""Convolution of scene planes with their PSFs onto the sensor, over time and with weights per row, and its adjoint.

y[c, r, x] = crop sum_t w[t, r] sum_k (H[k, c] (*) V[t, k, c])[r, x]: summed over depth in the Fourier domain, over time where
only columns are still transformed, since weights of rows stand in no other's way: two passes and one inverse pass per
frame, and one last inverse pass for all. Real arithmetic; rows of zeros and (on NumPy) empty planes are left out. NumPy or
torch, gradients included.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import Array, fft, ifft, irfft, is_torch, like, namespace, next_fast_len, rfft
from simulator.errors import InputError


class StackConvolution:
    """The linear map from planes ``(K, ..., C, h, w)`` to the sensor ``(..., C, H, W)``; ``...`` is a batch, or nothing.

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
            scene_shape: h, w; each of the same parity as the sensor's. Larger than the sensor is a scene whose margins send
                it light from beside the image.
            boundary: ``linear``: light that misses the sensor is lost; ``circular``: it comes back on the other side
                (the thesis's assumption, under which closed-form inversions are exact), for scenes no larger than the sensor.
        """
        if boundary not in ("linear", "circular"):
            raise InputError("boundary", f"got {boundary!r}, expected 'linear' or 'circular'")
        for axis, sensor, scene in zip(("rows", "columns"), sensor_shape, scene_shape, strict=True):
            if scene < 1 or (sensor - scene) % 2:
                raise InputError(
                    "scene_shape",
                    f"got {scene} {axis} for {sensor} of the sensor, expected a number even or odd like it; "
                    f"use {scene - 1 if scene > 1 else scene + 1}",
                )
            if boundary == "circular" and scene > sensor:
                raise InputError(
                    "scene_shape",
                    f"got {scene} {axis} for {sensor} of the sensor, expected at most as many where the boundary is "
                    "circular; leave the margin out, or use linear",
                )
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
        """Return the sensor image ``(..., C, H, W)`` of planes ``(K, ..., C, h, w)``."""
        return self.forward_rows([planes], np.ones((1, self.sensor_shape[0])))

    def forward_rows(self, frames: Iterable[Array], row_weights: NDArray[np.floating]) -> Array:
        """Return the sensor image ``(..., C, H, W)`` of frames, each weighted row by row.

        Frames whose weights are alike in all rows are added up before they are convolved.

        Args:
            frames: T times planes ``(K, ..., C, h, w)``; taken one by one.
            row_weights: ``(T, H)``; a frame that weighs nothing is not transformed.
        """
        total, alike, planes = None, None, self._spectrum[..., :1, :1] * 0
        for planes, weights in zip(frames, row_weights, strict=True):
            self._check_planes(planes)
            if not np.any(weights):
                continue
            if np.all(weights == weights[0]):
                alike = _plus(alike, planes * float(weights[0]))
            else:
                total = _plus(total, self._columns(planes) * like(weights, planes))
        if alike is not None:
            total = _plus(total, self._columns(alike))
        if total is None:
            total = self._dark(planes)
        rows = namespace(total).moveaxis(total, -1, -2)
        return irfft(rows, self._lengths[1], -1)[..., : self.sensor_shape[1]]

    def adjoint(self, image: Array) -> Array:
        """Return the planes ``(K, ..., C, h, w)`` of an image ``(..., C, H, W)``: the transpose of ``forward``."""
        return self.adjoint_rows(image, np.ones((1, self.sensor_shape[0])))[0]

    def adjoint_rows(self, image: Array, row_weights: NDArray[np.floating]) -> Array:
        """Return the frames ``(T, K, ..., C, h, w)`` of an image ``(..., C, H, W)``: the transpose of ``forward_rows``."""
        columns = namespace(image).moveaxis(rfft(image, self._lengths[1], -1), -1, -2)
        plain = None  # the frame of a weight of 1: others that are alike in all rows are multiples of it
        frames = []
        for weights in row_weights:
            if not np.all(weights == weights[0]):
                frames.append(self._frame(columns * like(weights, image)))
                continue
            plain = self._frame(columns) if plain is None else plain
            frames.append(plain * float(weights[0]))
        return namespace(image).stack(frames)

    def _check_planes(self, planes: Array) -> None:
        expected = (*self._spectrum.shape[:2], *self.scene_shape)
        if (*planes.shape[:1], *planes.shape[-3:]) != tuple(expected):
            raise InputError("planes", f"expected (K, ..., C, h, w) = {tuple(expected)}, got {tuple(planes.shape)}")

    def _columns(self, planes: Array) -> Array:
        """Return the sum of the convolved planes, columns still transformed: ``(..., C, columns, H)``."""
        total = None
        for plane, spectrum in zip(planes, self._spectrum, strict=True):
            if is_torch(planes) or plane.any():  # in torch a plane of zeros may still want a gradient
                total = _plus(total, self._transform(plane) * spectrum)
        return self._dark(planes) if total is None else ifft(total, -1, overwrite=True)[..., : self.sensor_shape[0]]

    def _dark(self, planes: Array) -> Array:
        """Return what ``_columns`` of planes without light is."""
        return self._spectrum[0, ..., : self.sensor_shape[0]] * (planes[0, ..., :1, :1] * 0)

    def _frame(self, columns: Array) -> Array:
        """Return the planes ``(K, ..., C, h, w)`` of a sensor image whose columns are still transformed."""
        transformed = fft(columns, self._lengths[0], -1)
        xp = namespace(columns)
        return xp.stack([self._inverse(transformed * xp.conj(spectrum)) for spectrum in self._spectrum])

    def _transform(self, image: Array) -> Array:
        """Return the spectrum ``(..., columns, rows)``: transposed, so that each pass runs along contiguous memory."""
        columns = namespace(image).moveaxis(rfft(image, self._lengths[1], -1), -1, -2)
        return fft(columns, self._lengths[0], -1)

    def _inverse(self, spectrum: Array) -> Array:
        """Return a spectrum's image on the scene's rows and columns."""
        height, width = self.scene_shape
        rows = namespace(spectrum).moveaxis(ifft(spectrum, -1, overwrite=True)[..., :height], -1, -2)
        return irfft(rows, self._lengths[1], -1)[..., :width]


def _plus(total: Array | None, part: Array) -> Array:
    if total is None:
        return part
    if is_torch(part):
        return total + part
    total += part
    return total


def _axis_plan(size: int, sensor: int, scene: int, circular: bool) -> tuple[int, np.ndarray, np.ndarray]:
    """Return FFT length, where kernel samples go, and which kernel samples they are, along one axis.

    A kernel sample of displacement s takes scene pixel j to sensor pixel s + offset + j. Displacements that no pair of
    pixels has are dropped, and the period is just long enough that no other one aliases onto the sensor.
    """
    offset = (sensor - scene) // 2  # negative where the scene is larger
    source = np.arange(size)
    displacement = source - size // 2
    if circular:
        return sensor, (displacement + offset) % sensor, source
    least, most = -offset - scene + 1, sensor - 1 - offset
    used = (displacement >= least) & (displacement <= most)
    source, displacement = source[used], displacement[used]
    period = max(displacement.max() - least, most - displacement.min()) + 1
    length = next_fast_len(int(max(period, sensor, scene)))  # an FFT drops what is longer than itself
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
