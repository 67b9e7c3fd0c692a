"""Where the light of a point source goes behind a mask, and how fine and wide a grid it needs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from simulator.arrays import number
from simulator.optics.fine_mask import TAPER, Band, FineGrid, fine_grid
from simulator.optics.illumination import Source
from simulator.optics.kernel import kernel_reach_m
from simulator.optics.layers import Strata, gap_strata
from simulator.optics.mask import Mask
from simulator.optics.propagation import MAX_SINE
from simulator.optics.steepness import followed_frequency
from simulator.optics.transfer import band_edge_m
from simulator.types import CameraGeometry

# As kernel.ORDERS. More orders need a finer grid here, and the pixel's sinc vanishes at one: 1.2 would take half as long
# again for 0.4 % more of a PhlatCam's light.
ORDERS = 1.0


@dataclass(frozen=True)
class Plan:
    """Where the light of one source goes and the grid that holds it.

    Attributes:
        source: the point source.
        gap: layers between mask and sensor.
        band: what is followed of the mask.
        travel_m: how far sideways light travels beyond its carrier, metres: the margin on each side of the mask.
        limited: whether steeper light exists and must be cut softly.
    """

    source: Source
    gap: Strata
    band: Band
    travel_m: float
    limited: bool

    def grid(self, mask: Mask, oversampling: int) -> FineGrid:
        """Return the grid that this source needs."""
        factor = oversampling if mask.profile == "smooth" else 1
        shape = (mask.shape[0] * factor, mask.shape[1] * factor)
        half_width = max(mask.shape) * mask.pitch_m / 2 + self.band.tail_m
        residual = self.source.residual_band(half_width)
        return fine_grid(shape, mask.pitch_m / factor, self.band, residual, self.travel_m)


def plan(mask: Mask, camera: CameraGeometry, oversampling: int, source: Source) -> Plan:
    """Return where the light of a source goes behind a mask."""
    wavelength_m, gap = source.wavelength_m, gap_strata(camera, source.wavelength_m)
    band = mask_band(mask, wavelength_m, sum(number(t) for t, _ in gap), oversampling)
    half_width = max(mask.shape) * mask.pitch_m / 2 + band.tail_m
    steepest = wavelength_m * (band.end + source.residual_band(half_width))
    # A smooth mask's corner frequencies carry light; a staircase's lie in the dark corners of two sincs.
    travel_m, limited = _travel(gap, source.carrier, steepest, corners=band.pixel_m == 0)
    if limited or band.end > band.full:
        # The cut fades over this width inwards: it begins where the light that is followed ends.
        edge_m = band_edge_m(wavelength_m, sum(number(t) for t, _ in gap))
        return Plan(source, gap, band, travel_m + edge_m, True)
    return Plan(source, gap, band, travel_m, False)


def mask_band(mask: Mask, wavelength_m: float, distance_m: float, oversampling: int) -> Band:
    """Return what is followed of a mask: so many diffraction orders of a staircase, a smooth mask's own band."""
    steepest = MAX_SINE / wavelength_m
    if mask.profile == "staircase":
        reach_m = kernel_reach_m(mask.pitch_m, wavelength_m, distance_m, ORDERS, oversampling)
        end = reach_m / math.hypot(reach_m, distance_m) / wavelength_m
        return Band(TAPER * end, end, mask.pitch_m)
    own = followed_frequency(mask, wavelength_m, oversampling)
    if oversampling == 1 and own <= steepest:
        return Band(own, own, 0.0)
    finer = oversampling / (2 * mask.pitch_m)
    return Band(min(own, TAPER * steepest), min(1.25 * own, steepest, finer), 0.0)


def offset_m(camera: CameraGeometry, source: Source) -> tuple[float, float]:
    """Return where (x, y; metres) a convolution puts a PSF's centre, seen from where the ray through the mask's centre lands.

    A convolution knows one distance in air; behind glass, oblique rays land elsewhere.
    """
    placed = -np.array(source.direction) * number(camera.mask_to_sensor_m)
    x, y = placed - _landing(gap_strata(camera, source.wavelength_m), np.array(source.carrier))
    return float(x), float(y)


def _travel(gap: Strata, carrier: tuple[float, float], steepest: float, *, corners: bool) -> tuple[float, bool]:
    """Return how far (metres, per axis) light within ``steepest`` of the carrier travels beyond it, and if steeper is cut."""
    straight = _landing(gap, np.array(carrier))
    farthest, limited = 0.0, False
    other = (-steepest, steepest) if corners else (0.0,)
    for offset in [(a, b) for a in (-steepest, steepest) for b in other] + [
        (b, a) for a in (-steepest, steepest) for b in other
    ]:
        sine = np.array(carrier) + offset
        length = float(np.hypot(*sine))
        limit = MAX_SINE * min(index for _, index in gap)
        if length > limit:
            sine, limited = sine * (limit / length), True
        farthest = max(farthest, float(np.abs(_landing(gap, sine) - straight).max()))
    return farthest, limited or not corners


def _landing(gap: Strata, sine: np.ndarray) -> np.ndarray:
    """Return where (x, y; metres) a ray through the mask's centre meets the sensor."""
    total = np.zeros(2)
    for thickness_m, index in gap:
        total += number(thickness_m) * sine / math.sqrt(index**2 - float(sine @ sine))
    return total
