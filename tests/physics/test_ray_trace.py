"""The wave PSF in the limit of short waves is that of rays through the same height map."""

import math
from dataclasses import dataclass

import numpy as np
import pytest

from simulator.optics.mask import Mask
from simulator.optics.psf import PsfConfig, depth_images
from simulator.types import CameraGeometry, SpectralResponse

WAVELENGTH_M = 532e-9
GREEN = SpectralResponse(np.array([531e-9, 532e-9, 533e-9]), np.array([[0.0, 1.0, 0.0]]), ("Y",), "one line")


_R2 = (0.7548776662466927, 0.5698402909980532)  # 1 / g and 1 / g^2, g^3 = g + 1
_CHUNK = 2**18  # rays at a time


def geometric_psf(mask, distance_m, depth_m, pixel_pitch_m, size, *, rays_per_sample=4):
    """Return the PSF ``(size, size)`` of rays from an on-axis point, in the units and the frame of ``psf.depth_images``.

    Every ray stands for a small patch of the mask; it enters the flat side, is refracted where it leaves the surface, by
    the slope of the same cubic interpolation that the wave engine sees, and drops its power into the pixel that it hits.
    The thin element takes no part of the path inside it, just as the thin element of the wave optics.

    Sources: vector form of Snell's law, Glassner, An Introduction to Ray Tracing (1989), section 2.4; cubic convolution,
    Keys, IEEE Trans. ASSP 29, 1153 (1981); places of the rays, Roberts' R2 sequence (a two-dimensional golden ratio).
    """
    height, width = mask.shape
    across, total = width * rays_per_sample, height * width * rays_per_sample**2
    power = np.zeros(size * size)
    for start in range(0, total, _CHUNK):
        index = np.arange(start, min(start + _CHUNK, total), dtype=np.float64)
        ray_row = np.floor((index + 0.5) / across)
        row, column = (
            (ray + index * step % 1) / rays_per_sample - 0.5
            for ray, step in ((ray_row, _R2[0]), (index - ray_row * across, _R2[1]))
        )
        x, y, intensity = _trace(mask, distance_m, depth_m, row, column)
        pixel_x, pixel_y = (np.floor(part / pixel_pitch_m + 0.5) + size // 2 for part in (x, y))
        # A ray that is reflected inside (NaN) fails every comparison and is lost.
        inside = (pixel_x >= 0) & (pixel_x < size) & (pixel_y >= 0) & (pixel_y < size)
        at = (pixel_y[inside] * size + pixel_x[inside]).astype(np.intp)
        power += np.bincount(at, intensity[inside], size * size)
    return np.flip(power.reshape(size, size)) * (mask.pitch_m / rays_per_sample / pixel_pitch_m) ** 2


def _trace(mask, distance_m, depth_m, row, column):
    """Return where rays through places of the mask (in samples) land, x and y in metres, and their intensity."""
    height, width = mask.shape
    index = mask.material.index(WAVELENGTH_M)
    y, x = (row - (height - 1) / 2) * mask.pitch_m, (column - (width - 1) / 2) * mask.pitch_m
    first_row, first_column = np.floor(row), np.floor(column)
    weights_y, slopes_y = _keys(row - first_row)
    weights_x, slopes_x = _keys(column - first_column)
    slope_y = slope_x = amplitude = 0.0
    for i in range(4):
        at_row = np.clip(first_row + (i - 1), 0, height - 1).astype(np.intp)
        for j in range(4):
            at = at_row, np.clip(first_column + (j - 1), 0, width - 1).astype(np.intp)
            slope_y = slope_y + slopes_y[i] * weights_x[j] * mask.height_m[at] / mask.pitch_m
            slope_x = slope_x + weights_y[i] * slopes_x[j] * mask.height_m[at] / mask.pitch_m
            amplitude = amplitude + weights_y[i] * weights_x[j] * mask.amplitude[at]
    to_source = np.sqrt(x**2 + y**2 + depth_m**2)
    falloff = 1.0 if math.isinf(depth_m) else (depth_m / to_source) ** 2
    inside_x, inside_y = x / to_source / index, y / to_source / index
    inside_z = np.sqrt(1 - inside_x**2 - inside_y**2)
    # The surface w = h(x, y) along the light's way w; its normal points out of the material.
    length = np.sqrt(1 + slope_x**2 + slope_y**2)
    cosine = (inside_z - inside_x * slope_x - inside_y * slope_y) / length
    along = np.sqrt(1 - index**2 * (1 - cosine**2)) - index * cosine
    out_x = index * inside_x - along * slope_x / length
    out_y = index * inside_y - along * slope_y / length
    out_z = index * inside_z + along / length
    return x + distance_m * out_x / out_z, y + distance_m * out_y / out_z, amplitude**2 * falloff


def _keys(t):
    """Return the weights of four neighbours for the value and for its derivative at a fraction ``t`` of a sample."""
    t2 = t * t
    t3 = t2 * t
    values = [(-t3 + 2 * t2 - t) / 2, (3 * t3 - 5 * t2 + 2) / 2, (-3 * t3 + 4 * t2 + t) / 2, (t3 - t2) / 2]
    slopes = [(-3 * t2 + 4 * t - 1) / 2, (9 * t2 - 10 * t) / 2, (-9 * t2 + 8 * t + 1) / 2, (3 * t2 - 2 * t) / 2]
    return values, slopes


@dataclass(frozen=True)
class _Undispersed:
    """An index of 1.5 at every wavelength, so that rays stay the same while waves shrink."""

    name: str = "n = 1.5"
    source: str = "by definition"

    def index(self, wavelength_m):
        return 1.5


def _grid(samples, pitch_m):
    x = (np.arange(samples) - (samples - 1) / 2) * pitch_m
    return x[:, None], x[None, :]


def _random_surface(samples=160, pitch_m=1e-6):
    """Eight cosines of 40 um and more, slopes of 1 %, under a soft round aperture; symmetric in no way."""
    rng = np.random.default_rng(0)
    y, x = _grid(samples, pitch_m)
    height = sum(
        62.5e-9 * a * np.cos(2 * np.pi * 2.5e4 * (fy * y + fx * x) + 3 * p)
        for fy, fx, a, p in zip(*rng.uniform(-1, 1, (4, 8)), strict=True)
    )
    aperture = np.exp(-((np.hypot(y, x) / (0.4 * samples * pitch_m)) ** 8))
    return Mask(height, aperture, pitch_m, _Undispersed(), "smooth")


def _difference(mask, distance_m, depth_m, shrink, rays):
    """Relative L2 distance between the wave PSF at a shrunken wavelength and the rays' PSF, on pixels of 8 um."""
    camera = CameraGeometry(distance_m, 8e-6, GREEN)
    config = PsfConfig((depth_m,), wavelengths_per_channel=1, oversampling=max(1, shrink // 2))
    wave = next(iter(depth_images(mask, camera, config, WAVELENGTH_M / shrink, rays.shape[0])))
    return np.linalg.norm(wave - rays) / np.linalg.norm(wave)


@pytest.mark.slow
@pytest.mark.parametrize("depth_m", [pytest.param(math.inf, id="infinity"), pytest.param(0.02, id="2 cm")])
def test_waves_become_rays_with_the_square_of_the_wavelength(depth_m):
    """Before the first caustic the wave's intensity differs from the rays' by O(lambda^2) (Luneburg-Kline series).

    Wavelengths of 532, 266, 133 nm: each halving must divide the difference by four, order 1.7 to 2.1; the rays' own
    graininess and the lengthening of steep rays leave 3e-4. A ray traced with the wrong sign would differ by 1.
    """
    mask, d = _random_surface(), 0.4e-3
    rays = geometric_psf(mask, d, depth_m, 8e-6, 45, rays_per_sample=16)
    differences = [_difference(mask, d, depth_m, shrink, rays) for shrink in (1, 2, 4)]
    orders = np.log2(np.array(differences[:-1]) / differences[1:])
    assert differences[-1] < 4e-3
    assert np.all((orders > 1.7) & (orders < 2.1)), f"orders {orders} of {differences}"


@pytest.mark.slow
def test_waves_become_rays_behind_caustics_too():
    """Behind caustics fringes stay, ever finer; blurred to the pixel, they fade at about the first order."""
    mask, d = _random_surface(), 2e-3
    rays = geometric_psf(mask, d, math.inf, 8e-6, 45, rays_per_sample=16)
    differences = [_difference(mask, d, math.inf, shrink, rays) for shrink in (1, 4, 16)]
    assert differences[0] > 3 * differences[1] > 6 * differences[2]
