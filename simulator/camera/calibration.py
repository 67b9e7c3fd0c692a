"""How a laboratory measures PSFs with a camera: exposure, averaging, background, and back to irradiance per irradiance."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from simulator.camera.sensor import Sensor
from simulator.errors import InputError
from simulator.optics.measured import border_level

_ROUNDING = 1e-9
GLOW_REACH = 0.25
"""Length over which the glow of the sensor's edge falls to 1/e, as a share of the picture's width."""


@dataclass(frozen=True)
class Recording:
    """How each PSF is recorded. Shares are of the sensor's full scale.

    Attributes:
        peak: share to which each depth's exposure brings the brightest pixel; with the stray light at most 1, lest it
            saturate.
        frames: pictures that are averaged.
        pedestal: stray light, everywhere alike.
        glow: light of the sensor's left edge where it is brightest; it falls off exponentially.
        background: what is subtracted: ``dark`` (as many pictures with the source covered), ``border`` (the median of the
            picture's outer frame, per channel) or ``none``.
    """

    peak: float = 0.7
    frames: int = 1
    pedestal: float = 0.0
    glow: float = 0.0
    background: Literal["dark", "border", "none"] = "dark"

    def __post_init__(self) -> None:
        if not 0 < self.peak <= 1:
            msg = f"peak: got {self.peak}, expected a share of full scale above 0, at most 1"
            raise InputError(msg)
        if self.frames < 1:
            msg = f"frames: got {self.frames}, expected a whole number of pictures from 1"
            raise InputError(msg)
        brightest = self.peak + self.pedestal + self.glow
        if brightest > 1 + _ROUNDING:
            msg = (
                f"peak + pedestal + glow: got {brightest:.4g} of full scale, expected at most 1, above which pixels "
                "saturate and the PSF's peak is cut off; lower the peak"
            )
            raise InputError(msg)
        if self.background not in ("dark", "border", "none"):
            msg = f"background: got {self.background!r}, expected 'dark', 'border' or 'none'"
            raise InputError(msg)

    def stray(self, shape: tuple[int, ...]) -> NDArray[np.float64]:
        """Return the light that is not the source's, ``(C, H, W)``, shares of full scale."""
        column = np.arange(shape[-1]) / (GLOW_REACH * shape[-1])
        return np.broadcast_to(self.pedestal + self.glow * np.exp(-column), shape)

    def record(
        self, light: NDArray[Any], gains: NDArray[np.float64], sensor: Sensor, rng: np.random.Generator
    ) -> tuple[NDArray[np.float64], dict[str, Any]]:
        """Measure one PSF.

        The source's irradiance at the mask and the channels' gains are known to the laboratory (a reference diode beside
        the mask, a flat field), so a perfect sensor gives the light back.

        Args:
            light: ``(C, H, W)`` irradiance per irradiance at the mask.
            gains: ``(C,)`` relative photons that the channels count under this light.
            sensor: the sensor with its noise; it is taken to be as large as the PSF's grid, and a mosaic to be read as if
                every value had all colours.
            rng: random numbers of this measurement.

        Returns:
            The measured PSF ``(C, H, W)``, not negative, and what is worth recording of it: the share of light that was
            negative and set to zero, and the signal-to-noise ratio, 20 log10(norm of the light / norm of the error), dB.
        """
        rows, columns = light.shape[-2:]
        camera = replace(
            sensor,
            shape=(rows, columns),
            physical_shape=(rows * sensor.binning, columns * sensor.binning),
            full_scale=1.0,
            exposure_s=float(np.mean(sensor.exposure_s)),
            responsivity=None,  # `gains` are the channels' own
            readout="binned_rgb",
        )
        photons = light * gains[:, None, None]
        exposure = self.peak / photons.max()
        stray = self.stray(light.shape)
        picture = self._averaged(photons * exposure + stray, camera, rng)
        if self.background == "dark":
            picture = picture - self._averaged(stray, camera, rng)
        elif self.background == "border":
            picture = picture - border_level(picture)
        measured = picture / (exposure * gains[:, None, None])
        negative = float(np.maximum(-measured, 0).sum() / np.abs(measured).sum())
        measured = np.maximum(measured, 0)
        error = float(np.linalg.norm(measured - light) / np.linalg.norm(light))
        # Beyond 150 dB it is rounding.
        return measured, {"negative_share": negative, "snr_db": -20 * float(np.log10(max(error, 10**-7.5)))}

    def _averaged(self, signal: NDArray[np.float64], camera: Sensor, rng: np.random.Generator) -> NDArray[np.float64]:
        """Return the mean of the frames in shares of full scale, without the black level that the data sheet states."""
        black, white = (camera.noiseless(np.full_like(signal, level)) for level in (0.0, 1.0))
        total = sum(camera.expose(signal, rng) for _ in range(self.frames))
        return (total / self.frames - black) / (white - black)
