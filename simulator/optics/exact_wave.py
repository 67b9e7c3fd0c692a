"""The light of point sources on the sensor: mask times incident wave, rows to spectra, columns there and back.

Three sweeps over one array, in blocks that stay in the cache: rows of the product to spectra, columns to spectra, through
the transfer function and back, and (in ``Wave.intensity``) rows back. What several sources share is made once: the finely
sampled mask and the transfer function.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from simulator.arrays import (
    Array,
    bytes_per_sample,
    complex_dtype,
    fft,
    fft2,
    free_bytes,
    ifft,
    is_torch,
    like,
    namespace,
    pad2d,
    real_dtype,
    require_memory,
)
from simulator.optics.even_filter import blocks, in_threads
from simulator.optics.exact_plan import Plan, plan
from simulator.optics.fine_mask import FineGrid, fine_transmission
from simulator.optics.illumination import Source
from simulator.optics.mask import Mask
from simulator.optics.transfer import TiltedTransfer, Transfer
from simulator.types import CameraGeometry

LEAST = 16  # rows or columns at a time: measured, 8 and 64 are a quarter slower
FINE_MASK = 0.4  # what sampling the mask finely costs, in waves on the same grid


@dataclass(frozen=True)
class Wave:
    """The light of one source on the sensor, half-way: columns propagated, rows still spectra.

    Attributes:
        grid: the fine grid; sample ``samples // 2`` is the PSF's centre.
        spectrum: ``(samples, samples)`` complex, rows to be transformed back.
    """

    grid: FineGrid
    spectrum: Array

    @property
    def real(self) -> Array:
        """Return a small real array of the same kind, precision and device."""
        return namespace(self.spectrum).real(self.spectrum[:1, :1])

    def intensity(self, rows: slice | np.ndarray) -> Array:
        """Return |U|^2 in some rows, ``(rows, samples)``, in the physical frame."""
        xp = namespace(self.spectrum)
        field = ifft(self.spectrum[rows], -1)
        return xp.real(field) ** 2 + xp.imag(field) ** 2


def waves(
    mask: Mask, camera: CameraGeometry, sources: Sequence[Source], *, oversampling: int = 1, threads: int = 1
) -> Iterator[Wave]:
    """Yield the wave of each source on the sensor; each is only good until the next is asked for.

    Args:
        mask: the mask; its arrays decide precision and kind.
        camera: distance or layers.
        sources: point sources of one wavelength and direction.
        oversampling: multiplies the orders that are followed behind a staircase, the samples of a smooth mask.
        threads: NumPy only.

    Raises:
        InputError: when the grid would not fit into memory.
    """
    plans = [plan(mask, camera, oversampling, source) for source in sources]
    grids = [each.grid(mask, oversampling) for each in plans]
    largest = max(grid.samples for grid in grids)
    cure = "use a coarser or narrower mask, less oversampling, or model 'scaled_distance'"
    on_torch = is_torch(mask.height_m)
    # The wave, the mask's window on the grid, the transfer function's quadrant, the mask's own spectrum; torch works on
    # whole arrays in float64 and keeps more of them for gradients.
    held = 10.0 if on_torch else 2.0
    require_memory(
        "model: exact", (largest, largest), held, bytes_per_sample(mask.height_m), cure, free_bytes(mask.height_m)
    )
    memory = None if on_torch else np.empty(largest**2, complex_dtype(mask.height_m))
    for part in _shared([grid.samples for grid in grids], [source.carrier for source in sources]):
        widest = max(range(part.start, part.stop), key=lambda k: grids[k].samples)
        several = part.stop - part.start > 1
        light = _Light(mask, plans[widest], grids[widest], oversampling, several, threads)
        for source in sources[part]:
            yield Wave(light.grid, light.on_torch(source) if on_torch else light.on_numpy(source, memory))
        del light  # before the next one takes its memory


def _shared(samples: Sequence[int], carriers: Sequence[tuple[float, float]]) -> list[slice]:
    """Cut sources into runs of one carrier that share a grid, the largest that one of them needs, at the least cost.

    A wave costs its grid's area, the finely sampled mask ``FINE_MASK`` times that, once for each run.
    """
    best: list[tuple[float, int]] = [(0.0, 0)]  # cost of the first k sources, and where their last run starts
    for stop in range(1, len(samples) + 1):
        options, largest = [], 0
        for start in range(stop - 1, -1, -1):
            if carriers[start] != carriers[stop - 1]:  # behind a window the carrier depends on the depth
                break
            largest = max(largest, samples[start])
            options.append((best[start][0] + largest**2 * (FINE_MASK + stop - start), start))
        best.append(min(options))
    runs, stop = [], len(samples)
    while stop:
        runs.append(slice(best[stop][1], stop))
        stop = best[stop][1]
    return runs[::-1]


class _Light:
    """The mask on a fine grid and the way to the sensor, for sources that share grid, wavelength and carrier."""

    def __init__(
        self, mask: Mask, plan: Plan, grid: FineGrid, oversampling: int, keep_transfer: bool, threads: int
    ) -> None:
        source, factor = plan.source, oversampling if mask.profile == "smooth" else 1
        transmission = mask.transmission(source.wavelength_m, factor, math.hypot(*source.carrier))
        self.grid, self._gap, self._threads = grid, plan.gap, threads
        self._fine = fine_transmission(transmission, grid, plan.band, threads)
        self._reach = (plan.travel_m, plan.travel_m) if plan.limited else None
        shape, self._even = (grid.samples, grid.samples), source.on_axis
        self._transfer = (
            Transfer(shape, grid.pitch_m, source.wavelength_m, like=self._fine)
            if self._even
            else TiltedTransfer(shape, grid.pitch_m, source.wavelength_m, source.carrier, like=self._fine)
        )
        self._quadrant: np.ndarray | None = None
        if keep_transfer and self._even and not is_torch(self._fine):
            self._quadrant = np.empty((grid.samples // 2 + 1,) * 2, self._fine.dtype)
            in_threads(self._fill_quadrant, blocks(self._fine, len(self._quadrant), len(self._quadrant)), threads)

    def on_numpy(self, source: Source, memory: np.ndarray | None) -> np.ndarray:
        """Return the half-transformed wave of a source, written into ``memory``."""
        assert memory is not None
        samples = self.grid.samples
        work = memory[: samples**2].reshape(samples, samples)
        self._rows(source, work)
        self._columns(work)
        return work

    def on_torch(self, source: Source) -> Array:
        """Return the half-transformed wave of a source as a tensor."""
        fine, grid = self._fine, self.grid
        xp = namespace(fine)
        y, x = (like(grid.positions_m(axis), fine, xp.float64) for axis in (0, 1))
        field = fine * source.wave(y[:, None], x[None, :], real_dtype(fine))
        rows, columns = grid.window
        spectrum = fft2(pad2d(field, (grid.samples, grid.samples), (rows.start, columns.start)))
        if isinstance(self._transfer, Transfer):
            quadrant = self._transfer.quadrant(self._gap, self._reach)
            half = xp.concat([quadrant, xp.flip(quadrant[1:-1], axis=0)], axis=0)
            weights = xp.concat([half, xp.flip(half[:, 1:-1], axis=1)], axis=1)
        else:
            weights = self._transfer.block(self._gap, self._reach)
        return ifft(spectrum * weights, -2)

    def _rows(self, source: Source, work: np.ndarray) -> None:
        """Fill ``work`` with the row spectra of mask times incident wave."""
        fine, grid, (rows, columns) = self._fine, self.grid, self.grid.window
        work[: rows.start] = 0
        work[rows.stop :] = 0
        y, x = grid.positions_m(0), grid.positions_m(1)
        real = real_dtype(fine)
        half_y, half_x = grid.half

        def transform(first: int, stop: int, wave: np.ndarray) -> None:
            field = np.zeros((stop - first, grid.samples), fine.dtype)
            np.multiply(fine[first:stop], wave, out=field[:, columns])
            work[rows.start + first : rows.start + stop] = fft(field, grid.samples, -1, overwrite=True)

        def oblique(part: slice) -> None:
            transform(part.start, part.stop, source.wave(y[part, None], x[None, :], real))

        def even(part: slice) -> None:
            # One quadrant of an on-axis wave stands for all four.
            quarter = source.wave(y[half_y + part.start : half_y + part.stop, None], x[None, half_x:], real)
            wave = np.concatenate([quarter[:, :0:-1], quarter], axis=1)
            transform(half_y + part.start, half_y + part.stop, wave)
            skip = 1 if part.start == 0 else 0
            if part.stop - part.start > skip:
                transform(half_y - part.stop + 1, half_y - part.start - skip + 1, wave[skip:][::-1])

        if source.on_axis:
            in_threads(even, blocks(fine, half_y + 1, grid.samples, LEAST), self._threads)
        else:
            in_threads(oblique, blocks(fine, 2 * half_y + 1, grid.samples, LEAST), self._threads)

    def _columns(self, work: np.ndarray) -> None:
        """Propagate the columns of ``work`` in place."""
        samples = self.grid.samples

        def filter_columns(part: slice, weights: np.ndarray) -> None:
            spectrum = fft(work[:, part], samples, 0)
            spectrum *= weights
            work[:, part] = ifft(spectrum, 0, overwrite=True)

        def even(part: slice) -> None:
            quadrant = self._quadrant_columns(part) if self._quadrant is None else self._quadrant[:, part]
            weights = np.concatenate([quadrant, quadrant[-2:0:-1]], axis=0)
            filter_columns(part, weights)
            # Negative frequencies repeat all columns but zero and Nyquist.
            first, stop = max(part.start, 1), min(part.stop, samples // 2)
            if first < stop:
                mirrored = weights[:, first - part.start : stop - part.start][:, ::-1]
                filter_columns(slice(samples - stop + 1, samples - first + 1), mirrored)

        def oblique(part: slice) -> None:
            assert isinstance(self._transfer, TiltedTransfer)
            filter_columns(part, self._transfer.block(self._gap, self._reach, columns=part))

        if self._even:
            in_threads(even, blocks(work, samples // 2 + 1, samples, LEAST), self._threads)
        else:
            in_threads(oblique, blocks(work, samples, samples, LEAST), self._threads)

    def _quadrant_columns(self, columns: slice) -> np.ndarray:
        assert isinstance(self._transfer, Transfer)
        return self._transfer.quadrant(self._gap, self._reach, columns=columns)

    def _fill_quadrant(self, columns: slice) -> None:
        assert self._quadrant is not None
        self._quadrant[:, columns] = self._quadrant_columns(columns)
