"""Things to handle and grains to pour, and how these, hands, table and wall look.

A thing is two thin shells that meet along a jagged seam. It stands on its origin: x across, y down (its top at -height), z
deep; metres. The shells are surfaces swept from a profile (radius against height) around half an outline, so that any thing
can be torn in two and any can be poured from.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenes.activity.hand import CUFF_ROW_SHARE, HandLook
from scenes.meshes import UnitMesh, face_cross, grid_faces, smooth_normals, unit
from scenes.textures import clouds, draw_ramp, draw_reflectance, draw_theme
from simulator.colour import srgb_to_linear
from simulator.render import Material

Array = NDArray[np.float64]

# Profiles from the top down: (radius, height) as shares of half the width and of the height; a point twice is a sharp edge.
_SHARP = ((0, 0), (0.5, 0), (1, 0), (1, 0), (1, 0.25), (1, 0.5), (1, 0.75), (1, 1), (1, 1), (0, 1))
_CUP = ((0, 0.92), (0.66, 0.9), (0.8, 0.5), (0.92, 0.03), (0.96, 0), (1, 0.02), (0.94, 0.25), (0.88, 0.5), (0.82, 0.75))
_CUP += ((0.75, 0.98), (0.7, 1), (0, 1))
_BOTTLE = ((0, 0), (0.38, 0), (0.4, 0), (0.4, 0.1), (0.4, 0.1), (0.33, 0.11), (0.34, 0.22), (0.6, 0.32), (0.93, 0.42))
_BOTTLE += ((1, 0.5), (0.97, 0.65), (1, 0.8), (1, 0.96), (0.92, 1), (0, 1))
_BALL = tuple((float(np.sin(a)), float(0.5 - 0.5 * np.cos(a))) for a in np.linspace(0, np.pi, 13))
_SOFT = (
    (0, 0.05),
    (0.35, 0),
    (0.65, 0.03),
    (0.87, 0.14),
    (0.97, 0.3),
    (1, 0.5),
    (1, 0.7),
    (0.95, 0.88),
    (0.84, 1),
    (0, 1),
)
_BRICK = ((0, 1), (0.5, 1), (1, 1), (1, 1), (1, 0.33), (1, -0.33), (1, -1), (1, -1), (0.5, -1), (0, -1))
_ROUND = tuple((float(np.sin(a)), float(np.cos(a))) for a in np.linspace(0, np.pi, 13))
_CUSHION = tuple(
    (float(np.sin(a) ** 0.6), float(np.sign(np.cos(a)) * np.abs(np.round(np.cos(a), 9)) ** 0.6))
    for a in np.linspace(0, np.pi, 13)
)


@dataclass(frozen=True)
class Kind:
    """Profile, half outline (x >= 0, from the far side to the near one) and ranges of width, depth and height in metres.

    ``depth_m`` None is as deep as wide; ``lumps`` is how far, as a share of the width, the surface is dented.
    """

    profile: tuple[tuple[float, float], ...]
    outline: tuple[tuple[float, float], ...]
    width_m: tuple[float, float]
    depth_m: tuple[float, float] | None
    height_m: tuple[float, float] | None
    lumps: float = 0.0


KINDS = {
    "box": Kind(_SHARP, _BRICK, (0.06, 0.09), (0.04, 0.075), (0.08, 0.14)),
    "cup": Kind(_CUP, _ROUND, (0.07, 0.09), None, (0.085, 0.12)),
    "bottle": Kind(_BOTTLE, _ROUND, (0.055, 0.075), None, (0.15, 0.19)),
    "ball": Kind(_BALL, _ROUND, (0.065, 0.09), None, None),
    "card": Kind(_SHARP, _BRICK, (0.075, 0.095), (0.004, 0.012), (0.10, 0.15)),
    "soft": Kind(_SOFT, _CUSHION, (0.07, 0.09), (0.05, 0.075), (0.08, 0.12), 0.035),
}
"""What things there are; a ball's height is its width."""


@dataclass(frozen=True)
class Thing:
    """A thing's kind, sizes in metres, and its two shells: left (x < 0) and right of the seam."""

    kind: str
    width_m: float
    depth_m: float
    height_m: float
    halves: tuple[UnitMesh, UnitMesh]

    @property
    def whole(self) -> UnitMesh:
        """Both shells as one mesh."""
        left, right = self.halves
        return UnitMesh(
            np.concatenate([left.vertices, right.vertices]),
            np.concatenate([left.normals, right.normals]),
            np.concatenate([left.uv, right.uv]),
            np.concatenate([left.faces, right.faces + len(left.vertices)]),
        )

    def share_at(self, height_m: float) -> float:
        """Return the outer half width at a height above the table, as a share of the greatest."""
        profile = np.array(KINDS[self.kind].profile)
        outer = profile[np.argmax(profile[:, 0] >= 1 - 1e-9) if self.kind == "cup" else 0 :]
        return float(np.interp(1 - height_m / self.height_m, outer[:, 1], outer[:, 0]))


def draw_thing(rng: np.random.Generator) -> Thing:
    """Draw a thing; the same number of draws for every kind."""
    name = tuple(KINDS)[rng.integers(len(KINDS))]
    kind = KINDS[name]
    sizes = rng.random(3)
    width = _between(kind.width_m, sizes[0])
    depth = width if kind.depth_m is None else _between(kind.depth_m, sizes[1])
    height = width if kind.height_m is None else _between(kind.height_m, sizes[2])
    seam = 0.09 * rng.uniform(-1, 1, (2, 16))
    waves, phases = rng.normal(0, 2.2, (4, 3)), rng.uniform(0, 2 * np.pi, 4)

    def place(x: Array, y: Array, z: Array) -> Array:
        """Bend the halves' common seam and dent what is soft: one function of place, so that the seam stays closed."""
        near = (1 + z) / 2
        rows = np.linspace(0, 1, seam.shape[1])
        jag = near * np.interp(y, rows, seam[0]) + (1 - near) * np.interp(y, rows, seam[1])
        points = np.stack([x + jag * (1 - np.abs(x)), y, z], axis=-1)
        dent = np.sin(points @ waves.T + phases).mean(axis=-1) * kind.lumps * np.sin(np.pi * np.clip(y, 0, 1)) * 2
        return np.stack([(points[..., 0] + dent) * width / 2, (y - 1) * height, (z + dent) * depth / 2], axis=-1)

    profile, outline = np.array(kind.profile), np.array(kind.outline)
    radius, height_share = profile[:, :1], np.broadcast_to(profile[:, 1:], (len(profile), len(outline)))
    halves = []
    for side in (-1.0, 1.0):
        points = place(side * radius * outline[:, 0], height_share, side * radius * outline[:, 1])
        halves.append(_shell(points, 0.25 - 0.25 * side))
    return Thing(name, width, depth, height, (halves[0], halves[1]))


def _between(ends: tuple[float, float], share: float) -> float:
    return float(ends[0] + share * (ends[1] - ends[0]))


def _shell(points: Array, first_u: float) -> UnitMesh:
    """Triangulate a grid of points; texture coordinates follow its columns and rows."""
    rows, columns = points.shape[:2]
    vertices = points.reshape(-1, 3)
    faces = grid_faces(rows, columns)
    faces = faces[np.linalg.norm(face_cross(vertices, faces), axis=1) > 1e-10]  # edges and poles have empty ones
    across = first_u + 0.5 * np.arange(columns) / (columns - 1)
    down = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(points[:, columns // 2], axis=0), axis=1))])
    uv = np.stack(np.broadcast_arrays(across, (down / down[-1])[:, np.newaxis]), axis=-1).reshape(-1, 2)
    return UnitMesh(vertices, smooth_normals(vertices, faces), uv, faces)


_OCTAHEDRON = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], dtype=float)
_OCTAHEDRON_FACES = np.array([(0, 2, 4), (2, 1, 4), (1, 3, 4), (3, 0, 4), (2, 0, 5), (1, 2, 5), (3, 1, 5), (0, 3, 5)])


def grains_mesh(centres_m: Array, radii_m: Array) -> UnitMesh:
    """Return many small pieces as one mesh in metres, from centres ``(N, 3)`` and radii ``(N,)``."""
    count = len(centres_m)
    vertices = centres_m[:, np.newaxis] + radii_m[:, np.newaxis, np.newaxis] * _OCTAHEDRON
    faces = _OCTAHEDRON_FACES + 6 * np.arange(count)[:, np.newaxis, np.newaxis]
    normals = np.tile(unit(_OCTAHEDRON), (count, 1))
    uv = np.repeat(np.linspace(0, 1, count, endpoint=False), 6)[:, np.newaxis] * (1.0, 7.0)
    return UnitMesh(vertices.reshape(-1, 3), normals, uv, faces.reshape(-1, 3))


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
    companion: Material


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
        companion=Material(draw_reflectance(rng, draw_ramp(rng, draw_theme(rng)), _SIZE)),
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
