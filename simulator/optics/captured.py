"""The light that a real calibration sees: a source that is not a point, not quite where it is said to be.

Depth errors recompute the PSF at the true depth; a source off the axis shifts it, one of finite size blurs it, both by
their image on the sensor, d/z times as large. Noise and background are the camera's: simulator.camera.calibration.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.optics.mask import Mask
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
            msg = (
                f"depth_offset_m, depth_std_m: the source of {stated[k]:g} m would stand at {true[k]:g} m, behind the mask; "
                "use smaller errors or farther depths"
            )
            raise InputError(msg)
        per_metre = (mask_to_sensor_m / true)[:, None]  # 0 at infinity, where only angles count
        along = (mask_to_sensor_m * (1 - stated[0] / stated))[:, None]
        shifts = per_metre * self.shift_std_m * unit[:, 1:] + along * np.tan(self.tilt_rad)
        return SourcePlaces(true, shifts, self.diameter_m * per_metre[:, 0])


@dataclass(frozen=True)
class SourcePlaces:
    """Where the source truly was, and what that does on the sensor.

    Attributes:
        depths_m: ``(K,)`` true depths, metres.
        shifts_m: ``(K, 2)`` shift of the stored PSF, x and y, metres: the picture's, so a source to the right shifts right.
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
        size: odd width N of the pictures, pixels: that of the nominal stack.
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
