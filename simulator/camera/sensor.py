"""The sensor: from radiant exposure to digital numbers."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.arrays import Array
from simulator.camera.noise import Noise, NoNoise
from simulator.errors import InputError

BAYER_SHARE = (0.25, 0.5, 0.25)  # of the physical pixels in a bin, for R, G, B


@dataclass(frozen=True)
class Sensor:
    """A CMOS sensor with square bins.

    Attributes:
        name: the model's name.
        pixel_pitch_m: physical pixel pitch, metres.
        physical_shape: physical rows and columns.
        binning: physical pixels per stored value and axis; the stored value is the digital mean of its colour's pixels.
        shape: stored rows and columns, H and W, cut from the middle.
        full_well_e: electrons at full scale, per physical pixel.
        read_noise_e: standard deviation per read, electrons.
        row_noise_e: standard deviation of a row's common error, electrons.
        dark_current_e_per_s: electrons per second and physical pixel.
        prnu: relative standard deviation of the pixels' responsivity; a fixed pattern of this sensor.
        black_level_dn: digital number of darkness.
        bit_depth: of the converter.
        exposure_s: seconds, for the dark current.
        full_scale: radiant exposure (of a forward model) at which a pixel is full.
        noise: the noise model.
        pattern_seed: seed of the fixed pattern.
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
    exposure_s: float = 0.01
    full_scale: float = 1.0
    noise: Noise = field(default_factory=NoNoise)
    pattern_seed: int = 0
    source: str = ""

    def __post_init__(self) -> None:
        for axis, stored, physical in zip(("rows", "columns"), self.shape, self.physical_shape, strict=True):
            if stored * self.binning > physical:
                msg = (
                    f"shape: {stored} {axis} of {self.binning} x {self.binning} bins need {stored * self.binning} physical "
                    f"{axis}, but sensor {self.name!r} has {physical}; at most {physical // self.binning}"
                )
                raise InputError(msg)
        if self.full_scale <= 0 or not np.isfinite(self.full_scale):
            msg = f"full_scale: got {self.full_scale!r}, expected a positive exposure"
            raise InputError(msg)
        if not 0 <= self.black_level_dn < 2**self.bit_depth - 1:
            msg = f"black_level_dn: got {self.black_level_dn}, expected 0 to below {2**self.bit_depth - 1}"
            raise InputError(msg)

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

    def pixels_per_channel(self, channels: int) -> tuple[float, ...]:
        """Return how many physical pixels stand behind one stored value of each channel.

        A colour bin holds a quarter red, half green and a quarter blue pixels (Bayer). Below a 2 x 2 bin a stored value
        is one idealised pixel per colour.
        """
        pixels = self.binning**2
        if channels != 3 or self.binning < 2:
            return (float(pixels),) * channels
        return tuple(max(1.0, pixels * share) for share in BAYER_SHARE)

    def response_map(self, shape: tuple[int, ...]) -> NDArray[np.float32]:
        """Return the fixed pattern of responsivity ``(C, H, W)``, 1 on average: the same for every picture."""
        rng = np.random.default_rng(np.random.SeedSequence(self.pattern_seed, spawn_key=(1288,)))
        pixels = np.asarray(self.pixels_per_channel(shape[0]))[:, None, None]
        return (1 + self.prnu / np.sqrt(pixels) * rng.standard_normal(shape)).astype(np.float32)

    def expose(self, irradiance: Array, rng: Any) -> Array:
        """Return DN / 2^bits of one picture.

        Args:
            irradiance: radiant exposure ``(C, H, W)`` from a forward model; ``full_scale`` of it fills a pixel.
            rng: ``numpy.random.Generator``, or ``torch.Generator`` for tensors.

        Raises:
            InputError: for a wrong shape.
        """
        return self.noise.apply(self._signal(irradiance), self, rng)

    def noiseless(self, irradiance: Array) -> Array:
        """Return the expected DN / 2^bits, neither clipped nor quantised; see ``expose``."""
        return self.noise.noiseless(self._signal(irradiance), self)

    def _signal(self, irradiance: Array) -> Array:
        if irradiance.ndim != 3 or tuple(irradiance.shape[1:]) != self.shape:
            msg = f"irradiance must be (C, H, W) with (H, W) = {self.shape}, got {tuple(irradiance.shape)}"
            raise InputError(msg)
        return irradiance * (1 / self.full_scale)


# Numbers that makers do not publish are typical of the class; every stand-in is labelled nominal in the metadata.
MODELS: dict[str, dict[str, Any]] = {
    "imx183": {
        "pixel_pitch_m": 2.4e-6,
        "physical_shape": (3648, 5472),
        "full_well_e": 15000.0,
        "read_noise_e": 2.7,
        "row_noise_e": 0.3,
        "dark_current_e_per_s": 0.1,
        "prnu": 0.006,
        "black_level_dn": 64.0,
        "bit_depth": 12,
        "source": "Sony IMX183 format (5472 x 3648 of 2.4 um); full well, noise and spectral response nominal",
    }
}
