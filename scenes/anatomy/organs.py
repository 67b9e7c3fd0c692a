"""Colon, small intestine and stomach: walls of anatomical size with the folds by which each is known."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.anatomy.lumen import Course, Wall, closing, draw_course, fold_rows, relief, sweep

Array = NDArray[np.float64]

BEHIND_M = -2e-3
"""Where walls begin: the lamps of an endoscope shine forwards, so what lies behind its tip takes no part in the light."""


@dataclass(frozen=True)
class Organ:
    """A hollow organ.

    Attributes:
        draw: ``draw(reach_m, bend, rng)`` returns a wall whose lumen is ``reach_m`` long from arc length 0; ``bend`` is that
            of `scenes.anatomy.lumen.draw_course`. A straight one holds all its wall within ``reach_m``.
        narrowest_m: the wall of a straight one comes no nearer to the centreline, before its end closes.
        loose_m: how far from the centreline the camera may be.
        shortest_m: least length of lumen that shows what the organ is.
        longest_m: how far light and bends let one see.
    """

    draw: Callable[[float, float, np.random.Generator], Wall]
    narrowest_m: float
    loose_m: float
    shortest_m: float
    longest_m: float


def draw_colon(reach_m: float, bend: float, rng: np.random.Generator) -> Wall:
    """Draw a colon, 3.4 to 5.4 cm wide, with haustra.

    Its three taeniae hold the wall in; between them semilunar folds reach up to two fifths of the radius into the lumen,
    each third of a fold with a height and place of its own, so that the opening is a triangle with corners at the taeniae.
    """
    radius = rng.uniform(0.017, 0.027)
    course = draw_course(BEHIND_M, reach_m, 1.5 * radius, bend, rng)
    folds = _places(BEHIND_M, reach_m, radius * rng.uniform(0.6, 1.05), 0.2, rng)
    fold, arc, follows = fold_rows(folds, 12)
    columns = 72
    angle = 2 * math.pi * np.arange(columns) / columns
    taenia = rng.uniform(0, 2 * math.pi)
    third = ((angle - taenia) / (2 * math.pi / 3)).astype(int) % 3
    between = np.abs(np.sin(1.5 * (angle - taenia)))  # 0 at a taenia, 1 midway to the next
    deepest = radius * rng.uniform(0.25, 0.4)
    size = deepest * np.where(rng.random((len(folds), 3)) < 0.12, 0.2, rng.uniform(0.55, 1, (len(folds), 3)))
    height = size[:, third] * between**0.8
    shift = (np.gradient(folds)[:, np.newaxis] * rng.uniform(-0.22, 0.22, (len(folds), 3)))[:, third] * between**0.5
    ridge = _ridge(arc - folds[fold], rng.uniform(0.0025, 0.0038))
    inwards = height[fold] * ridge[:, np.newaxis]
    place = arc[:, np.newaxis] + shift[fold] * follows[:, np.newaxis] + rng.uniform(-0.4, 0.4) * inwards
    swell = 1 + 0.06 * np.sin(2 * math.pi * arc / rng.uniform(0.05, 0.12) + rng.uniform(0, 6))
    lobes = 1 - 0.05 * np.cos(3 * (angle - taenia))
    inwards = inwards + 0.0016 * relief(place, 0.11, rng) + _wet(place, 0.0005, rng) + _polyp(arc, angle, radius, rng)
    outline = radius * swell[:, np.newaxis] * lobes - inwards
    return _swept(course, place, outline, radius, tile_m=math.pi * radius, tiles_around=2)


def draw_small_intestine(reach_m: float, bend: float, rng: np.random.Generator) -> Wall:
    """Draw a stretched small intestine, 2.4 to 3 cm wide, with circular folds (plicae) every 5 to 8 mm."""
    radius = rng.uniform(0.012, 0.015)
    course = draw_course(BEHIND_M, reach_m, 1.6 * radius, bend, rng)
    folds = _places(BEHIND_M, reach_m, rng.uniform(0.005, 0.008), 0.15, rng)
    fold, arc, follows = fold_rows(folds, 7)
    columns = 52
    angle = 2 * math.pi * np.arange(columns) / columns
    count = (len(folds), 1)
    turns = [np.cos(waves * angle + rng.uniform(0, 2 * math.pi, count)) for waves in (1, 2, 3, 5)]
    # Few plicae go all the way around: each fades where it ends.
    height = rng.uniform(0.0024, 0.0038) * np.clip(0.75 + 0.45 * turns[0] + 0.3 * turns[1] + 0.2 * turns[3], 0.05, 1)
    shift = rng.uniform(0.08, 0.16) * np.gradient(folds)[:, np.newaxis] * (turns[1] + turns[2] + 0.5 * turns[3])
    ridge = _ridge(arc - folds[fold], rng.uniform(0.0009, 0.0013))
    inwards = height[fold] * ridge[:, np.newaxis]
    place = arc[:, np.newaxis] + shift[fold] * follows[:, np.newaxis] + rng.uniform(-0.5, 0.5) * inwards
    swell = 1 + 0.06 * np.sin(2 * math.pi * arc / rng.uniform(0.03, 0.08) + rng.uniform(0, 6))
    inwards = inwards + 0.0006 * relief(place, 0.05, rng) + _wet(place, 0.0003, rng)
    return _swept(
        course, place, radius * swell[:, np.newaxis] - inwards, radius, tile_m=2 * math.pi * radius, tiles_around=1
    )


def draw_stomach(reach_m: float, bend: float, rng: np.random.Generator) -> Wall:
    """Draw a stomach, 6 to 9 cm wide, with rugae: thick folds that wind along it, fork, and fade towards the antrum."""
    widest = min(rng.uniform(0.03, 0.045), 0.45 * reach_m)
    course = draw_course(BEHIND_M, reach_m, 1.35 * widest, bend, rng)
    columns = 132
    arc = np.linspace(BEHIND_M, reach_m, math.ceil((reach_m - BEHIND_M) / 0.0022))
    angle = 2 * math.pi * np.arange(columns) / columns
    place = np.repeat(arc[:, np.newaxis], columns, axis=1)
    along = (arc / reach_m)[:, np.newaxis]
    count = round(2 * math.pi * widest / rng.uniform(0.010, 0.014))
    bends = sum(
        rng.uniform(0.4, 1.0) * np.sin(2 * math.pi * place / rng.uniform(0.02, 0.06) + waves * angle + phase)
        for waves, phase in zip((1, 2, 3), rng.uniform(0, 2 * math.pi, 3), strict=True)
    )
    rugae = [
        np.abs(np.sin(0.5 * (number * angle + bends + phase))) ** 0.8
        for number, phase in ((count, 0.0), (count - 4, 2))
    ]
    chosen = np.clip(
        0.5 + 3 * relief(place, 0.1, rng), 0, 1
    )  # where the one pattern gives way to the other, rugae fork
    strength = np.clip(1.3 - np.clip(along, 0, 1), 0, 1) * (0.8 + 0.8 * relief(place, 0.16, rng))
    height = rng.uniform(0.005, 0.010) * strength * (chosen * rugae[0] + (1 - chosen) * rugae[1])
    flat = 1 + rng.uniform(0.03, 0.1) * np.cos(2 * angle + rng.uniform(0, 6))
    body = 1 - rng.uniform(0.25, 0.5) * np.clip(along, 0, 1)
    outline = widest * body * flat - height - 0.004 * relief(place, 0.2, rng) - _wet(place, 0.0010, rng)
    return _swept(course, place, outline, widest, tile_m=2 * math.pi / 3 * widest, tiles_around=3)


ORGANS = {
    "colon": Organ(draw_colon, 0.0085, 0.006, 0.05, 0.12),
    "small_intestine": Organ(draw_small_intestine, 0.0070, 0.004, 0.04, 0.10),
    "stomach": Organ(draw_stomach, 0.0110, 0.016, 0.07, 0.12),
}
"""The organs by the name that becomes a clip's label."""


def _swept(course: Course, place: Array, outline: Array, radius: float, *, tile_m: float, tiles_around: int) -> Wall:
    end = course.end_m
    place = np.clip(place, course.start_m, end)
    place[-1] = end
    outline = np.maximum(outline, 0) * closing(place, end, min(1.3 * radius, 0.45 * end))
    return sweep(course, place, outline, tile_m=tile_m, tiles_around=tiles_around)


def _places(start_m: float, end_m: float, gap_m: float, jitter: float, rng: np.random.Generator) -> Array:
    """Return arc lengths about ``gap_m`` apart, at least 2."""
    count = max(2, round((end_m - start_m) / gap_m))
    gap = (end_m - start_m) / count
    return start_m + gap * (np.arange(count) + 0.5 + rng.uniform(-jitter, jitter, count))


def _wet(place: Array, height_m: float, rng: np.random.Generator) -> Array:
    """Return the fine unevenness that breaks the highlights on a wet wall into glints."""
    return height_m * rng.uniform(0.5, 1.3) * relief(place, 0.03, rng, fine=True)


def _ridge(away_m: Array, half_width_m: float) -> Array:
    """Return the height of a fold beside its crest, 1 at the crest: steeper and blunter than a Gaussian."""
    return np.exp(-(np.abs(away_m / half_width_m) ** 2.5))


def _polyp(arc: Array, angle: Array, radius: float, rng: np.random.Generator) -> Array:
    """Return the height of a polyp on the wall, 6 to 12 mm wide, in one colon of three; else of none."""
    size, centre, side = rng.uniform(0.003, 0.006), rng.uniform(0.02, 0.06), rng.uniform(0, 2 * math.pi)
    present = rng.random() < 1 / 3
    around = radius * ((angle - side + math.pi) % (2 * math.pi) - math.pi)
    away = ((arc - centre)[:, np.newaxis] ** 2 + around**2) / size**2
    return 1.2 * size * present * np.exp(-(away**1.5))
