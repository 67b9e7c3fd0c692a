"""PSFs without a paraxial step: the point source's own wave on the mask, the angular spectrum from there.

Nothing is scaled: the incident wave is spherical (or plane), oblique sources have their carrier and its sideways travel
taken out analytically, and the grid is as fine as mask and wave together need. Between mask and sensor light crosses the
camera's layers. The one approximation left beside the thin mask is the band: a staircase's light is followed up to
``orders`` diffraction orders of its pixel.

Sources: Goodman, Introduction to Fourier Optics, section 3.10; shifted angular spectrum: Matsushima, Opt. Express 18,
18453 (2010); on-axis illumination (z / r) exp(i k (r - z)).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import Array, is_torch, namespace, number
from simulator.optics.even_filter import blocks, in_threads
from simulator.optics.exact_plan import offset_m, plan
from simulator.optics.exact_wave import LEAST, Wave, waves
from simulator.optics.illumination import Source
from simulator.optics.layers import gap_strata, reduced_m
from simulator.optics.mask import Mask
from simulator.optics.resample import box_integral
from simulator.types import CameraGeometry


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

    Each is the irradiance on the sensor's pixels per unit |U|^2 of the incident wave at the mask's centre. Its middle is the
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
    light = waves(mask, camera, sources, oversampling=oversampling, threads=threads)
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
