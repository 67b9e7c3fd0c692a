"""The mask on a finer grid than its own, exactly: its spectrum is continued beyond the grid's band, not interpolated.

A staircase's spectrum repeats in diffraction orders under the sinc of its pixel, so the band-limited staircase is known
at any point; multiplied by a smooth incident wave it stays alias-free, which no repetition of pixels would. A smooth
mask's spectrum ends at its own Nyquist frequency.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from simulator.arrays import Array, complex_dtype, fft, ifft, is_torch, like, namespace, next_fast_len
from simulator.optics.propagation import blocks, in_threads

TAPER = 0.95  # a staircase's band fades out from here: a sharp end would ring across the whole grid
_TAIL = 12.0  # in units of one over the taper's width: what is left of the ringing is below 1e-5


@dataclass(frozen=True)
class Band:
    """The frequencies of a mask that are followed, per axis.

    Attributes:
        full: up to here all light is kept, cycles per metre.
        end: beyond this nothing is; equal to ``full`` where the mask's own band ends.
        pixel_m: side of the staircase's pixel, metres; 0 for smooth masks.
    """

    full: float
    end: float
    pixel_m: float

    def weights(self, frequency: np.ndarray) -> np.ndarray:
        """Return the factor on the mask's spectrum, continued periodically, at these frequencies."""
        f = np.abs(frequency)
        if self.end > self.full:
            fading = np.cos(np.pi / 2 * np.clip((f - self.full) / (self.end - self.full), 0, 1)) ** 2
        else:
            # The two signs of the Nyquist frequency share one bin.
            fading = np.where(np.isclose(f, self.end, rtol=1e-12), 0.5, f < self.end)
        return fading * np.sinc(self.pixel_m * frequency)

    @property
    def tail_m(self) -> float:
        """How far beyond the mask's edge (metres) the band-limited mask still has light."""
        return _TAIL / (self.end - self.full) / (2 * np.pi) if self.end > self.full else 0.0


@dataclass(frozen=True)
class FineGrid:
    """A square, centred grid: sample i lies at ``(i - samples // 2) pitch_m``.

    Attributes:
        samples: per axis, even.
        pitch_m: metres.
        mask_samples: the mask's own samples in the same period.
        half: samples of the mask's window on each side of the centre (rows, columns).
    """

    samples: int
    pitch_m: float
    mask_samples: int
    half: tuple[int, int]

    @property
    def window(self) -> tuple[slice, slice]:
        """Rows and columns in which the mask lies."""
        middle = self.samples // 2
        rows, columns = (slice(middle - h, middle + h + 1) for h in self.half)
        return rows, columns

    def positions_m(self, axis: int) -> np.ndarray:
        """Return the window's coordinates along an axis, metres."""
        return np.arange(-self.half[axis], self.half[axis] + 1) * self.pitch_m


def fine_grid(shape: tuple[int, int], pitch_m: float, band: Band, residual: float, margin_m: float) -> FineGrid:
    """Choose the coarsest grid that holds mask, incident wave and the light's sideways travel.

    Args:
        shape: rows and columns of the mask.
        pitch_m: its pitch, metres.
        band: what is followed of the mask.
        residual: highest frequency of the incident wave, cycles per metre.
        margin_m: how far the light may travel sideways, metres, on each side.
    """
    width_m = max(shape) * pitch_m + 2 * band.tail_m
    mask_samples = 2 * next_fast_len(math.ceil((width_m / 2 + margin_m) / pitch_m) + 1)
    period_m = mask_samples * pitch_m
    needed = period_m * 2 * (band.end + residual)
    samples = max(mask_samples, 2 * next_fast_len(math.ceil(needed / 2 * (1 - 1e-9))))
    fine_m = period_m / samples
    half = tuple(min(math.ceil((n * pitch_m / 2 + band.tail_m) / fine_m), samples // 2 - 1) for n in shape)
    return FineGrid(samples, fine_m, mask_samples, (half[0], half[1]))


def fine_transmission(transmission: Array, grid: FineGrid, band: Band, threads: int = 1) -> Array:
    """Return the band-limited transmission in the grid's window.

    Args:
        transmission: complex ``(H, W)`` at the mask's own pitch; a staircase's pixels once each.
        grid: from ``fine_grid``.
        band: what is followed.
        threads: NumPy only.

    Returns:
        Complex ``(2 half_y + 1, 2 half_x + 1)`` of the same precision.
    """
    rows, columns = (_Continuation(n, grid, band, axis) for axis, n in enumerate(transmission.shape))
    if is_torch(transmission):
        return columns(rows(transmission, -2), -1)
    width = transmission.shape[1]
    tall = np.empty((rows.length, width), complex_dtype(transmission))
    fine = np.empty((rows.length, columns.length), tall.dtype)

    def down(part: slice) -> None:
        tall[:, part] = rows(transmission[:, part], -2)

    def across(part: slice) -> None:
        fine[part] = columns(tall[part], -1)

    in_threads(down, blocks(tall, width, grid.samples), threads)
    in_threads(across, blocks(tall, rows.length, grid.samples), threads)
    return fine


class _Continuation:
    """The continuation along one axis: FFT, spectrum repeated under the band's weights, inverse FFT, window."""

    def __init__(self, length: int, grid: FineGrid, band: Band, axis: int) -> None:
        self._samples, self._period, self._window = grid.samples, grid.mask_samples, grid.window[axis]
        period_m = grid.samples * grid.pitch_m
        last = min(math.floor(band.end * period_m * (1 + 1e-12)), grid.samples // 2 - 1)
        first = -min(last + 1, grid.samples // 2)
        # From the mask's first sample to the grid's centre; both centres coincide.
        shift = (length - 1) / 2 / grid.mask_samples - 0.5
        order = np.arange(first, last + 1)
        weights = band.weights(order / period_m) * np.exp(2j * np.pi * order * shift)
        weights *= grid.samples / grid.mask_samples
        # Whole periods of the mask's spectrum, cut at order zero too: there the FFT's order wraps.
        edges = [*range(first // self._period * self._period + self._period, last + 1, self._period)]
        edges = [first, *(edge for edge in edges if first < edge), last + 1]
        self._parts = [(start, stop, weights[start - first : stop - first]) for start, stop in pairwise(edges)]
        self.length = 2 * grid.half[axis] + 1

    def __call__(self, array: Array, axis: int) -> Array:
        xp = namespace(array)
        narrow = fft(array, self._period, axis)
        shape = list(array.shape)
        shape[axis] = self._samples
        wide = xp.zeros(shape, dtype=narrow.dtype, device=narrow.device)
        for start, stop, weights in self._parts:
            source = slice(start % self._period, start % self._period + stop - start)
            target = slice(start % self._samples, start % self._samples + stop - start)
            weights = like(weights, narrow)
            if axis == -1:
                wide[..., target] = narrow[..., source] * weights
            else:
                wide[..., target, :] = narrow[..., source, :] * weights[:, None]
        field = ifft(wide, axis, overwrite=True)
        return field[..., self._window] if axis == -1 else field[..., self._window, :]
