"""From the brightness of a scene in lux to electrons in a sensor: what makes relative spectra absolute."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from simulator.errors import InputError
from simulator.io.tables import NM
from simulator.optics.curves import Led, SpectralCurves, camera_curves, illuminant_curve
from simulator.optics.spectrum import spectral_response

LUMENS_PER_WATT = 683.0
"""K_cd, the luminous efficacy at 540 THz by which the candela is defined (BIPM, The International System of Units, 2019)."""
OBSERVER = "CIE 1924 Photopic Standard Observer"


def electron_rates(camera: str, illuminant: str | Sequence[Led], base_dir: Path | None = None) -> dict[str, float]:
    """Return how many electrons a white surface gives in each channel.

    The surface is Lambertian and reflects all light; lit by E lux, its spectral radiance L has 683 lm/W times the integral of
    L V = E / pi, V being the standard observer's photopic efficiency. A channel counts the integral of L l / (h c) q, q its
    quantum efficiency: the response divided by the greatest value of all channels' responses, so that it peaks at 1.

    Args:
        camera: a name or file for `simulator.optics.curves.camera_curves`; its curves are quantum efficiencies with their
            colour filters, up to one factor that all share (published sets often scale every channel to 1).
        illuminant: a name, file or LEDs for `simulator.optics.curves.illuminant_curve`.
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
        msg = (
            f"camera.exposure.illuminance_lux: the eye sees nothing of the light {light.label}, which therefore has no lux; "
            "give camera.exposure.full_scale"
        )
        raise InputError(msg)
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
