"""Spectral responses of cameras under a light, and the few wavelengths that stand for them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.tables import NM
from simulator.optics.curves import Led, camera_curves, illuminant_curve
from simulator.types import Refractive, SpectralResponse

# No curves are published here for the IMX183: this measured DSLR set is the labelled stand-in.
NOMINAL_CAMERA = "Nikon 5100 (NPL)"
_FINEST_M = 0.1e-9


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


def spectral_response(
    camera: str = NOMINAL_CAMERA, illuminant: str | Sequence[Led] = "D65", base_dir: Path | None = None
) -> SpectralResponse:
    """Return the photon weights of a camera's channels under an illuminant.

    w_c(l) = illuminant(l) x response_c(l) x l, because sensors count photons and illuminants are given as power.

    Args:
        camera: a name or file for :func:`simulator.optics.curves.camera_curves`.
        illuminant: a name, file or LEDs for :func:`simulator.optics.curves.illuminant_curve`.
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
        msg = (
            f"{label}: the camera's curves go from {_span(curves.wavelengths_m)}, the light's from "
            f"{_span(light.wavelengths_m)}; they have no wavelength in common (does a header say the right unit?)"
        )
        raise InputError(msg)
    step_m = min(NM, max(_FINEST_M, float(np.diff(light.wavelengths_m).min())))
    wavelengths_m = np.linspace(low, high, int(np.ceil((high - low) / step_m - 1e-6)) + 1)
    weights = curves.at(wavelengths_m) * light.at(wavelengths_m) * wavelengths_m
    return SpectralResponse(wavelengths_m, weights, curves.channels, label)


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
                msg = (
                    f"channel {response.channels[line.channel]!r} of {response.label} needs {line.wavelength_m / NM:.1f} nm "
                    f"(fewer psf.wavelengths_per_channel lie closer together): {error}"
                )
                raise InputError(msg) from error


def quantile_lines(response: SpectralResponse, per_channel: int) -> list[Line]:
    """Return ``per_channel`` lines per channel, each the centroid of an equal share of the channel's photons.

    Args:
        response: photon weights per channel.
        per_channel: number of lines per channel, from 1.

    Raises:
        InputError: when a channel has no weight or ``per_channel`` is below 1.
    """
    if per_channel < 1:
        msg = f"wavelengths_per_channel: got {per_channel}, expected a whole number from 1"
        raise InputError(msg)
    lines = []
    for channel, weights in enumerate(response.weights):
        if not weights.sum() > 0:
            msg = (
                f"channel {response.channels[channel]!r} of the spectral response {response.label!r} is zero everywhere"
            )
            raise InputError(msg)
        for wavelength_m in _centroids(response.wavelengths_m, weights, per_channel):
            lines.append(Line(channel, float(wavelength_m), 1 / per_channel))
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


def _span(wavelengths_m: NDArray[np.float64]) -> str:
    return f"{wavelengths_m[0] / NM:g} to {wavelengths_m[-1] / NM:g} nm"
