"""Spectra of cameras and lights, the responses they make, the few wavelengths that stand for them, and electrons per lux."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.files import expanded, read_text
from simulator.io.tables import NM, ordered, read_wavelength_table
from simulator.settings import Quantity, Range, Settings
from simulator.types import Refractive, SpectralResponse

COLOURS = ("R", "G", "B")
MONOCHROME = ("Y",)
# No curves are published here for the IMX183: this measured DSLR set is the labelled stand-in.
NOMINAL_CAMERA = "Nikon 5100 (NPL)"


# ---- curves by name

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
class Led(Settings):
    """A light-emitting diode, its spectrum taken as a Gaussian in wavelength.

    Attributes:
        centre_m: wavelength of the peak.
        fwhm_m: full width at half maximum.
        power: radiant power relative to the other LEDs.
    """

    centre_m: Annotated[float, Quantity(200, 2000, "nm", key="led_nm")]
    fwhm_m: Annotated[float, Quantity(1, 300, "nm", key="fwhm_nm", below="narrower lines look the same to a camera")]
    power: Annotated[float, Range(1e-6, 1e6)] = 1.0


def curve_file(name: str, base_dir: Path | None = None) -> Path | None:
    """Return the file that a name of curves stands for, or None where it is not a file name."""
    return expanded(name, base_dir) if name.lower().endswith((".csv", ".json")) else None


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
        return read_curves(path)
    from colour import MSDS_CAMERA_SENSITIVITIES

    return _published("spectral_response", name, MSDS_CAMERA_SENSITIVITIES, COLOURS)


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
        curve = read_curves(path)
        if len(curve.channels) != 1:
            raise InputError(path, f"{len(curve.channels)} columns; the spectrum of a light is one")
        return curve
    from colour import SDS_ILLUMINANTS

    return _published("illuminant", light, SDS_ILLUMINANTS, MONOCHROME)


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


def _published(argument: str, name: str, known: Any, channels: tuple[str, ...]) -> SpectralCurves:
    """Return a camera or light of colour-science, on whole nanometres."""
    from colour import SpectralShape

    if name not in (names := sorted(known)):  # known itself takes lower case too
        raise InputError(argument, f"got {name!r}, expected one of {', '.join(names)}, or a file .csv or .json")
    curves = known[name].copy()
    shape = SpectralShape(curves.shape.start, curves.shape.end, 1)
    values = np.atleast_2d(np.asarray(curves.align(shape).values, np.float64).T)
    return SpectralCurves(np.asarray(shape.wavelengths, np.float64) * NM, np.clip(values, 0, None), channels, name)


# ---- curves from files

_NAMES = {"r": "R", "red": "R", "g": "G", "green": "G", "b": "B", "blue": "B"}
_FORGIVEN = 0.01  # of the peak: a digitised or measured zero may lie a little below


def read_curves(path: Path) -> SpectralCurves:
    """Read one curve, or R, G and B.

    Only ratios count later, so curves may be absolute or relative; percent become fractions where the file says percent.

    Args:
        path: ``.csv``: the wavelength (nm unless the header says um or angstrom) and one column, or three: red, green and
            blue, in this order if there is no header that names them. ``.json``: as in rawtoaces-data.
    """
    if path.suffix.lower() == ".json":
        wavelengths_m, columns, names = _read_json(path)
        said = ""
    else:
        table = read_wavelength_table(path, unit_m=NM)
        wavelengths_m, columns, names = table.wavelengths_m, table.columns, table.names
        said = " ".join([table.remarks, *(names or ())]).lower()
    channels, columns = _in_order(path, names, columns)
    peak = columns.max()
    if not peak > 0 or columns.min() < -_FORGIVEN * peak:
        raise InputError(path, f"values from {columns.min():g} to {peak:g}; a spectral curve is positive")
    scale = 0.01 if re.search(r"percent|%", said) else 1.0
    return SpectralCurves(wavelengths_m, np.clip(columns.T, 0, None) * scale, channels, path.name)


def _read_json(path: Path) -> tuple[NDArray[np.float64], NDArray[np.float64], tuple[str, ...]]:
    """Return wavelengths, columns and names of a rawtoaces file (its schema 0.1 and 1.0: nanometres as keys)."""
    text = read_text(path, "a table of wavelengths")
    try:
        content: Any = json.loads(text)["spectral_data"]
        names = tuple(str(name) for name in content["index"]["main"])
        rows = content["data"]["main"]
        table = np.array([[float(wavelength), *map(float, row)] for wavelength, row in rows.items()])
        if table.ndim != 2 or len(table) < 2 or table.shape[1] != len(names) + 1 or not np.all(np.isfinite(table)):
            msg = f"{len(rows)} rows for the columns {', '.join(names)}"
            raise ValueError(msg)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise InputError(
            path,
            f"not a rawtoaces file ({type(error).__name__}: {error}); expected spectral_data with index.main and "
            "data.main, or write a .csv",
        ) from error
    return *ordered(path, table[:, 0] * NM, table[:, 1:]), names


def _in_order(
    path: Path, names: tuple[str, ...] | None, columns: NDArray[np.float64]
) -> tuple[tuple[str, ...], NDArray[np.float64]]:
    if columns.shape[1] == 1:
        return MONOCHROME, columns
    found = [_NAMES.get(re.split(r"[^a-z]", name.lower())[0], name) for name in names or COLOURS]
    if columns.shape[1] != 3 or sorted(found) != sorted(COLOURS):
        raise InputError(
            path, f"columns {', '.join(found)}; expected one (monochrome, a light), or red, green and blue"
        )
    return COLOURS, columns[:, [found.index(colour) for colour in COLOURS]]


# ---- the response and the lines that stand for it

_FINEST_M = 0.1e-9


def spectral_response(
    camera: str = NOMINAL_CAMERA, illuminant: str | Sequence[Led] = "D65", base_dir: Path | None = None
) -> SpectralResponse:
    """Return the photon weights of a camera's channels under an illuminant.

    w_c(l) = illuminant(l) x response_c(l) x l, because sensors count photons and illuminants are given as power.

    Args:
        camera: a name or file for :func:`simulator.optics.spectra.camera_curves`.
        illuminant: a name, file or LEDs for :func:`simulator.optics.spectra.illuminant_curve`.
        base_dir: folder from which relative paths are taken.

    Returns:
        The weights on the wavelengths that both curves cover, 1 nm apart or finer for a narrow LED.

    Raises:
        InputError: for unknown names (the message lists the known ones), bad files, or curves without a common wavelength.
    """
    curves, light = camera_curves(camera, base_dir), illuminant_curve(illuminant, base_dir)
    low = max(curves.wavelengths_m[0], light.wavelengths_m[0])
    high = min(curves.wavelengths_m[-1], light.wavelengths_m[-1])
    label = f"{curves.label} under {light.label}" + (", nominal" if camera == NOMINAL_CAMERA else "")
    if not low < high:
        raise InputError(
            label,
            f"the camera's curves ({_span(curves.wavelengths_m)}) and the light's ({_span(light.wavelengths_m)}) have "
            "no wavelength in common; does a header say the right unit?",
        )
    step_m = min(NM, max(_FINEST_M, float(np.diff(light.wavelengths_m).min())))
    wavelengths_m = np.linspace(low, high, int(np.ceil((high - low) / step_m - 1e-6)) + 1)
    weights = curves.at(wavelengths_m) * light.at(wavelengths_m) * wavelengths_m
    return SpectralResponse(wavelengths_m, weights, curves.channels, label)


def _span(wavelengths_m: NDArray[np.float64]) -> str:
    return f"{wavelengths_m[0] / NM:g} to {wavelengths_m[-1] / NM:g} nm"


@dataclass(frozen=True)
class Line:
    """One wavelength that stands for a part of a channel.

    Attributes:
        channel: index of the channel.
        wavelength_m: metres.
        weight: share of the channel's photons; the weights of a channel add up to 1.
    """

    channel: int
    wavelength_m: float
    weight: float


def quantile_lines(response: SpectralResponse, per_channel: int) -> list[Line]:
    """Return ``per_channel`` lines per channel, each the centroid of an equal share of the channel's photons.

    Args:
        response: photon weights per channel.
        per_channel: number of lines per channel, from 1.

    Raises:
        InputError: when a channel has no weight or ``per_channel`` is below 1.
    """
    if per_channel < 1:
        raise InputError("wavelengths_per_channel", f"got {per_channel}, expected a whole number from 1")
    lines = []
    for channel, weights in enumerate(response.weights):
        if not weights.sum() > 0:
            raise InputError(f"{response.label}, channel {response.channels[channel]!r}", "zero everywhere")
        for wavelength_m in _centroids(response.wavelengths_m, weights, per_channel):
            lines.append(Line(channel, float(wavelength_m), 1 / per_channel))
    return lines


def shared_lines(response: SpectralResponse, count: int) -> list[Line]:
    """Return ``count`` wavelengths that all channels share, each channel with its own weights on them.

    The wavelengths are the centroids of equal shares of the channels' mean; a channel's weight on one is its photons in that
    share. A PSF of one wavelength then serves all channels: 5 of them err less than 3 of each channel's own, 9 in all.

    Args:
        response: photon weights per channel.
        count: number of wavelengths, from 1.

    Returns:
        Lines by wavelength and channel; those without weight are left out.

    Raises:
        InputError: when a channel has no weight or ``count`` is below 1.

    Example:
        >>> flat = SpectralResponse(np.array([400e-9, 500e-9]), np.ones((1, 2)), ("Y",), "flat")
        >>> [(round(line.wavelength_m * 1e9), round(line.weight, 3)) for line in shared_lines(flat, 2)]
        [(425, 0.5), (475, 0.5)]
    """
    quantile_lines(response, 1)  # refuses channels without weight
    if count < 1:
        raise InputError("shared_wavelengths", f"got {count}, expected a whole number from 1")
    at = response.wavelengths_m
    fine = np.linspace(at[0], at[-1], 200 * len(at))
    photons = np.array([np.interp(fine, at, weights) for weights in response.weights])
    photons /= photons.sum(1, keepdims=True)
    part = np.minimum((np.cumsum(photons.mean(0)) * count * (1 - 1e-12)).astype(int), count - 1)
    lines = []
    for number in range(count):
        inside = photons[:, part == number]
        wavelength_m = float(inside.sum(0) @ fine[part == number] / inside.sum())
        lines += [Line(channel, wavelength_m, float(share)) for channel, share in enumerate(inside.sum(1)) if share > 0]
    return lines


def _centroids(wavelengths_m: NDArray[np.float64], weights: NDArray[np.float64], parts: int) -> NDArray[np.float64]:
    """Split the weights, linear between samples, into equal parts and return the mean wavelength of each."""
    fine = np.linspace(wavelengths_m[0], wavelengths_m[-1], 200 * len(wavelengths_m))
    density = np.interp(fine, wavelengths_m, weights)
    photons = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2)])
    moment = np.concatenate([[0.0], np.cumsum((density * fine)[1:] + (density * fine)[:-1]) / 2])
    edges = np.linspace(0, photons[-1], parts + 1)
    # photons may stand still where the response is zero: interpolate on its strictly increasing part.
    rising = np.concatenate([[True], np.diff(photons) > 0])
    moments = np.interp(edges, photons[rising], moment[rising])
    return np.diff(moments) / np.diff(edges)


def check_materials(response: SpectralResponse, lines: Iterable[Line], materials: Iterable[Refractive]) -> None:
    """Refuse materials that are not known at a wavelength that the camera sees.

    Args:
        response: the camera under its light, for the message.
        lines: from :func:`quantile_lines` of it.
        materials: of the mask and of the layers.

    Raises:
        InputError: naming the channel, the light and the material.
    """
    for material in materials:
        for line in lines:
            try:
                material.index(line.wavelength_m)
            except InputError as error:
                raise InputError(
                    "psf.wavelengths_per_channel",
                    f"channel {response.channels[line.channel]!r} of {response.label} needs "
                    f"{line.wavelength_m / NM:.1f} nm (fewer lines lie closer together): {error}",
                ) from error


# ---- electrons per lux

LUMENS_PER_WATT = 683.0
"""K_cd, the luminous efficacy at 540 THz by which the candela is defined (BIPM, The International System of Units, 2019)."""
OBSERVER = "CIE 1924 Photopic Standard Observer"


def electron_rates(camera: str, illuminant: str | Sequence[Led], base_dir: Path | None = None) -> dict[str, float]:
    """Return how many electrons a white surface gives in each channel.

    The surface is Lambertian and reflects all light; lit by E lux, its spectral radiance L has 683 lm/W times the integral of
    L V = E / pi, V being the standard observer's photopic efficiency. A channel counts the integral of L l / (h c) q, q its
    quantum efficiency: the response divided by the greatest value of all channels' responses, so that it peaks at 1.

    Args:
        camera: a name or file for `simulator.optics.spectra.camera_curves`; its curves are quantum efficiencies with their
            colour filters, up to one factor that all share (published sets often scale every channel to 1).
        illuminant: a name, file or LEDs for `simulator.optics.spectra.illuminant_curve`.
        base_dir: folder from which relative paths are taken.

    Returns:
        By channel: electrons per second, square metre of sensor, steradian and lux, for a peak quantum efficiency of 1.

    Raises:
        InputError: for unknown names or bad files, or a light that the eye does not see.
    """
    from scipy.constants import c, h

    response, light = spectral_response(camera, illuminant, base_dir), illuminant_curve(illuminant, base_dir)
    lumens = LUMENS_PER_WATT * _seen_by_the_eye(light)
    if not lumens > 0:
        raise InputError(
            "camera.exposure.illuminance_lux",
            f"the eye does not see the light {light.label}; give camera.exposure.full_scale",
        )
    electrons = np.trapezoid(response.weights, response.wavelengths_m) / (h * c)
    peak = camera_curves(camera, base_dir).values.max()
    return dict(zip(response.channels, (electrons / peak / lumens / np.pi).tolist(), strict=True))


def _seen_by_the_eye(light: SpectralCurves) -> float:
    """Return the integral of the light times the standard observer's efficiency, as tabled for each nanometre."""
    from colour import SDS_LEFS

    observer = SDS_LEFS[OBSERVER]
    step_m = min(NM, float(np.diff(light.wavelengths_m).min()))
    first, last = light.wavelengths_m[[0, -1]]
    wavelengths_m: NDArray[np.float64] = np.linspace(first, last, int(np.ceil((last - first) / step_m)) + 1)
    efficiency = np.interp(wavelengths_m, observer.wavelengths * NM, observer.values, left=0, right=0)
    return float(np.trapezoid(light.at(wavelengths_m)[0] * efficiency, wavelengths_m))
