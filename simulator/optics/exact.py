"""PSFs without a paraxial step: the point source's own wave on the mask, the angular spectrum from there.

Nothing is scaled: the incident wave is spherical (or plane), oblique sources have their carrier and its sideways travel
taken out analytically, and the grid is as fine as mask and wave together need. Between mask and sensor light crosses the
camera's layers. The one approximation left beside the thin mask is the band: a staircase's light is followed up to
``orders`` diffraction orders of its pixel.

Sources: Goodman, Introduction to Fourier Optics, section 3.10; shifted angular spectrum: Matsushima, Opt. Express 18,
18453 (2010); on-axis illumination (z / r) exp(i k (r - z)).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import Array, fft, fft2, ifft, is_torch, like, namespace, pad2d, real_dtype
from simulator.optics.even_filter import blocks, in_threads
from simulator.optics.fine_mask import TAPER, Band, FineGrid, fine_grid, fine_transmission
from simulator.optics.illumination import Source
from simulator.optics.kernel import kernel_reach_m
from simulator.optics.layers import Strata, gap_strata, reduced_m
from simulator.optics.mask import Mask
from simulator.optics.propagation import MAX_SINE
from simulator.optics.resample import box_integral
from simulator.optics.transfer import TiltedTransfer, Transfer
from simulator.types import CameraGeometry

STEP = 1.08  # sources whose grids differ by less share one, and with it the finely sampled mask


@dataclass(frozen=True)
class Plan:
    """Where the light of one source goes and the grid that holds it.

    Attributes:
        source: the point source.
        gap: layers between mask and sensor.
        band: what is followed of the mask.
        travel_m: how far sideways light travels beyond its carrier, metres: the margin on each side of the mask.
        limited: whether steeper light exists and must be cut softly.
    """

    source: Source
    gap: Strata
    band: Band
    travel_m: float
    limited: bool

    def grid(self, mask: Mask, oversampling: int) -> FineGrid:
        """Return the grid that this source needs."""
        factor = oversampling if mask.profile == "smooth" else 1
        shape = (mask.shape[0] * factor, mask.shape[1] * factor)
        half_width = max(mask.shape) * mask.pitch_m / 2 + self.band.tail_m
        residual = self.source.residual_band(half_width)
        return fine_grid(shape, mask.pitch_m / factor, self.band, residual, self.travel_m)


def plan(mask: Mask, camera: CameraGeometry, oversampling: int, source: Source) -> Plan:
    """Return where the light of a source goes behind a mask."""
    wavelength_m, gap = source.wavelength_m, gap_strata(camera, source.wavelength_m)
    band = mask_band(mask, wavelength_m, sum(float(t) for t, _ in gap), oversampling)
    half_width = max(mask.shape) * mask.pitch_m / 2 + band.tail_m
    steepest = wavelength_m * (band.end + source.residual_band(half_width))
    # A smooth mask's corner frequencies carry light; a staircase's lie in the dark corners of two sincs.
    travel_m, limited = _travel(gap, source.carrier, steepest, corners=band.pixel_m == 0)
    return Plan(source, gap, band, travel_m, limited or band.end > band.full)


def mask_band(mask: Mask, wavelength_m: float, distance_m: float, oversampling: int) -> Band:
    """Return what is followed of a mask: the same light as with the pixel kernel, at any oversampling."""
    steepest = MAX_SINE / wavelength_m
    if mask.profile == "staircase":
        reach_m = kernel_reach_m(mask.pitch_m, wavelength_m, distance_m, oversampling)
        end = reach_m / math.hypot(reach_m, distance_m) / wavelength_m
        return Band(TAPER * end, end, mask.pitch_m)
    nyquist = 1 / (2 * mask.pitch_m)
    if oversampling == 1 and nyquist <= steepest:
        return Band(nyquist, nyquist, 0.0)
    # A finer grid holds waves that only the aperture's hard edge feeds.
    return Band(min(nyquist, TAPER * steepest), min(1.25 * nyquist, steepest), 0.0)


def exact_images(
    mask: Mask,
    camera: CameraGeometry,
    sources: Sequence[Source],
    size: int,
    *,
    oversampling: int = 1,
    threads: int = 1,
) -> Iterator[Array]:
    """Yield the PSF ``(size, size)`` of each source (one wavelength), in the stored frame (turned by 180 degrees).

    Each is the irradiance on the sensor's pixels per unit |U|^2 of the incident wave at the mask's centre, centred where
    the ray through that centre arrives.

    Args:
        mask: the mask; its arrays decide precision and kind.
        camera: distance or layers, binned pixel pitch.
        sources: point sources of one wavelength and direction.
        size: odd number of pixels.
        oversampling: multiplies the orders that are followed behind a staircase, the samples of a smooth mask.
        threads: NumPy only; they share one grid.
    """
    centres = (np.arange(size) - size // 2) * camera.pixel_pitch_m
    for wave in waves(mask, camera, sources, oversampling=oversampling, threads=threads):
        grid = wave.grid
        pixels = box_integral(grid.samples // 2, grid.pitch_m, centres, camera.pixel_pitch_m)
        real = wave.real
        bin_rows, bin_columns = pixels.prepared(real, grid.samples), pixels.prepared(real, grid.samples)
        xp = namespace(real)
        if is_torch(real):
            binned = bin_rows(bin_columns(wave.intensity(slice(None)), -1), -2)
        else:
            tall = np.empty((grid.samples, size), real.dtype)

            def narrow(part: slice, wave: Wave = wave, tall: np.ndarray = tall, bins: Callable = bin_columns) -> None:
                tall[part] = bins(wave.intensity(part), -1)

            in_threads(narrow, blocks(tall, grid.samples, grid.samples), threads)
            binned = bin_rows(tall, -2)
        yield xp.flip(binned / float(camera.pixel_pitch_m**2))


def exact_points(
    mask: Mask,
    camera: CameraGeometry,
    source: Source,
    count: int,
    rng: np.random.Generator,
    *,
    oversampling: int = 1,
    threads: int = 1,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return |U|^2 at random grid points of the mask's shadow; see ``psf.sampled_intensity``."""
    (wave,) = waves(mask, camera, [source], oversampling=oversampling, threads=threads)
    grid = wave.grid
    magnification = 1 + float(reduced_m(gap_strata(camera, source.wavelength_m))) / source.effective_m
    half = [n * mask.pitch_m / 2 * magnification / grid.pitch_m for n in mask.shape]
    rows, columns = (np.rint(rng.uniform(-h, h, count)).astype(np.int64) for h in half)
    values = wave.intensity(rows + grid.samples // 2)[np.arange(count), columns + grid.samples // 2]
    return np.stack([columns, rows], axis=1).astype(np.float64) * grid.pitch_m, values.astype(np.float64)


def exact_width_m(mask: Mask, camera: CameraGeometry, source: Source, oversampling: int) -> float:
    """Return the width (metres) of a source's PSF, with all the light that is followed."""
    return max(mask.shape) * mask.pitch_m + 2 * plan(mask, camera, oversampling, source).travel_m


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
    """Yield the wave of each source on the sensor; each is only good until the next is asked for."""
    plans = [plan(mask, camera, oversampling, source) for source in sources]
    steps = [math.ceil(math.log(p.grid(mask, oversampling).samples) / math.log(STEP)) for p in plans]
    factor = oversampling if mask.profile == "smooth" else 1
    done = 0
    for _, group in groupby(steps):
        together = plans[done : done + len(list(group))]
        done += len(together)
        largest = max(together, key=lambda p: p.grid(mask, oversampling).samples)
        first, grid = together[0], largest.grid(mask, oversampling)
        carrier = first.source.carrier
        transmission = mask.transmission(first.source.wavelength_m, factor, math.hypot(*carrier))
        fine = fine_transmission(transmission, grid, first.band, threads)
        transfer = _Propagation(grid, first.source.wavelength_m, carrier, first.gap, first.band, like=fine)
        memory = None
        for each in together:
            wave = transfer(fine, each, memory, threads)
            memory = None if is_torch(fine) else wave.spectrum
            yield wave


class _Propagation:
    """From the mask's window to half-transformed waves, for sources that share grid, wavelength and carrier."""

    def __init__(
        self, grid: FineGrid, wavelength_m: float, carrier: tuple[float, float], gap: Strata, band: Band, *, like: Array
    ) -> None:
        self._grid, self._gap, self._like = grid, gap, like
        self._even = carrier == (0.0, 0.0)
        shape = (grid.samples, grid.samples)
        self._transfer = (
            Transfer(shape, grid.pitch_m, wavelength_m, like=like)
            if self._even
            else TiltedTransfer(shape, grid.pitch_m, wavelength_m, carrier, like=like)
        )

    def __call__(self, fine: Array, plan: Plan, memory: Array | None, threads: int) -> Wave:
        reach = (plan.travel_m, plan.travel_m) if plan.limited else None
        if is_torch(fine):
            return Wave(self._grid, self._on_torch(fine, plan, reach))
        shape = (self._grid.samples, self._grid.samples)
        work = np.empty(shape, fine.dtype) if memory is None else memory
        self._rows(fine, plan.source, work, threads)
        self._columns(work, reach, threads)
        return Wave(self._grid, work)

    def _rows(self, fine: np.ndarray, source: Source, work: np.ndarray, threads: int) -> None:
        """Fill ``work`` with the row spectra of mask times incident wave."""
        grid, (rows, columns) = self._grid, self._grid.window
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
            in_threads(even, blocks(fine, half_y + 1, grid.samples), threads)
        else:
            in_threads(oblique, blocks(fine, 2 * half_y + 1, grid.samples), threads)

    def _columns(self, work: np.ndarray, reach: tuple[float, float] | None, threads: int) -> None:
        """Propagate the columns of ``work`` in place."""
        samples = self._grid.samples

        def filter_columns(part: slice, weights: np.ndarray) -> None:
            spectrum = fft(work[:, part], samples, 0)
            spectrum *= weights
            work[:, part] = ifft(spectrum, 0, overwrite=True)

        def even(part: slice) -> None:
            assert isinstance(self._transfer, Transfer)
            quadrant = self._transfer.quadrant(self._gap, reach, columns=part)
            weights = np.concatenate([quadrant, quadrant[-2:0:-1]], axis=0)
            filter_columns(part, weights)
            # Negative frequencies repeat all columns but zero and Nyquist.
            first, stop = max(part.start, 1), min(part.stop, samples // 2)
            if first < stop:
                mirrored = weights[:, first - part.start : stop - part.start][:, ::-1]
                filter_columns(slice(samples - stop + 1, samples - first + 1), mirrored)

        def oblique(part: slice) -> None:
            assert isinstance(self._transfer, TiltedTransfer)
            filter_columns(part, self._transfer.block(self._gap, reach, columns=part))

        if self._even:
            in_threads(even, blocks(work, samples // 2 + 1, samples, least=16), threads)
        else:
            in_threads(oblique, blocks(work, samples, samples, least=16), threads)

    def _on_torch(self, fine: Array, plan: Plan, reach: tuple[float, float] | None) -> Array:
        xp, grid = namespace(fine), self._grid
        y, x = (like(grid.positions_m(axis), fine, xp.float64) for axis in (0, 1))
        field = fine * plan.source.wave(y[:, None], x[None, :], real_dtype(fine))
        rows, columns = grid.window
        spectrum = fft2(pad2d(field, (grid.samples, grid.samples), (rows.start, columns.start)))
        if isinstance(self._transfer, Transfer):
            quadrant = self._transfer.quadrant(self._gap, reach)
            half = xp.concat([quadrant, xp.flip(quadrant[1:-1], axis=0)], axis=0)
            weights = xp.concat([half, xp.flip(half[:, 1:-1], axis=1)], axis=1)
        else:
            weights = self._transfer.block(self._gap, reach)
        return ifft(spectrum * weights, -2)


def _travel(gap: Strata, carrier: tuple[float, float], steepest: float, *, corners: bool) -> tuple[float, bool]:
    """Return how far (metres, per axis) light within ``steepest`` of the carrier travels beyond it, and if steeper is cut."""
    straight = _landing(gap, np.array(carrier))
    farthest, limited = 0.0, False
    other = (-steepest, steepest) if corners else (0.0,)
    for offset in [(a, b) for a in (-steepest, steepest) for b in other] + [
        (b, a) for a in (-steepest, steepest) for b in other
    ]:
        sine = np.array(carrier) + offset
        length = float(np.hypot(*sine))
        limit = MAX_SINE * min(index for _, index in gap)
        if length > limit:
            sine, limited = sine * (limit / length), True
        farthest = max(farthest, float(np.abs(_landing(gap, sine) - straight).max()))
    return farthest, limited or not corners


def _landing(gap: Strata, sine: np.ndarray) -> np.ndarray:
    """Return where (x, y; metres) a ray through the mask's centre meets the sensor."""
    total = np.zeros(2)
    for thickness_m, index in gap:
        total += float(thickness_m) * sine / math.sqrt(index**2 - float(sine @ sine))
    return total
