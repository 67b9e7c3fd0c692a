"""PSFs without a paraxial step: the point source's own wave on the mask, the angular spectrum from there.

From top to bottom: images on the sensor's pixels, the waves behind them, and the grids that these need.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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
    number,
    pad2d,
    real_dtype,
    require_memory,
)
from simulator.optics.fine_mask import TAPER, Band, FineGrid, fine_grid, fine_transmission
from simulator.optics.kernel import kernel_reach_m
from simulator.optics.mask import Mask, followed_frequency
from simulator.optics.propagation import (
    MAX_SINE,
    Strata,
    TiltedTransfer,
    Transfer,
    band_edge_m,
    blocks,
    gap_strata,
    in_threads,
    reduced_m,
    whole_even,
)
from simulator.optics.resample import box_integral
from simulator.optics.sources import Source
from simulator.types import CameraGeometry

# As kernel.ORDERS. More orders need a finer grid here, and the pixel's sinc vanishes at one: 1.2 would take half as long
# again for 0.4 % more of a PhlatCam's light.
ORDERS = 1.0
LEAST = 16  # rows or columns at a time: measured, 8 and 64 are a quarter slower
FINE_MASK = 0.4  # what sampling the mask finely costs, in waves on the same grid


# ---- images


def exact_images(
    mask: Mask, camera: CameraGeometry, sources: Sequence[Source], size: int, *, oversampling: int = 1, threads: int = 1
) -> Iterator[Array]:
    """Yield the PSF ``(size, size)`` of each source (one wavelength), in the stored frame (rotated by 180 degrees).

    Each is the irradiance on the sensor's pixels per unit irradiance of the incident wave on the mask's plane, at its centre:
    off the axis |U|^2 cos(theta_out) / cos(theta_in). On it |U|^2 stands for irradiance, as in all other models, so that the
    PSF's sum is the transmitted area; the cosines of 1.5 diffraction orders of 2 um are above 0.92. Its middle is the
    sensor's point (-x d, -y d) for a source in the direction (x, y) and the camera's distance d in air, where a convolution
    puts it: without layers that is where the ray through the mask's centre arrives.

    Args:
        mask: the mask; its arrays decide precision and kind.
        camera: distance or layers, binned pixel pitch.
        sources: point sources of one wavelength and direction.
        size: odd number of pixels.
        oversampling: multiplies the orders that are followed behind a staircase, the samples of a smooth mask.
        threads: NumPy only; they share one grid.
    """
    centres = (np.arange(size) - size // 2) * camera.pixel_pitch_m
    light = waves(mask, camera, sources, oversampling=oversampling, threads=threads, irradiance=True)
    for source, wave in zip(sources, light, strict=True):
        grid, real = wave.grid, wave.real
        bin_columns, bin_rows = (
            box_integral(grid.samples // 2, grid.pitch_m, centres + offset, camera.pixel_pitch_m).prepared(
                real, grid.samples
            )
            for offset in offset_m(camera, source)
        )
        xp = namespace(real)
        if is_torch(real):
            binned = bin_rows(bin_columns(wave.intensity(slice(None)), -1), -2)
        else:
            tall = np.empty((grid.samples, size), real.dtype)

            def narrow(part: slice, wave: Wave = wave, tall: np.ndarray = tall, bins: Callable = bin_columns) -> None:
                tall[part] = bins(wave.intensity(part), -1)

            in_threads(narrow, blocks(tall, grid.samples, grid.samples, LEAST), threads)
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
    magnification = 1 + number(reduced_m(gap_strata(camera, source.wavelength_m))) / source.effective_m
    half = [n * mask.pitch_m / 2 * magnification / grid.pitch_m for n in mask.shape]
    rows, columns = (np.rint(rng.uniform(-h, h, count)).astype(np.int64) for h in half)
    values = wave.intensity(rows + grid.samples // 2)[np.arange(count), columns + grid.samples // 2]
    return np.stack([columns, rows], axis=1).astype(np.float64) * grid.pitch_m, values.astype(np.float64)


def exact_width_m(mask: Mask, camera: CameraGeometry, source: Source, oversampling: int) -> float:
    """Return the width (metres) of a source's PSF, with all the light that is followed."""
    return max(mask.shape) * mask.pitch_m + 2 * plan(mask, camera, oversampling, source).travel_m


# ---- waves on the sensor


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
    mask: Mask,
    camera: CameraGeometry,
    sources: Sequence[Source],
    *,
    oversampling: int = 1,
    threads: int = 1,
    irradiance: bool = False,
) -> Iterator[Wave]:
    """Yield the wave of each source on the sensor; each is only good until the next is asked for.

    Arguments as for ``exact_images``; a grid that would not fit into memory is refused. With ``irradiance`` oblique waves
    are weighted so that |U|^2 is irradiance per irradiance; without it U is the field.
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
        light = _Light(mask, plans[widest], grids[widest], oversampling, several, irradiance, threads)
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
        self,
        mask: Mask,
        plan: Plan,
        grid: FineGrid,
        oversampling: int,
        keep_transfer: bool,
        irradiance: bool,
        threads: int,
    ) -> None:
        source, factor = plan.source, oversampling if mask.profile == "smooth" else 1
        transmission = mask.transmission(source.wavelength_m, factor, math.hypot(*source.carrier))
        self.grid, self._threads = grid, threads
        self._fine = fine_transmission(transmission, grid, plan.band, threads)
        shape, self._even = (grid.samples, grid.samples), source.on_axis
        reach = (plan.travel_m, plan.travel_m) if plan.limited else None
        # Columns of the transfer function: of its quadrant, where it is even.
        self._transfer: Callable[[slice], Array]
        if not self._even:
            tilted = TiltedTransfer(shape, grid.pitch_m, source.wavelength_m, source.carrier, like=self._fine)

            def oblique(columns: slice) -> Array:
                transfer = tilted.block(plan.gap, reach, columns=columns)
                return transfer * tilted.obliquity(plan.gap, columns) if irradiance else transfer

            self._transfer = oblique
            return
        even = Transfer(shape, grid.pitch_m, source.wavelength_m, like=self._fine)
        self._transfer = lambda columns: even.quadrant(plan.gap, reach, columns=columns)
        if keep_transfer and not is_torch(self._fine):
            kept = np.empty((grid.samples // 2 + 1,) * 2, self._fine.dtype)

            def keep(columns: slice) -> None:
                kept[:, columns] = even.quadrant(plan.gap, reach, columns=columns)

            in_threads(keep, blocks(self._fine, len(kept), len(kept)), threads)
            self._transfer = lambda columns: kept[:, columns]

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
        weights = self._transfer(slice(None))
        return ifft(spectrum * (whole_even(weights) if self._even else weights), -2)

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
            quadrant = self._transfer(part)
            weights = np.concatenate([quadrant, quadrant[-2:0:-1]], axis=0)
            filter_columns(part, weights)
            # Negative frequencies repeat all columns but zero and Nyquist.
            first, stop = max(part.start, 1), min(part.stop, samples // 2)
            if first < stop:
                mirrored = weights[:, first - part.start : stop - part.start][:, ::-1]
                filter_columns(slice(samples - stop + 1, samples - first + 1), mirrored)

        def oblique(part: slice) -> None:
            filter_columns(part, self._transfer(part))

        if self._even:
            in_threads(even, blocks(work, samples // 2 + 1, samples, LEAST), self._threads)
        else:
            in_threads(oblique, blocks(work, samples, samples, LEAST), self._threads)


# ---- where light goes


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
    band = mask_band(mask, wavelength_m, sum(number(t) for t, _ in gap), oversampling)
    half_width = max(mask.shape) * mask.pitch_m / 2 + band.tail_m
    steepest = wavelength_m * (band.end + source.residual_band(half_width))
    # A smooth mask's corner frequencies carry light; a staircase's lie in the dark corners of two sincs.
    travel_m, limited = _travel(gap, source.carrier, steepest, corners=band.pixel_m == 0)
    if limited or band.end > band.full:
        # The cut fades over this width inwards: it begins where the light that is followed ends.
        edge_m = band_edge_m(wavelength_m, sum(number(t) for t, _ in gap))
        return Plan(source, gap, band, travel_m + edge_m, True)
    return Plan(source, gap, band, travel_m, False)


def mask_band(mask: Mask, wavelength_m: float, distance_m: float, oversampling: int) -> Band:
    """Return what is followed of a mask: so many diffraction orders of a staircase, a smooth mask's own band."""
    steepest = MAX_SINE / wavelength_m
    if mask.profile == "staircase":
        reach_m = kernel_reach_m(mask.pitch_m, wavelength_m, distance_m, ORDERS, oversampling)
        end = reach_m / math.hypot(reach_m, distance_m) / wavelength_m
        return Band(TAPER * end, end, mask.pitch_m)
    own = followed_frequency(mask, wavelength_m, oversampling)
    if oversampling == 1 and own <= steepest:
        return Band(own, own, 0.0)
    finer = oversampling / (2 * mask.pitch_m)
    return Band(min(own, TAPER * steepest), min(1.25 * own, steepest, finer), 0.0)


def offset_m(camera: CameraGeometry, source: Source) -> tuple[float, float]:
    """Return where (x, y; metres) a convolution puts a PSF's centre, seen from where the ray through the mask's centre lands.

    A convolution knows one distance in air; behind glass, oblique rays land elsewhere.
    """
    placed = -np.array(source.direction) * number(camera.mask_to_sensor_m)
    x, y = placed - _landing(gap_strata(camera, source.wavelength_m), np.array(source.carrier))
    return float(x), float(y)


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
        total += number(thickness_m) * sine / math.sqrt(index**2 - float(sine @ sine))
    return total
