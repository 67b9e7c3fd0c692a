"""The lining of hollow organs as textures: pink to orange, low in contrast, with branching vessels under it.

Vessels and clouds come from pools that are made once per process with a fixed seed, as in `scenes.textures`; each scene
colours them anew. What lies in the tissue darkens it by Beer-Lambert absorption, so blood looks like blood: it takes green
and blue, hardly any red.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.textures import clouds
from simulator.colour import srgb_to_linear

SIZE = 256
"""Pixels along an edge of a texture; it repeats."""

_POOL_SEED = 20260102
_VARIANTS = 5
_CLOUDS = 4
# Absorption of R, G, B per unit of density: oxygen-rich blood, and veins, which look bluish through the tissue.
_ARTERY = np.array([0.22, 1.0, 0.85])
_VEIN = np.array([0.55, 0.95, 0.55])


@dataclass(frozen=True)
class Lining:
    """How an organ's mucosa looks.

    Attributes:
        colour: mean sRGB, 0..255.
        vessels: optical density of the thickest vessels in green.
        blotches: optical density of the clouds of more and less blood in green.
        stipple: contrast of the finest structure (villi, pits), 0..1.
    """

    colour: tuple[float, float, float]
    vessels: float
    blotches: float
    stipple: float


LININGS = {
    "colon": Lining((172, 112, 97), 0.9, 0.35, 0.05),
    "small_intestine": Lining((174, 118, 96), 0.35, 0.3, 0.22),
    "stomach": Lining((170, 98, 84), 0.4, 0.45, 0.09),
}


def draw_mucosa(organ: str, rng: np.random.Generator) -> NDArray[np.float32]:
    """Draw the lining of a patient's organ (a key of `LININGS`): linear RGB ``(SIZE, SIZE, 3)`` in 0.01..0.9, tileable."""
    lining = LININGS[organ]
    vessels = vessel_pool()[rng.integers(_VARIANTS)]
    slow, fast = _cloud_pool()
    blotches = np.roll(slow[rng.integers(_CLOUDS)], rng.integers(SIZE, size=2), axis=(0, 1))
    stipple = np.roll(fast[rng.integers(_CLOUDS)], rng.integers(SIZE, size=2), axis=(0, 1))
    colour = srgb_to_linear(
        np.clip(np.array(lining.colour) + rng.normal(0, 7) + rng.normal(0, (3, 4, 4)), 40, 245) / 255
    )
    density = lining.vessels * rng.uniform(0.4, 1.3)
    table = np.arange(256) / 255
    blood = rng.uniform(0.5, 1.4) * lining.blotches
    reflectance = np.empty((SIZE, SIZE, 3), np.float32)
    for channel in range(3):
        # Products of exponentials, each a table look-up: far cheaper than exp of every pixel.
        arteries = np.exp(-density * _ARTERY[channel] * table).astype(np.float32)
        veins = np.exp(-0.8 * density * _VEIN[channel] * table).astype(np.float32)
        reddening = (colour[channel] * np.exp(-blood * _ARTERY[channel] * (table - 0.5))).astype(np.float32)
        reflectance[..., channel] = arteries[vessels[0]] * veins[vessels[1]] * reddening[blotches]
    bright = (1 + lining.stipple * rng.uniform(0.6, 1.3) * 2 * (table - 0.5)).astype(np.float32)
    return np.clip(reflectance * bright[stipple][..., np.newaxis], np.float32(0.01), np.float32(0.9))


@functools.cache
def vessel_pool() -> NDArray[np.uint8]:
    """Return ``(N, 2, SIZE, SIZE)`` maps of arteries and veins, 0 (none) to 255; the same in every process."""
    rng = np.random.default_rng(_POOL_SEED)
    return np.stack([[draw_vessels(5, 1.5, rng), draw_vessels(3, 2.2, rng)] for _ in range(_VARIANTS)])


@functools.cache
def _cloud_pool() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Return slow and fine patterns, ``(N, SIZE, SIZE)`` each."""
    rng = np.random.default_rng(_POOL_SEED + 1)
    slow, fast = (np.stack([clouds(SIZE, rng, slope=slope) for _ in range(_CLOUDS)]) for slope in (1.7, 0.55))
    return np.rint(255 * slow).astype(np.uint8), np.rint(255 * fast).astype(np.uint8)


def draw_vessels(trees: int, calibre_px: float, rng: np.random.Generator) -> NDArray[np.uint8]:
    """Draw branching vessels on a torus, ``(SIZE, SIZE)``, 0..255, from some trunks of a radius in pixels.

    A vessel wanders, and forks into two with r0^3 = r1^3 + r2^3 (Murray's law) until it is finer than a third of a pixel;
    each fork is as likely in any stretch of the same length, and thin vessels fork and wander more.
    """
    density = np.zeros((SIZE, SIZE))
    place, heading = rng.uniform(0, SIZE, (trees, 2)), rng.uniform(0, 2 * math.pi, trees)
    calibre, curl = calibre_px * rng.uniform(0.7, 1.0, trees), np.zeros(trees)
    aim = heading  # what a vessel turns back to, so that it does not run in circles
    for _ in range(4 * SIZE):
        if len(place) == 0:
            break
        _stamp(density, place, calibre)
        curl = 0.85 * curl + rng.normal(0, 0.045, len(place)) - 0.004 * (heading - aim)
        heading = heading + curl
        place = place + np.stack([np.sin(heading), np.cos(heading)], 1)
        calibre = calibre * 0.9992
        fork = rng.random(len(place)) < 0.028 / np.sqrt(calibre)
        share, angle = rng.uniform(0.2, 0.5, fork.sum()), rng.uniform(0.35, 0.9, fork.sum())
        side = rng.choice([-1.0, 1.0], fork.sum())
        twig = (calibre[fork] * np.cbrt(share), heading[fork] + side * angle)
        calibre[fork] *= np.cbrt(1 - share)
        heading[fork] -= side * 0.3 * angle
        place, curl = np.concatenate([place, place[fork]]), np.concatenate([curl, np.zeros(len(share))])
        aim = np.concatenate([aim, twig[1]])
        calibre, heading = np.concatenate([calibre, twig[0]]), np.concatenate([heading, twig[1]])
        kept = calibre > 1 / 3
        place, heading, aim, calibre, curl = (state[kept] for state in (place, heading, aim, calibre, curl))
    return np.rint(255 * np.clip(density, 0, 1)).astype(np.uint8)


def _stamp(density: NDArray[np.float64], place: NDArray[np.float64], calibre: NDArray[np.float64]) -> None:
    """Draw a soft dot at each place, as dark as a vessel of this calibre is thick (at most 1); the darkest wins."""
    window = np.arange(-3, 5)
    corner = np.floor(place).astype(np.int64)
    rows, columns = (corner[:, axis, np.newaxis] + window for axis in range(2))
    away = (rows - place[:, :1])[:, :, np.newaxis] ** 2 + (columns - place[:, 1:])[:, np.newaxis, :] ** 2
    width = np.maximum(calibre, 0.7)[:, np.newaxis, np.newaxis]
    dark = np.minimum(calibre / 1.5, 1.0)[:, np.newaxis, np.newaxis] * np.exp(-away / width**2)
    np.maximum.at(density, (rows[:, :, np.newaxis] % SIZE, columns[:, np.newaxis, :] % SIZE), dark)
