"""Spectral rendering: one film that holds any number of wavelength bands, and the colour matching functions for RGB.

In Mitsuba's spectral variants every path carries four wavelengths. A colour that is given as linear sRGB becomes a smooth
spectrum (Jakob and Hanika, "A Low-Dimensional Function Space for Efficient Spectral Upsampling", Computer Graphics Forum
38(2), 2019): a reflectance is that spectrum, a light's radiance that spectrum times CIE D65. It is one of many spectra of
that colour: scenes made so are plausible, not measured.

Scale: a spectrum of 1 at all wavelengths has the luminance 1, as RGB (1, 1, 1) has, so spectral radiance is in units of RGB's
radiance per 106.857 nm (the integral of the luminous efficiency). Light of RGB (1, 1, 1) is D65(wavelength) / 98.997: 1.19 at
460 nm, 0.72 at 700 nm; a white surface in such light from everywhere has the same radiance.
"""

from __future__ import annotations

import functools
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.render.backend import mitsuba

SHORTEST_NM, LONGEST_NM = 360.0, 830.0
"""Where Mitsuba's colour matching functions and its D65 end: beyond them nothing shines."""
_RAMP_NM = 0.25  # half the width of a band's flanks, which overlap their neighbours' so that the sum stays flat
_CIE_Y_NM = 106.856895  # integral of the luminous efficiency, as in Mitsuba
# Linear sRGB (ITU-R BT.709, D65) from CIE XYZ, as in Mitsuba.
_XYZ_TO_RGB = np.array(
    [(3.240479, -1.537150, -0.498535), (-0.969256, 1.875991, 0.041556), (0.055648, -0.204043, 1.057311)]
)
_CURVE_NM = np.linspace(SHORTEST_NM, LONGEST_NM, 95)
# Seven times the four wavelengths of a path, 13 nm apart: albedos come out within 0.001.
_ALBEDO_NM = np.linspace(390, 740, 28).reshape(7, 4)


def check_edges(edges_nm: tuple[float, ...]) -> None:
    """Refuse edges that bound no bands.

    Raises:
        InputError: fewer than two, not increasing, nearer than 1 nm, or beyond what Mitsuba knows light of.
    """
    if len(edges_nm) < 2 or any(not second - first >= 1 for first, second in pairwise(edges_nm)):
        raise InputError(
            "render.bands", f"got edges {list(edges_nm)} nm, expected two or more that increase by at least 1 nm"
        )
    if edges_nm[0] < SHORTEST_NM or edges_nm[-1] > LONGEST_NM:
        raise InputError(
            "render.bands",
            f"got {edges_nm[0]:g} to {edges_nm[-1]:g} nm, expected bands within {SHORTEST_NM:g} to "
            f"{LONGEST_NM:g} nm, where lights and colours are known",
        )


def band_film(edges_nm: tuple[float, ...]) -> dict[str, Any]:
    """Return the channels of a ``specfilm`` as Mitsuba dictionaries: the bands, then X, Y, Z.

    Wavelengths are drawn in proportion to the sum of all curves; half of that weight is the bands', half the colour's.
    """
    channels: dict[str, Any] = {}
    for number, (first, last) in enumerate(pairwise(edges_nm)):
        height = 1 / (last - first)
        nodes = [(first - _RAMP_NM, 0.0), (first + _RAMP_NM, height), (last - _RAMP_NM, height), (last + _RAMP_NM, 0.0)]
        channels[f"band{number:03d}"] = {"type": "spectrum", "value": nodes}
    scale = _colour_scale(len(edges_nm) - 1)
    for name, curve in zip("xyz", _matching_functions().T, strict=True):
        channels[f"colour_{name}"] = {
            "type": "regular",
            "wavelength_min": SHORTEST_NM,
            "wavelength_max": LONGEST_NM,
            "values": ",".join(repr(float(value)) for value in curve * scale),
        }
    return channels


def split_film(image: NDArray[np.float32]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return linear sRGB ``(H, W, 3)`` and the bands' mean spectral radiances ``(H, W, N)`` of a developed film.

    Colours outside of sRGB, and those that the noise of few wavelengths leaves there, have a negative component: it is set to
    zero, since radiance has none.
    """
    count = image.shape[-1] - 3
    xyz = image[..., count:].astype(np.float64) / (_colour_scale(count) * _CIE_Y_NM)
    rgb = (xyz @ _XYZ_TO_RGB.T).astype(np.float32)
    return np.where(rgb < 0, np.float32(0), rgb), np.ascontiguousarray(image[..., :count], dtype=np.float32)


def albedo_of(bsdf: Any, hit: Any, *more: Any) -> Any:
    """Return a surface's diffuse reflectance as linear sRGB, in a spectral variant: its colour under D65.

    Args:
        bsdf: Mitsuba's BSDF.
        hit: the surface interaction.
        more: further arguments of ``eval_diffuse_reflectance``.
    """
    mi = mitsuba()
    rgb = [0.0, 0.0, 0.0]
    for four, weights in zip(_ALBEDO_NM, _albedo_weights(), strict=True):
        hit.wavelengths = mi.Spectrum(four.tolist())
        reflectance = bsdf.eval_diffuse_reflectance(hit, *more)
        for channel in range(3):
            rgb[channel] = sum((float(w) * reflectance[i] for i, w in enumerate(weights[:, channel])), rgb[channel])
    return mi.Color3f(rgb)


def _colour_scale(bands: int) -> float:
    """How the colour curves are scaled: the three together weigh as much as all bands, whose integrals are 1 each."""
    return bands / (3 * _CIE_Y_NM)


@functools.cache
def _matching_functions() -> NDArray[np.float64]:
    """CIE 1931 colour matching functions at ``_CURVE_NM``, ``(95, 3)``."""
    mi = mitsuba()
    return np.array([np.ravel(np.array(mi.cie1931_xyz(float(wavelength)))) for wavelength in _CURVE_NM], np.float64)


@functools.cache
def _albedo_weights() -> NDArray[np.float64]:
    """Weights ``(7, 4, 3)`` of the reflectances at ``_ALBEDO_NM`` in linear sRGB; those of a white surface sum to 1."""
    import colour

    d65 = colour.SDS_ILLUMINANTS["D65"]
    light = np.interp(_ALBEDO_NM.ravel(), d65.wavelengths, d65.values)
    curves = np.stack([np.interp(_ALBEDO_NM.ravel(), _CURVE_NM, curve) for curve in _matching_functions().T], axis=1)
    weights = (curves * light[:, np.newaxis]) @ _XYZ_TO_RGB.T
    return (weights / weights.sum(axis=0)).reshape(*_ALBEDO_NM.shape, 3)
