"""The sensor: from radiant exposure to digital numbers; sensors by name, and automatic exposure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import Array, like, namespace, poisson, to_numpy
from simulator.camera.exposure import ExposureShares
from simulator.camera.noise import (
    GaussianNoise,
    Noise,
    NoNoise,
    PhysicalNoise,
    add_gaussian,
    clip_pixels,
    convert,
    photo_electrons,
    read_errors,
)
from simulator.camera.readout import BayerReadout, BinnedReadout
from simulator.errors import InputError

# Numbers that makers do not publish are typical of the class; every stand-in is labelled nominal in the metadata.
MODELS: dict[str, dict[str, Any]] = {
    "imx183": {
        "pixel_pitch_m": 2.4e-6,
        "physical_shape": (3648, 5472),
        "full_well_e": 15000.0,
        "read_noise_e": 2.7,
        "row_noise_e": 0.3,
        "dark_current_e_per_s": 0.1,
        "dsnu_e": 1.0,
        "prnu": 0.006,
        "black_level_dn": 64.0,
        "bit_depth": 12,
        "peak_quantum_efficiency": 0.6,
        "source": (
            "Sony IMX183 format (5472 x 3648 of 2.4 um); full well, noise, quantum efficiency and spectral response nominal"
        ),
    },
    "pco_edge_5_5": {
        "pixel_pitch_m": 6.5e-6,
        "physical_shape": (2160, 2560),
        "full_well_e": 30000.0,
        "read_noise_e": 1.5,
        "row_noise_e": 0.3,
        "dark_current_e_per_s": 5.0,
        "dsnu_e": 1.0,
        "prnu": 0.006,
        "black_level_dn": 103.0,
        "bit_depth": 16,
        "peak_quantum_efficiency": 0.6,
        "source": (
            "pco.edge 5.5 format (2560 x 2160 of 6.5 um), 16 bit; dark level as published with rolling-shutter captures, "
            "full well, noise, quantum efficiency and spectral response nominal"
        ),
    },
}


_RESOLVED = 1e-6
"""Of the brightest value, what float32 convolution resolves (some 1e-7)."""

PILOTS = 16
PERCENTILE = 99.9
TARGET = 0.8


def full_scale_from_pilots(exposures: Sequence[NDArray[np.floating]]) -> float:
    """Return the exposure at full scale that puts the pilots' 99.9th percentile at 80 % of it.

    Args:
        exposures: noiseless exposures ``(C, H, W)`` of the pilot samples.

    Raises:
        InputError: when the pilots are dark.
    """
    bright = float(np.percentile(np.concatenate([np.ravel(e) for e in exposures]), PERCENTILE))
    if not bright > 0:
        raise InputError(
            "camera.exposure.full_scale",
            "'auto' found no light in the pilot samples; check scene and mask, or give a number",
        )
    return bright / TARGET


_PRNU, _DSNU = (1288,), (1288, 1)  # spawn keys of the two fixed patterns


@dataclass(frozen=True)
class Sensor:
    """A CMOS sensor with square bins.

    Signals are shares of full scale, equal in all channels for a white surface. Where channels count different numbers of
    electrons for it (``responsivity``), the digital numbers are balanced after conversion: the noiseless signal keeps its
    one scale, the less sensitive channels are noisier, and they are full only at 1 / responsivity.

    Attributes:
        name: the model's name.
        pixel_pitch_m: physical pixel pitch, metres.
        physical_shape: physical rows and columns.
        binning: physical pixels per stored value and axis; the stored value is the digital mean of its colour's pixels.
        shape: stored rows and columns, H and W, cut from the middle.
        full_well_e: electrons at full scale, per physical pixel; there the converter's range ends too.
        read_noise_e: standard deviation per read, electrons.
        row_noise_e: standard deviation of a physical row's common error, electrons.
        dark_current_e_per_s: electrons per second and physical pixel.
        prnu: relative standard deviation of the pixels' responsivity; a fixed pattern of this sensor.
        black_level_dn: digital number of darkness.
        bit_depth: of the converter.
        dsnu_e: standard deviation of the pixels' dark signal, electrons; a fixed pattern of this sensor.
        peak_quantum_efficiency: electrons per photon where the most sensitive channel's spectral response peaks.
        exposure_s: seconds, for the dark current; one for each stored row, top first, where they differ.
        full_scale: radiant exposure (of a forward model) at which a pixel of responsivity 1 is full.
        responsivity: electrons of each channel of the light for a white surface, relative to the channel with the most;
            None means 1 for all.
        noise: the noise model.
        readout: ``binned_rgb``: every stored value has all channels; ``bayer``: a mosaic of one colour each.
        cfa: colour filter array of the ``bayer`` readout: the colours of the stored window's own upper left 2 x 2 values
            on the physical sensor, row by row.
        pattern_seed: seed of the fixed patterns.
        source: where the numbers come from; ``nominal`` marks stand-ins.
    """

    name: str
    pixel_pitch_m: float
    physical_shape: tuple[int, int]
    binning: int
    shape: tuple[int, int]
    full_well_e: float
    read_noise_e: float
    row_noise_e: float
    dark_current_e_per_s: float
    prnu: float
    black_level_dn: float
    bit_depth: int
    dsnu_e: float = 0.0
    peak_quantum_efficiency: float = 1.0
    exposure_s: float | tuple[float, ...] = 0.01
    full_scale: float = 1.0
    responsivity: tuple[float, ...] | None = None
    noise: Noise = field(default_factory=NoNoise)
    readout: Literal["binned_rgb", "bayer"] = "binned_rgb"
    cfa: str = "RGGB"
    pattern_seed: int = 0
    source: str = ""

    def __post_init__(self) -> None:
        if self.readout not in ("binned_rgb", "bayer"):
            raise InputError("readout", f"got {self.readout!r}, expected 'binned_rgb' or 'bayer'")
        for axis, stored, physical in zip(("rows", "columns"), self.shape, self.physical_shape, strict=True):
            needed = self._readout.extent(stored)
            if needed > physical:
                raise InputError(
                    "shape",
                    f"got {stored} {axis} of {self.binning} x {self.binning} bins, which need {needed} physical "
                    f"{axis}; sensor {self.name!r} has {physical}: at most {physical // self.binning}",
                )
        if self.full_scale <= 0 or not np.isfinite(self.full_scale):
            raise InputError("full_scale", f"got {self.full_scale!r}, expected a positive exposure")
        if not 0 <= self.black_level_dn < 2**self.bit_depth - 1:
            top = 2**self.bit_depth - 1
            raise InputError(
                "black_level_dn",
                f"got {self.black_level_dn}, expected 0 to below {top}, the top of {self.bit_depth} bits",
            )
        if np.size(self.exposure_s) not in (1, self.shape[0]) or not np.all(np.greater(self.exposure_s, 0)):
            raise InputError(
                "exposure_s", f"expected 1 or {self.shape[0]} (rows) positive seconds, got {self.exposure_s!r}"
            )
        if self.responsivity is not None and not all(0 < share <= 1 for share in self.responsivity):
            raise InputError("responsivity", f"got {self.responsivity}, expected shares above 0, at most 1")

    @property
    def binned_pitch_m(self) -> float:
        """Pitch of the stored values, metres."""
        return self.pixel_pitch_m * self.binning

    @property
    def dn_range(self) -> float:
        """Digital numbers between darkness and full scale."""
        return 2**self.bit_depth - 1 - self.black_level_dn

    @property
    def dn_per_electron(self) -> float:
        """Conversion gain: full well comes out as the largest digital number."""
        return self.dn_range / self.full_well_e

    @property
    def stored_cfa(self) -> str | None:
        """Colours of the stored image's upper left 2 x 2 values, row by row; None where values have all channels."""
        return self._readout.stored_pattern if isinstance(self._readout, BayerReadout) else None

    def channels(self, stack_channels: tuple[str, ...]) -> tuple[str, ...]:
        """Return the names of the measurement's channels for those of the light (of the PSF stack)."""
        if self.responsivity is not None and len(self.responsivity) != len(stack_channels):
            raise InputError(
                "camera.exposure.illuminance_lux",
                f"the spectral response has {len(self.responsivity)} channels, the PSF stack has "
                f"{', '.join(stack_channels)}; choose a camera.sensor.spectral_response with as many",
            )
        return self._readout.channels(stack_channels)

    def response_map(self, shape: tuple[int, ...]) -> NDArray[np.float32]:
        """Return the fixed pattern of responsivity ``(C, H, W)``, 1 on average: the same for every image."""
        return self._pattern(shape, self.prnu, _PRNU) + 1

    def dark_map(self, shape: tuple[int, ...]) -> NDArray[np.float32]:
        """Return the fixed pattern of the dark signal ``(C, H, W)``, electrons per pixel, 0 on average."""
        return self._pattern(shape, self.dsnu_e, _DSNU)

    def dark_electrons(self, signal: Array) -> Array | float:
        """Return the mean dark current of a pixel's exposure, electrons, in a form that fits the signal."""
        if isinstance(self.exposure_s, tuple):
            return like(np.asarray(self.exposure_s)[:, None] * self.dark_current_e_per_s, signal)
        return self.exposure_s * self.dark_current_e_per_s

    def balance(self, signal: Array) -> Array | float:
        """Return the responsivity behind each stored value, in a form that fits the signal."""
        return 1.0 if self.responsivity is None else like(self._readout.spread(self.responsivity), signal)

    def expose(self, irradiance: Array, rng: Any) -> Array:
        """Return DN / 2^bits of one image.

        With physical noise, in this order: photo-response non-uniformity (a fixed pattern of the light's mean), photons,
        dark current, dark-signal non-uniformity, read noise, row errors, gain and black level, the converter's range,
        rounding, white balance. Every physical pixel is read and digitised by itself; a stored value is the digital mean of
        the ``n`` pixels of its colour in the bin. These see one irradiance, so their electrons are drawn as one Poisson
        number; near a limit of the range their differences are drawn too (their fixed patterns among them, anew for every
        image), and each is clipped. At last a channel of responsivity r is divided by r, above the black level. Source: EMVA
        standard 1288, release 4.0, section 2.

        Args:
            irradiance: radiant exposure ``(C, H, W)`` from a forward model; ``full_scale`` of it fills a pixel.
            rng: ``numpy.random.Generator``, or ``torch.Generator`` for tensors.

        Returns:
            ``(C, H, W)``, or ``(1, H, W)`` of a mosaic.

        Raises:
            InputError: for a wrong shape, or channels that this sensor cannot read.
        """
        signal = self._signal(irradiance)
        if isinstance(self.noise, NoNoise):
            return signal
        if isinstance(self.noise, GaussianNoise):
            return add_gaussian(signal, self.noise, self.bit_depth, rng)
        shape, balance = tuple(signal.shape), self.balance(signal)
        pixels = like(self._readout.pixels(shape[0]), signal)
        light = signal * balance * like(self.response_map(shape), signal)  # PRNU, of the light alone
        electrons = photo_electrons(light * (self.full_well_e * pixels), self.full_well_e, rng)
        dark = namespace(signal).zeros_like(signal) + self.dark_electrons(signal) * pixels
        electrons = electrons + poisson(rng, dark) + like(self.dark_map(shape), signal) * pixels  # DSNU
        electrons = electrons + read_errors(signal, pixels, self.read_noise_e, self.dn_per_electron, rng)
        electrons = electrons + self._readout.row_errors(signal, self.row_noise_e, rng) * pixels
        spread_e = namespace(signal).sqrt(
            namespace(signal).clip(electrons / pixels, 0, 2 * self.full_well_e)
            + (self.read_noise_e**2 + self.dsnu_e**2)
            + (self.prnu * self.full_well_e * namespace(signal).clip(light, 0, 2)) ** 2
        )
        darkest_e = -self.black_level_dn / self.dn_per_electron
        electrons = clip_pixels(electrons, pixels, spread_e, darkest_e, self.full_well_e, rng)
        numbers = convert(electrons, pixels, self.dn_per_electron, self.black_level_dn, self.bit_depth)
        if self.responsivity is not None:
            numbers = (numbers - self.black_level_dn) / balance + self.black_level_dn
        return numbers / 2**self.bit_depth

    def noiseless(self, irradiance: Array) -> Array:
        """Return the expected DN / 2^bits, neither clipped nor quantised, averaged over the fixed patterns; see ``expose``.

        With physical noise it includes the dark current and the black level.
        """
        signal = self._signal(irradiance)
        if not isinstance(self.noise, PhysicalNoise):
            return signal
        share = self._fill(signal) / self.balance(signal)
        return (self.black_level_dn + share * self.dn_range) / 2**self.bit_depth

    def shares(self, irradiance: Array) -> ExposureShares:
        """Return which shares of the stored values are expected to be saturated, black or below the noise; see ``expose``."""
        signal = self._signal(irradiance)
        full = to_numpy(self._fill(signal)) >= 1
        light, step = signal, 2.0**-self.bit_depth
        if isinstance(self.noise, PhysicalNoise):
            light = signal * self.balance(signal)
            step = 1 / (self.dn_range * self._readout.pixels(signal.shape[0]))
        noise, light = to_numpy(self.dark_noise(signal)), to_numpy(light)
        black = light < np.maximum(step / 2, _RESOLVED * light.max())
        faint = (light < noise) & (noise > 0)  # convolution leaves values just below 0
        return ExposureShares(*(float(np.mean(part)) for part in (full, black, faint, ~(full | black | faint))))

    def dark_noise(self, signal: Array) -> Array | float:
        """Return the standard deviation of the values in darkness, share of full scale before the white balance.

        Dark current, dark-signal non-uniformity, read noise, row errors and rounding, of the pixels behind each value; with
        Gaussian noise, that of an image with this noiseless signal.
        """
        if isinstance(self.noise, NoNoise):
            return 0.0
        if isinstance(self.noise, GaussianNoise):
            return self.noise.standard_deviation(signal)
        pixels, rows = (like(n(signal.shape[0]), signal) for n in (self._readout.pixels, self._readout.rows))
        rounding_e2 = 1 / 12 / self.dn_per_electron**2
        of_a_pixel_e2 = self.dark_electrons(signal) + self.dsnu_e**2 + self.read_noise_e**2 + rounding_e2
        return namespace(signal).sqrt(of_a_pixel_e2 / pixels + self.row_noise_e**2 / rows) * (1 / self.full_well_e)

    def _fill(self, signal: Array) -> Array:
        """Return the expected share of full scale that the pixels reach; electrons of the dark current included."""
        if not isinstance(self.noise, PhysicalNoise):
            return signal
        return signal * self.balance(signal) + self.dark_electrons(signal) * (1 / self.full_well_e)

    @property
    def _readout(self) -> BinnedReadout | BayerReadout:
        if self.readout == "bayer":
            return BayerReadout(self.binning, self.cfa, self.shape)
        return BinnedReadout(self.binning)

    def _pattern(self, shape: tuple[int, ...], std: float, key: tuple[int, ...]) -> NDArray[np.float32]:
        rng = np.random.default_rng(np.random.SeedSequence(self.pattern_seed, spawn_key=key))
        pixels = self._readout.pixels(shape[0])
        return (std / np.sqrt(pixels) * rng.standard_normal(shape)).astype(np.float32)

    def _signal(self, irradiance: Array) -> Array:
        if irradiance.ndim != 3 or tuple(irradiance.shape[1:]) != self.shape:
            raise InputError(
                "irradiance", f"expected (C, {self.shape[0]}, {self.shape[1]}), got {tuple(irradiance.shape)}"
            )
        if self.responsivity is not None and len(self.responsivity) != irradiance.shape[0]:
            raise InputError(
                "irradiance",
                f"has {irradiance.shape[0]} channels, expected the {len(self.responsivity)} of the responsivity",
            )
        return self._readout.read(irradiance) * (1 / self.full_scale)
