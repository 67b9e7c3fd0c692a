"""Sensor noise: which kinds there are, and the plain steps that `Sensor.expose` puts in the order of the physics."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from simulator.arrays import Array, namespace, normal, number, poisson
from simulator.errors import InputError
from simulator.settings import Range, Settings

_CERTAIN = 6.0  # standard deviations beyond which no pixel lies
_DRAWN = 2**20  # pixels at a time
_SURELY_FULL = 1e6
"""Times the full well beyond which nothing changes, where Poisson numbers still fit 64 bits."""


@dataclass(frozen=True)
class NoNoise(Settings):
    """The perfect sensor: the signal itself, neither clipped nor quantised."""

    type: Literal["none"] = field(default="none", repr=False)


@dataclass(frozen=True)
class GaussianNoise(Settings):
    """White Gaussian noise, as the literature's simulations add it; black level zero, the same in all channels.

    Attributes:
        std: standard deviation, share of full scale; or
        psnr_db: PSNR of the measurement against the noiseless one, 20 log10(peak / std), dB. Exactly one of the two is given.
        peak: ``sample``: the maximum of this sample's noiseless measurement over all channels; ``full_scale``: 1.
        clip: whether to clip to the converter's range, 0 to (2^bits - 1) / 2^bits.
        quantise: whether to round to the sensor's digital numbers.
    """

    std: Annotated[float, Range(1e-9, 1)] | None = None
    psnr_db: Annotated[float, Range(0, 120, "dB")] | None = None
    peak: Literal["sample", "full_scale"] = "sample"
    clip: bool = False
    quantise: bool = False
    type: Literal["gaussian"] = field(default="gaussian", repr=False)

    def __post_init__(self) -> None:
        if (self.std is None) == (self.psnr_db is None):
            key, came = ("", "neither") if self.std is None else ("std", "both")
            raise InputError(key, f"expected exactly one of psnr_db and std, got {came}: both set the deviation")

    def standard_deviation(self, signal: Array) -> float:
        """Return the standard deviation for this noiseless signal, as a share of full scale."""
        if self.std is not None:
            return self.std
        assert self.psnr_db is not None
        peak = number(namespace(signal).max(signal)) if self.peak == "sample" else 1.0
        return peak * 10 ** (-self.psnr_db / 20)


@dataclass(frozen=True)
class PhysicalNoise(Settings):
    """Photons, dark current, pixel and row errors, read noise and quantisation of the sensor: see `Sensor.expose`."""

    type: Literal["physical"] = field(default="physical", repr=False)


Noise = NoNoise | GaussianNoise | PhysicalNoise


def add_gaussian(signal: Array, noise: GaussianNoise, bit_depth: int, rng: Any) -> Array:
    """Return the signal (share of full scale) with Gaussian noise, clipped and rounded to DN as the noise asks."""
    xp = namespace(signal)
    noisy = signal + noise.standard_deviation(signal) * normal(rng, signal)
    if noise.clip:
        noisy = xp.clip(noisy, 0, 1 - 2**-bit_depth)
    if noise.quantise:
        noisy = xp.round(noisy * 2**bit_depth) / 2**bit_depth
    return noisy


def photo_electrons(mean: Array, full_well_e: float, rng: Any) -> Array:
    """Draw the electrons that light frees, Poisson numbers with a mean that may be far beyond the full well."""
    return poisson(rng, namespace(mean).clip(mean, 0, _SURELY_FULL * full_well_e))


def read_errors(shape_of: Array, pixels: Array, read_noise_e: float, dn_per_electron: float, rng: Any) -> Array:
    """Draw the summed read noise of the pixels behind each value, electrons.

    Each pixel is rounded to a DN by itself. The error of the last rounding is the caller's; those of the other pixels enter
    here, as their variance of 1/12 DN^2 each.
    """
    rounding_e2 = (pixels - 1) / 12 / dn_per_electron**2
    return normal(rng, shape_of) * namespace(shape_of).sqrt(pixels * read_noise_e**2 + rounding_e2)


def clip_pixels(electrons: Array, pixels: Array, spread_e: Array, low_e: float, high_e: float, rng: Any) -> Array:
    """Return the summed electrons of the pixels behind each value with every pixel clipped by itself, to the same shape.

    Given their sum, Gaussian pixels lie about its share with their own spread, less that of their mean: so only bins within
    six deviations of a limit draw their pixels, and nothing else changes.

    Args:
        electrons: ``(C, H, W)`` sums.
        pixels: ``(C, 1, 1)`` pixels in each.
        spread_e: ``(C, H, W)`` standard deviation of one pixel, electrons.
        low_e: where the converter's range begins, electrons per pixel.
        high_e: where it, or the well, ends.
        rng: as in ``normal``.
    """
    xp = namespace(electrons)
    mean, reach = electrons / pixels, _CERTAIN * spread_e
    near = (abs(mean - low_e) < reach) | (abs(mean - high_e) < reach)
    clipped = electrons + 0
    for channel, count in enumerate(map(int, pixels.reshape(-1))):
        if count == 1 or not bool(near[channel].any()):
            continue
        means, spreads = mean[channel][near[channel]], spread_e[channel][near[channel]]
        parts, step = [], max(_DRAWN // count, 1)
        for start in range(0, means.shape[0], step):
            part = xp.broadcast_to(means[start : start + step, None], (means[start : start + step].shape[0], count))
            away = normal(rng, part)
            away = away - xp.mean(away, axis=1, keepdims=True)
            each = xp.clip(part + away * spreads[start : start + step, None], low_e, high_e)
            parts.append(xp.sum(each, axis=1))
        clipped[channel][near[channel]] = xp.concat(parts)
    return clipped


def convert(electrons: Array, pixels: Array, dn_per_electron: float, black_level_dn: float, bit_depth: int) -> Array:
    """Return the mean DN of the pixels behind each value: gain, black level, the converter's range, rounding.

    The range ends at the full well, so one clip is both; charge does not spill over. Bins near a limit are clipped pixel by
    pixel before: ``clip_pixels``.
    """
    xp = namespace(electrons)
    numbers = electrons * dn_per_electron + pixels * black_level_dn
    top = pixels * (2**bit_depth - 1)
    numbers = xp.where(numbers < 0, 0 * numbers, xp.where(numbers > top, top + 0 * numbers, numbers))
    return xp.round(numbers) / pixels
