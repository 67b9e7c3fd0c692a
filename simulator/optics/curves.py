"""Curves against the wavelength: sensitivities of cameras and spectra of lights, by name, from files, or of LEDs.

Named ones come through colour-science, imported on use because it takes a second.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.tables import NM

COLOURS = ("R", "G", "B")
MONOCHROME = ("Y",)
_TAIL = 2.5  # full widths: there a Gaussian is down to 3e-8


@dataclass(frozen=True)
class SpectralCurves:
    """Curves on common wavelengths.

    Attributes:
        wavelengths_m: ``(N,)`` metres, increasing.
        values: ``(C, N)``, not negative.
        channels: one name per curve.
        label: where they come from.
    """

    wavelengths_m: NDArray[np.float64]
    values: NDArray[np.float64]
    channels: tuple[str, ...]
    label: str

    def at(self, wavelengths_m: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return ``(C, M)``, between samples a monotone cubic, which has no overshoots and so no negative light.

        Args:
            wavelengths_m: ``(M,)`` metres within the curves' own.
        """
        from scipy.interpolate import PchipInterpolator

        inside = np.clip(wavelengths_m, self.wavelengths_m[0], self.wavelengths_m[-1])
        return np.maximum(PchipInterpolator(self.wavelengths_m, self.values, axis=1)(inside), 0)  # rounding


@dataclass(frozen=True)
class Led:
    """A light-emitting diode, its spectrum taken as a Gaussian in wavelength.

    Attributes:
        centre_m: wavelength of the peak, metres.
        fwhm_m: full width at half maximum, metres.
        power: radiant power relative to other LEDs of the same light.
    """

    centre_m: float
    fwhm_m: float
    power: float = 1.0


def curve_file(name: str, base_dir: Path | None = None) -> Path | None:
    """Return the file that a name of curves stands for, or None where it is no file's name."""
    return (base_dir or Path()) / Path(name).expanduser() if name.lower().endswith((".csv", ".json")) else None


def camera_curves(name: str, base_dir: Path | None = None) -> SpectralCurves:
    """Return a camera's relative sensitivities: R, G and B, or Y of a monochrome sensor.

    Args:
        name: of colour-science's ``MSDS_CAMERA_SENSITIVITIES``, or the path of a .csv or .json file.
        base_dir: folder from which relative paths are taken.

    Raises:
        InputError: for an unknown name (the message lists the known ones) or a bad file.
    """
    path = curve_file(name, base_dir)
    if path is not None:
        from simulator.optics.curve_files import read_curves

        return read_curves(path)
    from colour import MSDS_CAMERA_SENSITIVITIES, SpectralShape

    _expect_known("spectral_response", name, MSDS_CAMERA_SENSITIVITIES)
    curves = MSDS_CAMERA_SENSITIVITIES[name].copy()
    shape = SpectralShape(curves.shape.start, curves.shape.end, 1)
    values = np.clip(curves.align(shape).values.T, 0, None)
    return SpectralCurves(np.asarray(shape.wavelengths, np.float64) * NM, values, COLOURS, name)


def illuminant_curve(light: str | Sequence[Led], base_dir: Path | None = None) -> SpectralCurves:
    """Return a light's relative spectral power (per wavelength), as one curve.

    Args:
        light: a name of colour-science's ``SDS_ILLUMINANTS`` such as ``D65`` or ``E``, the path of a .csv or .json file, or
            the LEDs that are lit.
        base_dir: folder from which relative paths are taken.

    Raises:
        InputError: for an unknown name (the message lists the known ones) or a bad file.
    """
    if not isinstance(light, str):
        return _leds(light)
    path = curve_file(light, base_dir)
    if path is not None:
        from simulator.optics.curve_files import read_curves

        curve = read_curves(path)
        if len(curve.channels) != 1:
            msg = f"{path}: {len(curve.channels)} columns; the spectrum of a light is one"
            raise InputError(msg)
        return curve
    from colour import SDS_ILLUMINANTS, SpectralShape

    _expect_known("illuminant", light, SDS_ILLUMINANTS)
    spectrum = SDS_ILLUMINANTS[light].copy()
    shape = SpectralShape(spectrum.shape.start, spectrum.shape.end, 1)
    power = np.asarray(spectrum.align(shape).values, np.float64)
    return SpectralCurves(np.asarray(shape.wavelengths, np.float64) * NM, power[None], MONOCHROME, light)


def _leds(leds: Sequence[Led]) -> SpectralCurves:
    """Sample the sum of Gaussians where it is not dark, eight samples to the narrowest full width, 1 nm at most."""
    step_m = min(NM, min(led.fwhm_m for led in leds) / 8)
    low = min(led.centre_m - _TAIL * led.fwhm_m for led in leds)
    high = max(led.centre_m + _TAIL * led.fwhm_m for led in leds)
    wavelengths_m = np.linspace(low, high, int(np.ceil((high - low) / step_m)) + 1)
    power = np.zeros_like(wavelengths_m)
    for led in leds:
        # Divided by the width: ``power`` is the whole LED's, not that of its peak.
        shape = np.exp(-4 * np.log(2) * ((wavelengths_m - led.centre_m) / led.fwhm_m) ** 2)
        power += led.power * shape * (NM / led.fwhm_m)
    label = " + ".join(f"LED {led.centre_m / NM:g} nm ({led.fwhm_m / NM:g} nm wide)" for led in leds)
    return SpectralCurves(wavelengths_m, power[None], MONOCHROME, label)


def _expect_known(argument: str, name: str, known: object) -> None:
    names = sorted(known)  # pyright: ignore[reportArgumentType]
    if name not in names:
        msg = f"{argument}: got {name!r}, expected one of {', '.join(names)}, or a file .csv or .json"
        raise InputError(msg)
