"""How a laboratory measures PSFs: a source that is not a point nor quite where it is said to be; exposure, background."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from simulator.camera.sensor import Sensor
from simulator.errors import InputError
from simulator.optics.mask import Mask
from simulator.optics.measured import border_level
from simulator.optics.psf import Progress, PsfConfig, depth_images
from simulator.optics.spectra import quantile_lines
from simulator.types import CameraGeometry

FINE_M = 4e-6
"""Blur and shift act on samples at most this far apart, at least three per pixel. Against 15 per pixel, a PhlatCam's PSF of
4 cm shifted by 7 um differs by 1.6 % at 19.2 um pixels and 2.7 % at 4.8 um (relative L2)."""


@dataclass(frozen=True)
class CalibrationSource:
    """A point source on a stage, with the errors of a laboratory; zero everywhere is a perfect one.

    Attributes:
        diameter_m: of the source, a uniform disc, metres.
        depth_offset_m: true minus stated depth, the same for all depths, metres.
        depth_std_m: standard deviation of every depth on top of that, metres.
        shift_std_m: standard deviation of the source's place across the axis, x and y at every depth, metres.
        tilt_rad: angles of the stage to the axis, x and y; it was aligned at the nearest depth.
    """

    diameter_m: float = 0.0
    depth_offset_m: float = 0.0
    depth_std_m: float = 0.0
    shift_std_m: float = 0.0
    tilt_rad: tuple[float, float] = (0.0, 0.0)

    def place(self, depths_m: tuple[float, ...], mask_to_sensor_m: float, rng: np.random.Generator) -> SourcePlaces:
        """Draw where the source truly is at each stated depth.

        The same numbers are drawn whichever errors are zero, so that switching one off leaves the others as they are.

        Raises:
            InputError: when an error puts a source behind the mask.
        """
        stated = np.asarray(depths_m, np.float64)
        unit = rng.standard_normal((len(stated), 3))
        true = stated + self.depth_offset_m + self.depth_std_m * unit[:, 0]
        if not np.all(true > 0):
            k = int(np.argmax(~(true > 0)))
            raise InputError(
                "depth_offset_m, depth_std_m",
                f"put the source of {stated[k]:g} m at {true[k]:g} m, behind the mask; use smaller errors or farther depths",
            )
        per_metre = (mask_to_sensor_m / true)[:, None]  # 0 at infinity, where only angles count
        along = (mask_to_sensor_m * (1 - stated[0] / stated))[:, None]
        shifts = per_metre * self.shift_std_m * unit[:, 1:] + along * np.tan(self.tilt_rad)
        return SourcePlaces(true, shifts, self.diameter_m * per_metre[:, 0])


@dataclass(frozen=True)
class SourcePlaces:
    """Where the source truly was, and what that does on the sensor.

    Attributes:
        depths_m: ``(K,)`` true depths, metres.
        shifts_m: ``(K, 2)`` shift of the stored PSF, x and y, metres: the image's, so a source to the right shifts right.
        blurs_m: ``(K,)`` diameter of the source's image on the sensor, metres.
    """

    depths_m: NDArray[np.float64]
    shifts_m: NDArray[np.float64]
    blurs_m: NDArray[np.float64]


def captured_light(
    mask: Mask,
    camera: CameraGeometry,
    psf_config: PsfConfig,
    places: SourcePlaces,
    size: int,
    *,
    threads: int = 1,
    progress: Progress | None = None,
) -> NDArray[Any]:
    """Return the PSFs as they fall on the sensor during a calibration, without noise or background.

    Args:
        mask: the mask (NumPy).
        camera: the camera; its ``response`` is that under the calibration's light.
        psf_config: the stated depths, and how PSFs are computed.
        places: where the sources truly are.
        size: odd width N of the images, pixels: that of the nominal stack.
        threads: depths computed at a time.
        progress: called with (done, total) after every PSF.

    Returns:
        ``(K, C, N, N)``: irradiance per irradiance at the mask, stored frame.
    """
    pixel_m = camera.pixel_pitch_m
    reach_m = float(np.max(np.abs(places.shifts_m)) + np.max(places.blurs_m) / 2)
    margin = math.ceil(reach_m / pixel_m)
    acts = reach_m > 0
    # Odd numbers of fine samples keep a pixel's centre on a sample, and the origin in the middle.
    enough = math.ceil(pixel_m / FINE_M - 1e-9)  # five times 4 um is 20 um, but for rounding
    fine = max(3, enough + 1 - enough % 2) if acts else 1
    order = np.argsort(places.depths_m)
    finer = replace(camera, pixel_pitch_m=pixel_m / fine)
    at_true = replace(psf_config, depths_m=tuple(float(depth) for depth in places.depths_m[order]))
    lines = quantile_lines(camera.response, psf_config.wavelengths_per_channel)
    length = fine * (size + 2 * margin)
    light = np.zeros((len(order), len(camera.response.channels), size, size), mask.height_m.dtype)
    on_pixels = [
        _source_image(length, pixel_m / fine, shift, blur, fine, margin)
        for shift, blur in zip(places.shifts_m, places.blurs_m, strict=True)
    ]
    done = 0
    for line in lines:
        images = depth_images(mask, finer, at_true, line.wavelength_m, length, threads=threads)
        for k, image in zip(order, images, strict=True):
            light[k, line.channel] += line.weight * (on_pixels[k](image) if acts else image)
            done += 1
            if progress is not None:
                progress(done, len(lines) * len(order))
    return light


def _source_image(
    length: int, pitch_m: float, shift_m: NDArray[np.float64], blur_m: float, fine: int, margin: int
) -> Callable[[NDArray[Any]], NDArray[Any]]:
    """Return the map from a fine image to pixels: convolved with the source's image, binned, its margin cut off.

    The transfer function of a disc of diameter D is 2 J1(pi D f) / (pi D f) (Goodman, Introduction to Fourier Optics,
    section 2.1), of a shift s exp(-2 pi i f s): both exact for the samples' band.
    """
    from scipy.fft import irfft2, next_fast_len, rfft2
    from scipy.special import j1

    fast = int(next_fast_len(length, real=True))  # pyright: ignore[reportArgumentType]
    pixels = length // fine

    def on_pixels(image: NDArray[Any]) -> NDArray[Any]:
        kind = np.result_type(image.dtype, np.float32)
        fy, fx = np.fft.fftfreq(fast, pitch_m), np.fft.rfftfreq(fast, pitch_m)
        spectrum: Any = rfft2(image, (fast, fast))
        # A transfer function is made for every image: those of all depths together would fill the memory.
        for frequency, shift in ((fy[:, None], shift_m[1]), (fx[None, :], shift_m[0])):
            phase = np.exp(-2j * np.pi * frequency * shift)
            spectrum *= phase.astype(spectrum.dtype)
        if blur_m > 0:
            argument = (np.pi * blur_m * np.hypot(fy[:, None], fx[None, :])).astype(kind)
            argument[0, 0] = 1e-6  # where the transfer is 1
            spectrum *= 2 * j1(argument) / argument
        moved: Any = irfft2(spectrum, (fast, fast))
        binned = np.mean(moved[:length, :length].reshape(pixels, fine, pixels, fine), axis=(1, 3))
        inner = slice(margin, pixels - margin)
        return np.maximum(binned[inner, inner], 0)  # a shift by parts of a sample rings a little beside hard edges

    return on_pixels


_ROUNDING = 1e-9
GLOW_REACH = 0.25
"""Length over which the glow of the sensor's edge falls to 1/e, as a share of the image's width."""


@dataclass(frozen=True)
class Recording:
    """How each PSF is recorded. Shares are of the sensor's full scale.

    Attributes:
        peak: share to which each depth's exposure brings the brightest pixel; with the stray light at most 1, lest it
            saturate.
        frames: images that are averaged.
        pedestal: stray light, everywhere alike.
        glow: light of the sensor's left edge where it is brightest; it falls off exponentially.
        background: what is subtracted: ``dark`` (as many images with the source covered), ``border`` (the median of the
            image's outer frame, per channel) or ``none``.
    """

    peak: float = 0.7
    frames: int = 1
    pedestal: float = 0.0
    glow: float = 0.0
    background: Literal["dark", "border", "none"] = "dark"

    def __post_init__(self) -> None:
        if not 0 < self.peak <= 1:
            raise InputError("peak", f"got {self.peak}, expected a share of full scale above 0, at most 1")
        if self.frames < 1:
            raise InputError("frames", f"got {self.frames}, expected a whole number of images from 1")
        brightest = self.peak + self.pedestal + self.glow
        if brightest > 1 + _ROUNDING:
            raise InputError(
                "peak + pedestal + glow",
                f"got {brightest:.4g}, expected at most 1: pixels would saturate; lower the peak",
            )
        if self.background not in ("dark", "border", "none"):
            raise InputError("background", f"got {self.background!r}, expected 'dark', 'border' or 'none'")

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
        image = self._averaged(photons * exposure + stray, camera, rng)
        if self.background == "dark":
            image = image - self._averaged(stray, camera, rng)
        elif self.background == "border":
            image = image - border_level(image)
        measured = image / (exposure * gains[:, None, None])
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
