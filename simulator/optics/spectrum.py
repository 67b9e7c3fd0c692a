"""Spectral responses of cameras and the few wavelengths that stand for them.

Curves come through colour-science, imported on use because it takes a second.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.types import SpectralResponse

# No curves are published here for the IMX183: this measured DSLR set is the labelled stand-in.
NOMINAL_CAMERA = "Nikon 5100 (NPL)"
CHANNELS = ("R", "G", "B")


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


def spectral_response(camera: str = NOMINAL_CAMERA, illuminant: str = "D65") -> SpectralResponse:
    """Return the photon weights of a camera's R, G and B under an illuminant.

    w_c(l) = illuminant(l) x response_c(l) x l, because sensors count photons and illuminants are given as power.

    Args:
        camera: a name of colour-science's ``MSDS_CAMERA_SENSITIVITIES``.
        illuminant: a name of colour-science's ``SDS_ILLUMINANTS``, such as ``D65`` or ``E``.

    Raises:
        InputError: for unknown names; the message lists the known ones.
    """
    from colour import MSDS_CAMERA_SENSITIVITIES, SDS_ILLUMINANTS, SpectralShape

    for argument, name, table in (
        ("spectral_response", camera, MSDS_CAMERA_SENSITIVITIES),
        ("illuminant", illuminant, SDS_ILLUMINANTS),
    ):
        if name not in table:
            msg = f"{argument}: got {name!r}, expected one of {', '.join(sorted(table))}"
            raise InputError(msg)
    curves = MSDS_CAMERA_SENSITIVITIES[camera].copy()
    shape = SpectralShape(curves.shape.start, curves.shape.end, 1)
    sensitivity = np.clip(curves.align(shape).values.T, 0, None)
    power = SDS_ILLUMINANTS[illuminant].copy().align(shape).values
    wavelengths_m = np.asarray(shape.wavelengths, np.float64) * 1e-9
    label = f"{camera} under {illuminant}" + (", nominal" if camera == NOMINAL_CAMERA else "")
    return SpectralResponse(wavelengths_m, sensitivity * power * wavelengths_m, CHANNELS, label)


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
