"""How the things of the activity family look: skin, sleeves, tables, walls, the handled thing, grains."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.acting.hand import CUFF_ROW_SHARE, HandLook
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
    """What is drawn of looks; `paint` makes the materials.

    Attributes:
        background: number in `BACKGROUNDS`.
        skin: number of the tone, light to dark.
        hand_size: 1 is an adult's hand of 0.19 m.
        hand_slim: thickness over that of the model.
        sleeved: whether a sleeve covers the arm.
        seed: of colours and patterns.
    """

    background: int
    skin: int
    hand_size: float
    hand_slim: float
    sleeved: bool
    seed: int


@dataclass(frozen=True)
class Paint:
    """Materials; ``repeats`` are textures per metre of table and wall."""

    table: Material
    wall: Material
    repeats: tuple[float, float]
    hand: HandLook
    thing: Material
    grains: Material


def draw_looks(rng: np.random.Generator) -> Looks:
    """Draw all looks; painting, which costs more, is left for when they are seen."""
    return Looks(
        background=int(rng.integers(len(BACKGROUNDS))),
        skin=int(rng.integers(SKINS)),
        hand_size=float(rng.uniform(0.9, 1.04)),
        hand_slim=float(rng.uniform(0.9, 1.06)),
        sleeved=bool(rng.random() < 0.5),
        seed=int(rng.integers(2**32)),
    )


def paint(looks: Looks) -> Paint:
    """Make the materials of looks."""
    rng = np.random.default_rng(looks.seed)
    theme = draw_theme(rng)
    table_number, wall_number = divmod(looks.background, len(_WALLS))
    table_kind, wall_kind = tuple(_TABLES)[table_number], tuple(_WALLS)[wall_number]
    hue, saturation, contrast = _TABLES[table_kind]
    hues = theme if hue is None else np.full(4, hue)
    ramp = draw_ramp(rng, hues, saturation=saturation) * (0.3 if table_kind == "dark" else 0.8)
    table = _flattened(draw_reflectance(rng, ramp, _SIZE), rng.uniform(*contrast))
    paper = draw_reflectance(rng, 0.85 * draw_ramp(rng, theme, saturation=(0.0, 0.4)), _SIZE)
    thing = draw_reflectance(rng, draw_ramp(rng, draw_theme(rng)), _SIZE)
    grain = draw_reflectance(rng, draw_ramp(rng, draw_theme(rng)), _SIZE)
    coarse = slice(None, None, _SIZE // _GRAIN_SIZE)
    return Paint(
        table=Material(table),
        wall=Material(_flattened(paper, rng.uniform(*_WALLS[wall_kind]))),
        repeats=(float(rng.uniform(1.5, 4)), float(rng.uniform(1.0, 3))),
        hand=_paint_hand(looks, theme, rng),
        thing=Material(thing, float(rng.uniform(0.25, 0.6))),
        grains=Material(np.ascontiguousarray(grain[coarse, coarse])),
    )


def _flattened(reflectance: NDArray[np.float32], contrast: float) -> NDArray[np.float32]:
    mean = reflectance.mean(axis=(0, 1))
    return mean + np.float32(contrast) * (reflectance - mean)


def _paint_hand(looks: Looks, theme: Array, rng: np.random.Generator) -> HandLook:
    """Paint skin near a tone of the scale, blotched faintly, and a striped sleeve."""
    tones = skin_tones()
    other = int(np.clip(looks.skin + rng.choice([-1, 1]), 0, SKINS - 1))
    tone = tones[looks.skin] + 0.35 * rng.random() * (tones[other] - tones[looks.skin])
    blotches = np.roll(_blotches(), tuple(rng.integers(_SKIN_SIZE, size=2)), axis=(0, 1))
    texture = tone * (1 + 0.25 * (blotches - 0.5))[..., np.newaxis]
    if looks.sleeved:
        ramp = draw_ramp(rng, theme)
        cuff = int(CUFF_ROW_SHARE * _SKIN_SIZE)
        stripes = 0.5 * rng.random() * rng.random((cuff, 1, 1))
        texture[:cuff] = ramp[0] + stripes * (ramp[-1] - ramp[0])
    material = Material(np.clip(texture, 0.01, 0.9).astype(np.float32))
    sleeve_m = 0.005 if looks.sleeved else 0.0
    return HandLook(material, looks.hand_size, looks.hand_slim, sleeve_m=sleeve_m)


@functools.cache
def skin_tones() -> Array:
    """Return linear RGB ``(10, 3)``: the scale, a little redder, as blood makes hands, than its swatches."""
    swatches = np.array([[int(tone[i : i + 2], 16) for i in (0, 2, 4)] for tone in _MONK.split()]) / 255
    return np.asarray(srgb_to_linear(swatches), dtype=float) * (0.92, 0.78, 0.70)


@functools.cache
def _blotches() -> Array:
    return clouds(_SKIN_SIZE, np.random.default_rng(20260107), slope=1.2)
