"""PSFs by scaling: many depths from one mask transform per wavelength.

On-axis light from depth z is the paraxial identity I_z(x) = m^-2 I_deff(x / m), m = 1 + d/z, d_eff = z d / (z + d):
a plane wave propagated to the shorter distance and magnified (Goodman, Introduction to Fourier Optics, section 5.3).
Magnified pixels are integrated exactly, by dividing them by m instead of stretching the field.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import (
    Array,
    bytes_per_sample,
    fft2,
    ifft,
    is_torch,
    namespace,
    next_fast_len,
    number,
    pad2d,
    require_memory,
)
from simulator.optics.kernel import ORDERS, PixelKernel, kernel_reach_m
from simulator.optics.mask import Mask, followed_frequency
from simulator.optics.propagation import (
    Quadrant,
    Strata,
    Transfer,
    band_edge_m,
    blocks,
    each_rows,
    gap_strata,
    holds_steep_waves,
    reduced_m,
    scaled,
    spread_samples,
)
from simulator.optics.resample import Band, MovingBoxes, box_integral
from simulator.optics.sources import Source
from simulator.types import CameraGeometry


class ScaledModel:
    """One mask, camera and wavelength: the mask's transform, from which the light of any depth follows."""

    def __init__(
        self, mask: Mask, camera: CameraGeometry, wavelength_m: float, oversampling: int, *, threads: int = 1
    ) -> None:
        """Transform the mask.

        Raises:
            InputError: when the grid for mask and light would not fit into memory.
        """
        self._gap = gap_strata(camera, wavelength_m)
        self._pitch_m = float(mask.pitch_m / oversampling)
        window = [n * oversampling for n in mask.shape]
        reach_m, limited = _reach(mask, self._gap, wavelength_m, oversampling)
        margin = math.ceil(reach_m / self._pitch_m)
        self._band = (margin * self._pitch_m, margin * self._pitch_m) if limited else None
        padded = tuple(2 * next_fast_len(n // 2 + margin + 1) for n in window)
        cure = "use a coarser or narrower mask or less oversampling"
        # The spectrum, a wave per thread, and the transfer function's and the blocks' share.
        require_memory("oversampling", padded, 1.5 + threads, bytes_per_sample(mask.height_m), cure)
        field = pad2d(mask.transmission(wavelength_m, oversampling), padded, (margin, margin))
        self._spectrum = fft2(field, overwrite=True)
        self._origin = [margin + (n - 1) / 2 for n in window]
        kernel = PixelKernel(padded, self._pitch_m, wavelength_m, reach_m, like=self._spectrum)
        transfer = Transfer(padded, self._pitch_m, wavelength_m, like=self._spectrum)
        self._staircase, self._kernel, self._transfer = mask.profile == "staircase", kernel, transfer
        self._spare: list[Array] = []  # fresh memory for every depth would cost as much as a tenth of the work

    def magnification(self, source: Source) -> Any:
        """Return m = 1 + d / z; a torch scalar where the camera's distance is one."""
        return 1 + reduced_m(self._gap) / source.effective_m

    def wave(self, source: Source, *, diffracted: bool = True) -> Array:
        """Return the light before magnification, half-way: columns are still spectra; ``release`` it when done."""
        strata = scaled(self._gap, 1 / self.magnification(source)) if diffracted else self._gap
        smooth = partial(self._transfer.quadrant, strata, self._band)
        quadrant: Quadrant = self._kernel.quadrant(strata) if self._staircase else smooth
        spectrum = self._spectrum
        wave = self._spare.pop() if self._spare else namespace(spectrum).empty_like(spectrum)

        def filter_rows(part: slice, weights: Array) -> None:
            wave[part] = ifft(spectrum[part] * weights, -1, overwrite=True)

        each_rows(spectrum, spectrum.shape, quadrant, filter_rows)
        return wave

    def image(self, wave: Array, magnification: Any, centres_m: np.ndarray, pixel_m: float) -> Array:
        """Return the irradiance of a wave on magnified pixels, ``(J, J)``, in the physical frame."""
        centres: Any = centres_m
        if is_torch(magnification):
            centres = magnification.new_tensor(centres_m)
        boxes = (
            box_integral(at, self._pitch_m, centres / magnification, pixel_m / magnification) for at in self._origin
        )
        return _on_pixels(wave, *boxes) / float(pixel_m**2)

    def draw(
        self, axis: int, length: int, count: int, rng: np.random.Generator
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return random samples of the mask's ``length`` along an axis, and their coordinates, metres."""
        index = math.ceil(self._origin[axis] - (length - 1) / 2) + rng.integers(0, length, count)
        return index, (index.astype(np.float64) - self._origin[axis]) * self._pitch_m

    def release(self, wave: Array) -> None:
        """Give a wave's memory back; a tensor may still want its gradient."""
        if not is_torch(wave):
            self._spare.append(wave)


def scaled_images(
    mask: Mask,
    camera: CameraGeometry,
    sources: Sequence[Source],
    size: int,
    *,
    oversampling: int = 1,
    diffracted: bool = True,
    threads: int = 1,
) -> Iterator[Array]:
    """Yield the PSF ``(size, size)`` of each on-axis source (one wavelength), in the stored frame (rotated by 180 degrees).

    Arguments as in `simulator.optics.exact.exact_images`; ``diffracted`` says whether the diffraction distance changes with
    the depth (if not, the PSF of infinity is magnified), and each of the ``threads`` needs one more complex grid.
    """
    model = ScaledModel(mask, camera, sources[0].wavelength_m, oversampling, threads=threads)
    centres = (np.arange(size) - size // 2) * camera.pixel_pitch_m

    def image(source: Source) -> Array:
        wave = model.wave(source, diffracted=diffracted)
        psf = model.image(wave, model.magnification(source), centres, camera.pixel_pitch_m)
        model.release(wave)
        return namespace(psf).flip(psf)

    if threads == 1 or is_torch(mask.height_m):
        yield from map(image, sources)
        return
    with ThreadPoolExecutor(threads) as pool:
        yield from pool.map(image, sources)


def scaled_points(
    mask: Mask,
    camera: CameraGeometry,
    source: Source,
    count: int,
    rng: np.random.Generator,
    *,
    oversampling: int = 1,
    diffracted: bool = True,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return |U|^2 at random grid points of the mask's shadow; see ``psf.sampled_intensity``."""
    model = ScaledModel(mask, camera, source.wavelength_m, oversampling)
    magnification = number(model.magnification(source))
    (rows, y_m), (columns, x_m) = (model.draw(axis, n * oversampling, count, rng) for axis, n in enumerate(mask.shape))
    field = ifft(model.wave(source, diffracted=diffracted)[:, columns], -2)[rows, np.arange(count)]
    points = np.stack([x_m, y_m], axis=1) * magnification
    return points, np.abs(field).astype(np.float64) ** 2 / magnification**2


def scaled_width_m(mask: Mask, camera: CameraGeometry, source: Source, oversampling: int) -> float:
    """Return the width (metres) of a source's PSF, with all the light that is followed."""
    gap = gap_strata(camera, source.wavelength_m)
    reach_m, _ = _reach(mask, gap, source.wavelength_m, oversampling)
    return (max(mask.shape) * mask.pitch_m + 2 * reach_m) * number(1 + reduced_m(gap) / source.effective_m)


def _reach(mask: Mask, gap: Strata, wavelength_m: float, oversampling: int) -> tuple[float, bool]:
    """Return how far sideways (metres) the mask's light is followed to the sensor, and whether steeper light must be cut.

    A smooth mask's light lies in the band of its own samples. A finer grid holds steeper waves too, which only the
    aperture's hard edge feeds: they are cut softly, or every doubling of the oversampling would widen the grid.
    """
    d = number(reduced_m(gap))
    if mask.profile == "staircase":
        return kernel_reach_m(mask.pitch_m, wavelength_m, d, ORDERS, oversampling), False
    pitch_m = 1 / (2 * followed_frequency(mask, wavelength_m, oversampling))
    spread_m = spread_samples(pitch_m, wavelength_m, d) * pitch_m
    limited = oversampling > 1 or holds_steep_waves(pitch_m, wavelength_m)
    return spread_m + (band_edge_m(wavelength_m, d) if limited else 0), limited


def _on_pixels(wave: Array, rows: Band | MovingBoxes, columns: Band | MovingBoxes) -> Array:
    """Return the intensity of a half-transformed wave, integrated over boxes."""
    xp = namespace(wave)
    height, width = wave.shape
    real = xp.real(wave)
    bin_rows, bin_columns = rows.prepared(real, height), columns.prepared(real, width)
    strips = []
    for part in blocks(wave, width, height):
        field = ifft(wave[:, part], -2)
        strips.append(bin_rows(xp.real(field) ** 2 + xp.imag(field) ** 2, -2))
    tall = xp.concat(strips, axis=-1)
    # Blocks again: for one large product BLAS would wake threads of its own.
    return xp.concat([bin_columns(tall[part], -1) for part in blocks(wave, tall.shape[0], width)], axis=0)
