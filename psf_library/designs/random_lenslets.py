"""Random lenslets: a jumble of small lenses, each of which makes a bright dot (Kuo et al., Opt. Express 28, 8384, 2020)."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from simulator.arrays import samples_across
from simulator.design.patterns import poisson_disc, sample_positions_m
from simulator.optics.mask import Mask
from simulator.optics.materials import load_material


def random_lenslets(
    *,
    width_mm: Annotated[float, Field(gt=0.01, le=20)] = 3.0,
    pixel_um: Annotated[float, Field(ge=0.1, le=20)] = 2.0,
    distance_um: Annotated[float, Field(gt=50, le=1e5)] = 1900.0,
    spacing_um: Annotated[float, Field(gt=1, le=5000)] = 160.0,
    nearest_cm: Annotated[float, Field(gt=0.1, le=1e4)] | None = None,
    wavelength_nm: Annotated[float, Field(ge=300, le=2000)] = 532.0,
    material: str = "fused-silica",
    seed: Annotated[int, Field(ge=0)] = 1,
) -> Mask:
    """Return the upper envelope of spherical caps at random places; its PSF is a random set of sharp dots.

    The sensor lies at ``distance_um``. Every cap has the radius of curvature (n - 1) f, and where caps meet the higher one
    wins, so lenslets of one focal length divide the mask into the Voronoi cells of their centres (Kuo et al.). A lenslet
    of diameter D makes a dot about lambda f / D wide. With ``nearest_cm`` the focal lengths differ: each lenslet is sharp
    for one depth z, 1/f = 1/distance + 1/z with 1/z evenly spread from 0 to 1/nearest, so that some dots are sharp at any
    depth (Yanny et al., Light Sci. Appl. 9, 171, 2020).

    The centres are a Poisson-disc pattern, as dense as it gets: no two nearer than ``spacing_um``, no gap in which another
    would fit. Cells therefore reach no farther than that from their centre, and the smooth profile needs pixel <=
    lambda f / (2 spacing).

    Args:
        width_mm: side of the square mask.
        pixel_um: sample of the height map.
        distance_um: mask to sensor, where distant objects are in focus.
        spacing_um: least distance between the centres of two lenslets.
        nearest_cm: depth down to which focal lengths are spread; null gives all lenslets one focal length.
        wavelength_nm: design wavelength.
        material: of the lenslets.
        seed: of the places and the focal lengths.
    """
    samples = samples_across(width_mm * 1e3, pixel_um)
    pitch_m, glass = pixel_um * 1e-6, load_material(material)
    centres_m, focal_m = lenslets(width_mm * 1e-3, spacing_um * 1e-6, distance_um * 1e-6, nearest_cm, seed)
    radius_m = focal_m * glass.refractivity(wavelength_nm * 1e-9)
    x = sample_positions_m(samples, pitch_m)
    height_m = np.full((samples, samples), -np.inf, np.float32)
    # A cap is drawn as far as it can win: every place has a centre within the spacing, and a flatter cap falls more slowly.
    reach_m = 1.1 * spacing_um * 1e-6 * float(np.sqrt(radius_m.max() / radius_m.min()))
    for (centre_x, centre_y), radius in zip(centres_m, radius_m, strict=True):
        rows, columns = (
            slice(*np.searchsorted(x, (centre - reach_m, centre + reach_m))) for centre in (centre_y, centre_x)
        )
        r_squared = (x[rows, None] - centre_y) ** 2 + (x[None, columns] - centre_x) ** 2
        cap = -r_squared / (radius + np.sqrt(np.clip(radius**2 - r_squared, 0, None)))
        np.maximum(height_m[rows, columns], cap, out=height_m[rows, columns], casting="same_kind")
    height_m -= height_m.min()
    return Mask(height_m, np.ones_like(height_m), pitch_m, glass, profile="smooth", name="random_lenslets")


def lenslets(
    width_m: float, spacing_m: float, distance_m: float, nearest_cm: float | None, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the centres ``(N, 2)`` as x, y from the mask's middle, metres, and the focal lengths ``(N,)``, metres."""
    centres_m = (poisson_disc(width_m / spacing_m, seed) - width_m / spacing_m / 2) * spacing_m
    disparity = np.zeros(len(centres_m))
    if nearest_cm is not None:
        spread = (np.arange(len(centres_m)) + 0.5) / len(centres_m)
        disparity = np.random.default_rng([seed, 1]).permutation(spread) / (nearest_cm * 1e-2)
    return centres_m, 1 / (1 / distance_m + disparity)
