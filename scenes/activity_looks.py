"""How the things of the activity family look: skin, sleeves, tables, walls, the handled thing, grains."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.hand import CUFF_ROW_SHARE, HandLook
from scenes.palettes import draw_ramp, draw_theme
from scenes.patterns import clouds
from scenes.textures import draw_reflectance
from simulator.colour import srgb_to_linear
from simulator.render import Material

Array = NDArray[np.float64]
_SIZE = 128
_SKIN_SIZE = 64
_GRAIN_SIZE = 8
# The ten tones of the Monk Skin Tone scale (Monk, 2019), sRGB.
_MONK = "f6ede4 f3e7db f7ead0 eadaba d7bd96 a07e56 825c43 604134 3a312a 292420"
SKINS = len(_MONK.split())
_TABLES = {  # hue in turns (None: the theme's), saturation, contrast of the pattern
    "wood": (0.075, (0.3, 0.6), (0.35, 0.9)),
    "white": (0.1, (0.0, 0.08), (0.05, 0.3)),
    "dark": (0.07, (0.1, 0.5), (0.2, 0.7)),
    "cloth": (None, (0.15, 0.65), (0.4, 1.0)),
    "stone": (0.6, (0.0, 0.12), (0.4, 1.0)),
}
_WALLS = {"plain": (0.03, 0.15), "papered": (0.35, 0.9)}
BACKGROUNDS = tuple(f"{table} table, {wall} wall" for table in _TABLES for wall in _WALLS)
"""Kinds of background."""


@dataclass(frozen=True)
class Looks:
    """Materials; ``background`` and ``skin`` number their kinds, ``repeats`` are textures per metre of table and wall."""

    background: int
    skin: int
    table: Material
    wall: Material
    repeats: tuple[float, float]
    hand: HandLook
    thing: Material
    grains: Material


def draw_looks(rng: np.random.Generator) -> Looks:
    """Draw all looks."""
    theme = draw_theme(rng)
    background = int(rng.integers(len(BACKGROUNDS)))
    table_kind, wall_kind = tuple(_TABLES)[background // len(_WALLS)], tuple(_WALLS)[background % len(_WALLS)]
    hue, saturation, contrast = _TABLES[table_kind]
    hues = theme if hue is None else np.full(4, hue)
    ramp = draw_ramp(rng, hues, saturation=saturation) * (0.3 if table_kind == "dark" else 0.8)
    table = _flattened(draw_reflectance(rng, ramp, _SIZE), rng.uniform(*contrast))
    paper = draw_reflectance(rng, 0.85 * draw_ramp(rng, theme, saturation=(0.0, 0.4)), _SIZE)
    wall = _flattened(paper, rng.uniform(*_WALLS[wall_kind]))
    gloss = float(rng.uniform(0.35, 0.7))
    skin = int(rng.integers(SKINS))
    hand = _draw_hand(skin, theme, rng)
    thing = draw_reflectance(rng, draw_ramp(rng, draw_theme(rng)), _SIZE)
    grain = draw_reflectance(rng, draw_ramp(rng, draw_theme(rng)), _SIZE)[
        :: _SIZE // _GRAIN_SIZE, :: _SIZE // _GRAIN_SIZE
    ]
    return Looks(
        background,
        skin,
        Material(table, gloss),
        Material(wall),
        (float(rng.uniform(1.5, 4)), float(rng.uniform(1.0, 3))),
        hand,
        Material(thing, float(rng.uniform(0.25, 0.6))),
        Material(np.ascontiguousarray(grain)),
    )


def _flattened(reflectance: NDArray[np.float32], contrast: float) -> NDArray[np.float32]:
    mean = reflectance.mean(axis=(0, 1))
    return mean + np.float32(contrast) * (reflectance - mean)


def _draw_hand(skin: int, theme: Array, rng: np.random.Generator) -> HandLook:
    """Draw skin near a tone of the scale, blotched faintly, and for half of the hands a sleeve."""
    tones = skin_tones()
    other = int(np.clip(skin + rng.choice([-1, 1]), 0, SKINS - 1))
    tone = tones[skin] + 0.35 * rng.random() * (tones[other] - tones[skin])
    blotches = _blotches()
    shift = rng.integers(_SKIN_SIZE, size=2)
    texture = tone * (1 + 0.25 * (np.roll(blotches, tuple(shift), axis=(0, 1)) - 0.5))[..., np.newaxis]
    sleeved = bool(rng.random() < 0.5)
    ramp = draw_ramp(rng, theme)
    stripes, strength = rng.random(_SKIN_SIZE), 0.5 * rng.random()
    cuff = int(CUFF_ROW_SHARE * _SKIN_SIZE)
    if sleeved:
        cloth = ramp[0] + strength * stripes[:cuff, np.newaxis] * (ramp[-1] - ramp[0])
        texture[:cuff] = cloth[:, np.newaxis]
    size, slim = 0.9 + 0.14 * rng.random(), 0.9 + 0.16 * rng.random()
    material = Material(np.clip(texture, 0.01, 0.9).astype(np.float32))
    return HandLook(material, float(size), float(slim), left=False, sleeve_m=0.005 if sleeved else 0.0)


@functools.cache
def skin_tones() -> Array:
    """Return linear RGB ``(10, 3)``: the scale, a little redder, as blood makes hands, than its swatches."""
    swatches = np.array([[int(tone[i : i + 2], 16) for i in (0, 2, 4)] for tone in _MONK.split()]) / 255
    return np.asarray(srgb_to_linear(swatches), dtype=float) * (0.92, 0.78, 0.70)


@functools.cache
def _blotches() -> Array:
    return clouds(_SKIN_SIZE, np.random.default_rng(20260107), slope=1.2)
