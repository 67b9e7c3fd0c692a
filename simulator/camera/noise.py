"""Sensor noise: Gaussian by standard deviation or measurement PSNR, and the physical chain of a CMOS pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, Protocol

from simulator.arrays import Array, like, namespace, normal, number, poisson
from simulator.errors import InputError

if TYPE_CHECKING:
    from simulator.camera.sensor import Sensor

_SURELY_FULL = 1e6
"""Share of full scale beyond which nothing changes, where Poisson numbers still fit 64 bits."""


class Noise(Protocol):
    """What happens between a perfect signal and the stored number.

    Signals are shares of full scale, in the shape of the stored picture.
    """

    def fill(self, signal: Array, sensor: Sensor) -> Array:
        """Return the expected share of full scale that the pixels reach: from 1 on they are saturated."""
        ...

    def noiseless(self, signal: Array, sensor: Sensor) -> Array:
        """Return DN / 2^bits without noise."""
        ...

    def apply(self, signal: Array, sensor: Sensor, rng: Any) -> Array:
        """Return DN / 2^bits with noise."""
        ...


@dataclass(frozen=True)
class NoNoise:
    """The perfect sensor: the signal itself, neither clipped nor quantised."""

    def fill(self, signal: Array, sensor: Sensor) -> Array:
        """Return the signal."""
        return signal

    def noiseless(self, signal: Array, sensor: Sensor) -> Array:
        """Return the signal."""
        return signal

    def apply(self, signal: Array, sensor: Sensor, rng: Any) -> Array:
        """Return the signal."""
        return signal


@dataclass(frozen=True)
class GaussianNoise:
    """White Gaussian noise, as the literature's simulations add it; black level zero, the same in all channels.

    Attributes:
        std: standard deviation as a share of full scale, or None.
        psnr_db: measurement PSNR, 20 log10(peak / std), or None. Exactly one of the two is given.
        peak: ``sample``: the maximum of this sample's noiseless measurement over all channels; ``full_scale``: 1.
        clip: whether to clip to the converter's range, 0 to (2^bits - 1) / 2^bits.
        quantise: whether to round to the sensor's digital numbers.
    """

    std: float | None = None
    psnr_db: float | None = None
    peak: Literal["sample", "full_scale"] = "sample"
    clip: bool = False
    quantise: bool = False

    def __post_init__(self) -> None:
        if (self.std is None) == (self.psnr_db is None):
            msg = f"noise: give exactly one of std and psnr_db, got std={self.std} and psnr_db={self.psnr_db}"
            raise InputError(msg)

    def standard_deviation(self, signal: Array) -> float:
        """Return the standard deviation for this noiseless signal, as a share of full scale."""
        if self.std is not None:
            return self.std
        assert self.psnr_db is not None
        peak = number(namespace(signal).max(signal)) if self.peak == "sample" else 1.0
        return peak * 10 ** (-self.psnr_db / 20)

    def fill(self, signal: Array, sensor: Sensor) -> Array:
        """Return the signal."""
        return signal

    def noiseless(self, signal: Array, sensor: Sensor) -> Array:
        """Return the signal."""
        return signal

    def apply(self, signal: Array, sensor: Sensor, rng: Any) -> Array:
        """Add the noise; see the class."""
        xp = namespace(signal)
        noisy = signal + self.standard_deviation(signal) * normal(rng, signal)
        if self.clip:
            noisy = xp.clip(noisy, 0, 1 - 2**-sensor.bit_depth)
        if self.quantise:
            noisy = xp.round(noisy * 2**sensor.bit_depth) / 2**sensor.bit_depth
        return noisy


@dataclass(frozen=True)
class PhysicalNoise:
    """Photons, dark current, pixel and row errors, read noise, black level, clipping, quantisation, white balance, in order.

    Every physical pixel is read and digitised by itself; a stored value is the digital mean of the ``n`` pixels of
    its colour in the bin. The n pixels see one irradiance, so their electrons are drawn as one Poisson number, and the
    rounding errors of all but the sum's own enter as their variance, 1/12 DN^2 each. The converter's range ends at the full
    well, so one clip is both; charge does not spill over. At last a channel of responsivity r is divided by r, above the
    black level. Source: EMVA standard 1288, release 4.0, section 2.
    """

    def fill(self, signal: Array, sensor: Sensor) -> Array:
        """Return the expected electrons, dark ones included, as a share of the full well."""
        return signal * sensor.balance(signal) + sensor.dark_electrons(signal) * (1 / sensor.full_well_e)

    def noiseless(self, signal: Array, sensor: Sensor) -> Array:
        """Return the expected DN / 2^bits below saturation, dark current included, averaged over the fixed patterns."""
        share = self.fill(signal, sensor) / sensor.balance(signal)
        return (sensor.black_level_dn + share * sensor.dn_range) / 2**sensor.bit_depth

    def apply(self, signal: Array, sensor: Sensor, rng: Any) -> Array:
        """Draw one measurement; see the class."""
        xp = namespace(signal)
        shape = tuple(signal.shape)
        pixels, balance = sensor.pixels(signal), sensor.balance(signal)
        light = xp.clip(signal, 0, _SURELY_FULL) * balance
        electrons = poisson(rng, light * (sensor.full_well_e * pixels))
        electrons = electrons + poisson(rng, xp.zeros_like(signal) + sensor.dark_electrons(signal) * pixels)
        electrons = electrons * like(sensor.response_map(shape), signal) + like(sensor.dark_map(shape), signal) * pixels
        rounding_e2 = (pixels - 1) / 12 / sensor.dn_per_electron**2
        read = normal(rng, signal) * xp.sqrt(pixels * sensor.read_noise_e**2 + rounding_e2)
        row = sensor.row_errors(signal, rng)
        numbers = (electrons + read + row * pixels) * sensor.dn_per_electron + pixels * sensor.black_level_dn
        top = pixels * (2**sensor.bit_depth - 1)
        numbers = xp.round(xp.where(numbers < 0, 0 * numbers, xp.where(numbers > top, top + 0 * numbers, numbers)))
        numbers = numbers / pixels
        if sensor.responsivity is not None:
            numbers = (numbers - sensor.black_level_dn) / balance + sensor.black_level_dn
        return numbers / 2**sensor.bit_depth
