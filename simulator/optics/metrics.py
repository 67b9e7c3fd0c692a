"""Numbers that judge a PSF: autocorrelation and MTF, depths told apart, light that misses the sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import fft, ifft, irfft, next_fast_len, rfft, to_numpy
from simulator.errors import InputError
from simulator.optics.stack import PsfStack

_RAYS, _STEPS_PER_PIXEL = 64, 4


# ---- sharpness: autocorrelation and MTF


def autocorrelation(image: NDArray[np.floating]) -> NDArray[np.float64]:
    """Return the linear (not circular) autocorrelation of an image, divided by its value at zero shift.

    A(s) = sum_x I(x) I(x + s) / sum_x I(x)^2: how far the PSF tells a shifted copy from itself. The mean is not removed.

    Args:
        image: ``(H, W)``, finite and not zero everywhere.

    Returns:
        ``(2 H - 1, 2 W - 1)``, 1 at its centre ``(H - 1, W - 1)``, which is zero shift.

    Raises:
        InputError: for another shape, NaN, or an image of zeros.

    Example:
        >>> autocorrelation(np.array([[1.0, 1.0]])).round(12).tolist()
        [[0.5, 1.0, 0.5]]
    """
    light = _checked(image)
    rows, columns = light.shape
    lengths = next_fast_len(2 * rows - 1), next_fast_len(2 * columns - 1)
    spectrum = fft(rfft(light, lengths[1], -1), lengths[0], -2)
    shifts = irfft(ifft(np.abs(spectrum) ** 2, -2), lengths[1], -1)
    shifts = np.roll(shifts, (rows - 1, columns - 1), (0, 1))[: 2 * rows - 1, : 2 * columns - 1]
    return shifts / np.sum(light**2)


@dataclass(frozen=True)
class Peak:
    """The central peak of an autocorrelation.

    Attributes:
        width_m: full width at half maximum, metres: the diameter of the disc with the area inside which the autocorrelation
            A stays above one half along every ray from zero shift.
        sidelobe: the highest A at shifts of at least ``width_m``: what the PSF confuses with a point elsewhere.
    """

    width_m: float
    sidelobe: float


def autocorrelation_peak(image: NDArray[np.floating], pitch_m: float) -> Peak:
    """Return width and highest sidelobe of a PSF's autocorrelation A(s) = sum_x I(x) I(x + s) / sum_x I(x)^2.

    Between samples A is interpolated linearly. The mean is not removed: a PSF's pedestal is a sidelobe, because light
    that is everywhere tells nothing. A Gaussian of standard deviation s has the width 4 sqrt(ln 2) s and the sidelobe 1/16.

    Args:
        image: PSF ``(H, W)``, finite and not zero everywhere.
        pitch_m: pixel pitch, metres.
    """
    from scipy.ndimage import map_coordinates

    peak = autocorrelation(image)
    middle = [n // 2 for n in peak.shape]
    angles = np.arange(_RAYS) * np.pi / _RAYS  # A(-s) = A(s): half a turn is enough
    radii = np.arange(1 + _STEPS_PER_PIXEL * (max(middle) + 1)) / _STEPS_PER_PIXEL
    at = [m + np.outer(direction, radii) for m, direction in zip(middle, (np.sin(angles), np.cos(angles)), strict=True)]
    along = map_coordinates(peak, at, order=1)  # zero beyond the last shift, so every ray falls below one half
    first = np.argmax(along < 0.5, axis=1)
    ray = np.arange(_RAYS)
    above, below = along[ray, first - 1], along[ray, first]
    half = radii[first] - (0.5 - below) / (above - below) / _STEPS_PER_PIXEL
    width = 2 * np.sqrt(np.mean(half**2))
    rows, columns = (np.arange(n) - m for n, m in zip(peak.shape, middle, strict=True))
    beyond = rows[:, None] ** 2 + columns[None, :] ** 2 >= width**2
    return Peak(float(width * pitch_m), float(peak[beyond].max(initial=0.0)))


def radial_mtf(image: NDArray[np.floating], pitch_m: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the modulation transfer function, averaged over rings of spatial frequency, from zero to Nyquist.

    MTF(f) = |F[I](f)| / F[I](0). Rings are as wide as the longer side's frequency step; each is reported at the mean
    frequency of its members, so a smooth MTF is averaged without a bias of first order.

    Args:
        image: PSF ``(H, W)``, finite, with a positive sum.
        pitch_m: pixel pitch, metres.

    Returns:
        ``(N,)`` frequencies in cycles per metre and ``(N,)`` values, 1 at frequency zero; N = max(H, W) // 2 + 1.
    """
    light = _checked(image)
    if not light.sum() > 0:
        raise InputError("image", f"its sum is {light.sum():g}, but a PSF's is positive: remove less background")
    _check_positive("pitch_m", pitch_m)
    longest = max(light.shape)
    modulus = np.abs(np.fft.rfft2(light)) / light.sum()
    fy, fx = np.fft.fftfreq(light.shape[0])[:, None], np.fft.rfftfreq(light.shape[1])[None, :]
    frequency = np.hypot(fy, fx)
    # rfft2 leaves out the negative half of the columns: those that have a mirror image count twice.
    columns = np.arange(fx.size)
    twice = np.where((columns > 0) & (2 * columns < light.shape[1]), 2.0, 1.0)
    weight = np.broadcast_to(twice, frequency.shape)
    ring = np.rint(frequency * longest).astype(np.int64)
    kept = ring <= longest // 2
    count, total_f, total_m = (
        np.bincount(ring[kept], weight[kept] * part[kept]) for part in (np.ones_like(frequency), frequency, modulus)
    )
    return total_f / count / pitch_m, total_m / count


def mean_mtf(image: NDArray[np.floating], pitch_m: float) -> float:
    """Return the mean over frequencies, from zero to Nyquist, of the radially averaged MTF: 1 for a single bright pixel.

    Example:
        >>> mean_mtf(np.eye(1), 1e-5), mean_mtf(np.array([[0.0, 0, 0], [0, 2, 0], [0, 0, 0]]), 1e-5)
        (1.0, 1.0)
    """
    frequency, mtf = radial_mtf(image, pitch_m)
    if len(frequency) == 1:
        return float(mtf[0])
    return float(np.trapezoid(mtf, frequency) / frequency[-1])


# ---- depths told apart


def depth_limit_m(aperture_m: float, mask_to_sensor_m: float, pitch_m: float) -> float:
    """Return z_max, the depth beyond which the PSF no longer changes by a pixel: z_max = a d / (2 p).

    Light from depth z reaches the rim of the PSF a d / (2 z) farther out than light from infinity.

    Args:
        aperture_m: width of the mask, metres.
        mask_to_sensor_m: mask to sensor, metres.
        pitch_m: (binned) pixel pitch, metres.

    Example:
        >>> round(depth_limit_m(7e-3, 1.9e-3, 19.2e-6), 2)
        0.35
    """
    for name, value in (("aperture_m", aperture_m), ("mask_to_sensor_m", mask_to_sensor_m), ("pitch_m", pitch_m)):
        _check_positive(name, value)
    return aperture_m * mask_to_sensor_m / (2 * pitch_m)


def depth_correlations(stack: PsfStack) -> NDArray[np.float64]:
    """Return how alike the PSFs of every two depths are: C_ij = <H_i, H_j> / (||H_i|| ||H_j||), over channels and pixels.

    The mean is not removed, so the empty rim of the grid does not count.

    Returns:
        ``(K, K)``, symmetric, 1 on the diagonal, 0 for PSFs that share no lit pixel.
    """
    planes = to_numpy(stack.values).reshape(len(stack.depths_m), -1).astype(np.float64)
    planes /= np.linalg.norm(planes, axis=1, keepdims=True)  # a stack refuses planes that are zero everywhere
    return np.clip(planes @ planes.T, 0, 1)


def distinct_depths(correlations: NDArray[np.float64], depths_m: NDArray[np.float64]) -> float:
    """Return the effective number of depths that PSFs tell apart: 1 / mean of C(u, v)^2 over all pairs of disparities.

    It is the participation ratio (tr C)^2 / tr(C^2) of the eigenvalues of the correlations over a continuous range of
    disparity: 1 when all PSFs are alike, the more the fewer overlap. C^2 is interpolated linearly on triangles whose long
    sides run along its crest u = v. Where neighbouring planes correlate by 0.6 or more, that errs by less than a tenth,
    whether correlations fall like a Gaussian or an exponential; where they hardly correlate, K planes are too few to tell.

    Args:
        correlations: ``(K, K)`` of :func:`depth_correlations`.
        depths_m: ``(K,)`` metres, increasing.

    Example:
        >>> round(distinct_depths(np.ones((3, 3)), np.array([0.05, 0.1, np.inf])), 6)
        1.0
    """
    if len(depths_m) == 1:
        return 1.0
    steps = -np.diff(1 / np.asarray(depths_m, np.float64))
    areas, squares = np.outer(steps, steps), correlations**2
    along, across = squares[:-1, :-1] + squares[1:, 1:], squares[1:, :-1] + squares[:-1, 1:]
    return float(areas.sum() / np.sum(areas * (along / 3 + across / 6)))


# ---- light on the sensor


def light_off_sensor(
    stack: PsfStack, sensor_shape: tuple[int, int], scene_shape: tuple[int, int]
) -> NDArray[np.float64]:
    """Return the share of a PSF's light that misses the sensor, averaged over all scene pixels.

    A PSF sample at displacement s lands on the sensor for a share g(s) of the scene's rows (and of its columns), so the
    mean over scene pixels is one weighted sum of the PSF: exact, whatever the sizes.

    Args:
        stack: PSFs, ``(K, C, rows, columns)``.
        sensor_shape: H, W of the (binned) sensor.
        scene_shape: h, w of the scene, each of the sensor's parity and not larger.

    Returns:
        ``(K, C)``, 0 when everything is caught. The light that is outside the stack's grid is not in it.
    """
    values = to_numpy(stack.values).astype(np.float64, copy=False)
    rows, columns = (
        _share_caught(size, sensor, scene)
        for size, sensor, scene in zip(values.shape[-2:], sensor_shape, scene_shape, strict=True)
    )
    caught = (values @ columns) @ rows
    total = values.sum(axis=-1).sum(axis=-1)
    return np.clip(1 - caught / total, 0, 1)  # rounding may leave -1e-16


def _share_caught(size: int, sensor: int, scene: int) -> NDArray[np.float64]:
    """Return, for every PSF sample along an axis, the share of scene pixels whose light it puts on the sensor."""
    if not 0 < scene <= sensor or (sensor - scene) % 2:
        raise InputError(
            "scene_shape", f"got {scene} for {sensor} of the sensor, expected at most as many, even or odd like them"
        )
    nearest = np.arange(size) - size // 2 + (sensor - scene) // 2  # where scene pixel 0 puts it
    first, last = np.maximum(nearest, 0), np.minimum(nearest + scene - 1, sensor - 1)
    return np.clip(last - first + 1, 0, None) / scene


# ---- checks of arguments


def _checked(image: NDArray[np.floating]) -> NDArray[np.float64]:
    light = np.asarray(image, np.float64)
    if light.ndim != 2 or 0 in light.shape or not np.all(np.isfinite(light)) or not np.any(light):
        raise InputError("image", f"expected finite (H, W), not zero everywhere, got {light.dtype} {light.shape}")
    return light


def _check_positive(name: str, value: float) -> None:
    if not 0 < value < np.inf:
        raise InputError(name, f"got {value!r}, expected positive metres")
