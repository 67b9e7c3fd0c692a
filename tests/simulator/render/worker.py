"""Scenes whose pictures geometry, radiometry or another variant knows, and the script that renders them.

``worker.py CASES ARGUMENTS... OUT.npz`` with the cases and arguments of a function ``run_CASES`` below: a process keeps to
one Mitsuba variant, so that tests of both run this script. Tests get the scenes as the fixture ``geometry``.
"""

from __future__ import annotations

import importlib
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from scenes.flying_things import draw_scene, flying_things
from simulator.camera.field import FieldOfView
from simulator.camera.forward import ForwardModel
from simulator.optics.stack import PsfStack, depth_planes
from simulator.render import Box, Environment, Material, Renderer, Scene, Sphere, SphereLight, TriangleMesh, activate
from simulator.render.gbuffer import centre_gbuffer
from simulator.render.lensless import lensless_render, shadow_psfs
from simulator.render.mitsuba_scene import load_scene
from simulator.types import Clip, View

Arrays = dict[str, NDArray[Any]]

# --- geometry: G-buffer, motion, layers

VIEW = View((48, 64), 19.2e-6, 1.9e-3, 0.036, 0.2)
EYE = np.eye(3)
UNIFORM = Environment(np.ones(3))
LAMP = SphereLight(np.array([0.4, -0.1, 0.0]), 0.01, np.array([1000.0, 2000.0, 3000.0]))
TEXTURE = np.random.default_rng(0).uniform(0.1, 0.9, (4, 6, 3)).astype(np.float32)
LAYERS = 3


def turned(axis: tuple[float, float, float], angle: float) -> NDArray[np.float64]:
    """Rotation matrix by Rodrigues' formula."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.array([(0, -z, y), (z, 0, -x), (-y, x, 0)])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def plain(red: float, green: float, blue: float) -> Material:
    """A matt surface of one colour."""
    return Material(np.full((2, 2, 3), (red, green, blue), dtype=np.float32))


def sheet(corners: NDArray[np.float64], material: Material) -> TriangleMesh:
    """A plane through four corners, clockwise from the upper left as the camera sees its front."""
    normal = np.cross(corners[3] - corners[0], corners[1] - corners[0])
    return TriangleMesh(
        corners,
        np.tile(normal / np.linalg.norm(normal), (4, 1)),
        np.array([(0.0, 0), (1, 0), (1, 1), (0, 1)]),
        np.array([(0, 2, 1), (0, 3, 2)]),
        material,
    )


def upright(left: float, top: float, right: float, bottom: float, z: float, material: Material) -> TriangleMesh:
    """A plane at depth z, edges in metres."""
    return sheet(np.array([(left, top, z), (right, top, z), (right, bottom, z), (left, bottom, z)]), material)


def solids() -> Scene:
    """A ball, a turned box, a slanted sheet with a texture, and a lamp in the picture."""
    ball = Sphere(np.array([0.012, -0.006, 0.1]), 0.012, plain(0.7, 0.3, 0.1), turned((1, 2, 3), 1.0))
    half = np.array([0.007, 0.004, 0.006])
    box = Box(np.array([-0.014, 0.002, 0.08]), half, plain(0.2, 0.5, 0.8), turned((3, -1, 2), 0.7))
    corners = np.array([(-0.04, -0.025, 0.14), (0.025, -0.03, 0.19), (0.03, 0.035, 0.17), (-0.035, 0.04, 0.12)])
    lamp = SphereLight(np.array([0.024, 0.013, 0.1]), 0.006, np.array([2.0, 3.0, 4.0]))
    return Scene((ball, box, sheet(corners, Material(TEXTURE))), (lamp, UNIFORM))


def away() -> Scene:
    """A sheet that turns its back to the camera."""
    front = upright(-0.02, -0.02, 0.02, 0.02, 0.1, plain(0.6, 0.5, 0.4))
    return Scene(
        (TriangleMesh(front.vertices_m, -front.normals, front.uv, front.faces[:, ::-1], front.material),), (UNIFORM,)
    )


def moves() -> list[Scene]:
    """A ball that travels and turns, a box that comes nearer and turns, a sheet that is stretched, a wall that stays."""
    wall = upright(-0.3, -0.31, 0.32, 0.3, 0.19, plain(0.5, 0.5, 0.5))
    red, green = plain(0.8, 0.2, 0.2), plain(0.2, 0.8, 0.2)
    corners = np.array([(0.0, 0.01, 0.13), (0.05, 0.01, 0.14), (0.05, 0.05, 0.14), (0.0, 0.05, 0.13)])
    frames = []
    for step in range(3):
        ball = Sphere(np.array([-0.03 + 0.012 * step, -0.01, 0.09]), 0.012, red, turned((1, 1, 0), 0.3 * step))
        box = Box(
            np.array([0.014, -0.014, 0.1 - 0.006 * step]),
            np.array([0.006, 0.01, 0.006]),
            green,
            turned((0, 1, 1), 0.5 + 0.2 * step),
        )
        stretched = corners * (1 + 0.1 * step, 1, 1) + np.array([0.01, -0.004, -0.002]) * step
        frames.append(Scene((ball, box, sheet(stretched, red), wall), (UNIFORM,)))
    return frames


def stacks() -> dict[str, Scene]:
    """One thing behind another. What stands in front is black and the lamp far beside, so that no light is lost behind it."""
    black = plain(0.0, 0.0, 0.0)
    wall = upright(-0.3, -0.31, 0.32, 0.3, 0.15, plain(0.8, 0.6, 0.4))
    ball = Sphere(np.array([0.0, 0.0, 0.08]), 0.02, black, EYE)
    small = Sphere(np.array([0.002, 0.0, 0.08]), 0.009, black, EYE)
    box = Box(np.array([0.0, 0.005, 0.08]), np.array([0.015, 0.01, 0.01]), black, turned((1, 1, 1), 0.4))
    paper = upright(-0.015, -0.012, 0.02, 0.006, 0.05, black)
    further = paper.vertices_m + np.array([0, 0, 0.06])
    back = TriangleMesh(further, -paper.normals, paper.uv, paper.faces[:, ::-1], black)
    return {
        "ball": Scene((ball, wall), (LAMP,)),
        "box": Scene((wall, box), (LAMP,)),
        "paper": Scene((paper, ball, wall), (LAMP,)),
        "back": Scene((back, wall, ball), (LAMP,)),
        "nested": Scene((ball, small, wall), (LAMP,)),
        "bare": Scene((wall,), (LAMP,)),
    }


def run_geometry(variant: str) -> Arrays:
    result: Arrays = {}

    def keep(name: str, clip: Any) -> None:
        result.update({f"{name}.{key}": values for key, values in clip.extras.items()})
        result.update({f"{name}.rgb": clip.rgb, f"{name}.depth_m": clip.depth_m, f"{name}.valid": clip.valid})
        result[f"{name}.edges_s"] = clip.frame_edges_s

    few: dict[str, Any] = {"samples_per_pixel": 4, "seed": 5, "source": {}}
    surfaces = Renderer(variant, outputs=("shape_id", "normal", "albedo"))
    for name, scene in {"solids": solids(), "away": away()}.items():
        keep(name, surfaces.still(scene, VIEW, **few))
    hits = centre_gbuffer(load_scene(solids(), VIEW, 5))
    result |= {f"hits.{name}": getattr(hits, name) for name in ("point_m", "triangle", "barycentric", "depth_m")}
    moving = Renderer(variant, outputs=("shape_id", "motion"))
    keep("moves", moving.clip(moves(), VIEW, frames_per_second=3000, **few))
    for number, scene in enumerate(moves()):
        seed = few["seed"] if number == 0 else np.random.SeedSequence(5, spawn_key=(number,)).generate_state(1)[0]
        keep(f"alone{number}", Renderer(variant).still(scene, VIEW, samples_per_pixel=4, seed=int(seed), source={}))
    peeling = Renderer(variant, outputs=("shape_id", "hidden"), hidden=LAYERS)
    for name, scene in stacks().items():
        keep(f"stack.{name}", peeling.still(scene, VIEW, **few))
    return result


# --- stills

SMALL = View((20, 26), 80e-6, 1.9e-3, 0.036, 0.2)
# x = 3.25 pixels right of the image's centre, y = 5.375 pixels above it: inside pixels 35 (of 64) and 18 (of 48).
EDGE_X, EDGE_Y = 3.25, -5.375
SEEDS = 16


def grey(value: float) -> Material:
    return plain(value, value, value)


def wall(left: float, top: float, right: float, bottom: float, z_m: float, material: Material) -> TriangleMesh:
    """A plane at depth z, its edges in pixels from the image's centre."""
    corners = np.array([(left, top), (right, top), (right, bottom), (left, bottom)])
    across = corners * VIEW.pixel_pitch_m / VIEW.distance_m * z_m
    return sheet(np.column_stack([across, np.full(4, z_m)]), material)


def slanted(half_tangent: float, material: Material) -> TriangleMesh:
    """The plane 1/z = 8 + 2 x/z - 3 y/z (metres) seen under tangents up to ``half_tangent``."""
    tangents = half_tangent * np.array([(-1.0, -1), (1, -1), (1, 1), (-1, 1)])
    disparity = 8 + tangents @ (2, -3)
    return sheet(np.column_stack([tangents, np.ones(4)]) / disparity[:, np.newaxis], material)


def cases() -> dict[str, Scene]:
    """Scenes with a known picture or depth; the tests say what is expected."""
    lamp = SphereLight(np.array([0.0, 0.0, -0.5]), 0.1, np.array([10.0, 20.0, 30.0]))
    return {
        "plane": Scene((slanted(0.2, grey(0.5)),), (UNIFORM,)),
        "ball": Scene((Sphere(np.array([0.012, -0.006, 0.1]), 0.02, grey(0.5), EYE),), (UNIFORM,)),
        "box": Scene((Box(np.array([0.01, 0.0, 0.1]), np.array([0.01, 0.02, 0.005]), grey(0.5), EYE),), (UNIFORM,)),
        "edge": Scene((wall(EDGE_X, EDGE_Y, 200, 200, 0.07, grey(0.0)),), (UNIFORM,)),
        "lamp": Scene((wall(-40, -30, 40, 30, 0.05, grey(0.8)),), (lamp,)),
    }


def as_arrays(name: str, clip: Clip) -> Arrays:
    return {f"{name}.rgb": clip.rgb[0], f"{name}.depth": clip.depth_m[0], f"{name}.valid": clip.valid[0]}


def run_stills(variant: str, threads: str) -> Arrays:
    activate(variant, int(threads))
    renderer = Renderer(variant)
    arrays: Arrays = {}
    for name, scene in cases().items():
        clip = renderer.still(scene, VIEW, samples_per_pixel=64, seed=3, source={})
        arrays |= as_arrays(name, clip)
    # The order differs with the threads: neither may matter.
    source = flying_things(SMALL, samples_per_pixel=4, objects=12, renderer=renderer)
    for index in (0, 1, 2) if threads == "1" else (2, 0, 1):
        arrays |= as_arrays(f"things{index}", source.clip(index, np.random.default_rng(index)))
    scene = draw_scene(SMALL, 12, np.random.default_rng(5))
    noisy = [renderer.still(scene, SMALL, samples_per_pixel=16, seed=s, source={}) for s in range(SEEDS)]
    arrays["noisy"] = np.stack([clip.rgb[0] for clip in noisy])
    wide = replace(SMALL, margin=(10, 6))
    scene = draw_scene(wide, 12, np.random.default_rng(5))
    options: dict[str, Any] = {"samples_per_pixel": 512, "seed": 3, "source": {}}
    clip = renderer.still(scene, wide, **options)
    around = clip.surroundings
    assert around is not None
    arrays |= as_arrays("margin", clip) | {"margin.around": around.rgb[0], "margin.around_depth": around.depth_m[0]}
    arrays |= as_arrays("alone", renderer.still(scene, SMALL, **options))
    arrays |= as_arrays("field", renderer.still(scene, wide.field, **options))
    return arrays | run_geometry(variant)


# --- the light of hidden layers

ROOM_VIEW = View((9, 12), 120e-6, 1.9e-3, 0.036, 0.2)
HIDDEN_SEEDS = 12
# A round room with the camera in it, a small lamp behind the camera, and a small ball before it, as white
# as the wall: a black one would take more of its light.
ROOM_CENTRE_M, ROOM_RADIUS_M, ROOM_REFLECTANCE = np.array([0.0, 0.0, -0.03]), 0.18, 0.8
ROOM_LAMP = SphereLight(np.array([0.07, 0.0, -0.05]), 0.006, np.array([100.0, 200.0, 300.0]))
DEPTHS = (2, 5)
GLOW = np.array([2.0, 3.0, 4.0])


def room() -> TriangleMesh:
    """A ball of triangles that faces its inside."""
    rows, columns = 48, 96
    polar, around = np.meshgrid(np.linspace(0, np.pi, rows + 1), np.linspace(0, 2 * np.pi, columns + 1), indexing="ij")
    out = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=-1)
    first = (np.arange(rows)[:, np.newaxis] * (columns + 1) + np.arange(columns)).ravel()
    below = first + columns + 1
    # Counter-clockwise seen from inside.
    faces = np.concatenate([np.stack([first, first + 1, below], 1), np.stack([below, first + 1, below + 1], 1)])
    out = out.reshape(-1, 3)
    uv = np.zeros((len(out), 2))
    paint = plain(ROOM_REFLECTANCE, ROOM_REFLECTANCE, ROOM_REFLECTANCE)
    return TriangleMesh(ROOM_CENTRE_M + ROOM_RADIUS_M * out, -out, uv, faces, paint)


def noisy() -> Scene:
    """Two sheets behind a third in the light of two lamps, a red and a blue one: each path chooses one of them."""
    white = plain(0.8, 0.8, 0.8)
    lamps = [
        SphereLight(np.array([side * 0.4, 0.0, 0.0]), 0.1, np.array(colour))
        for side, colour in ((-1, (9.0, 0.0, 0.0)), (1, (0.0, 0.0, 9.0)))
    ]
    near = upright(-0.02, -0.02, 0.02, 0.02, 0.06, plain(0.0, 0.0, 0.0))
    middle = upright(-0.03, -0.03, 0.03, 0.03, 0.1, white)
    return Scene((near, middle, upright(-0.2, -0.2, 0.21, 0.2, 0.15, white)), tuple(lamps))


def run_hidden(variant: str) -> Arrays:
    result: Arrays = {}

    def render(scene: Scene, layers: int, samples: int, seed: int, max_depth: int = 2) -> Arrays:
        renderer = Renderer(variant, ("hidden",), layers, max_depth)
        return renderer.still(scene, ROOM_VIEW, samples_per_pixel=samples, seed=seed, source={}).extras

    # Few and many paths, each with seeds that are far apart.
    for samples in (1, 16):
        taken = [
            render(noisy(), 2, samples, 1000 * seed)
            for seed in range(HIDDEN_SEEDS if samples > 1 else 2 * HIDDEN_SEEDS)
        ]
        for layer in (1, 2):
            result[f"noisy{samples}.rgb{layer}"] = np.stack([extras[f"hidden{layer}_rgb"][0] for extras in taken])
            result[f"noisy.valid{layer}"] = taken[0][f"hidden{layer}_valid"][0]
    ball = Sphere(np.array([0.0, 0.0, 0.05]), 0.012, plain(0.0, 0.0, 0.0), EYE)
    white = Sphere(ball.centre_m, ball.radius_m, room().material, EYE)
    for depth in DEPTHS:
        extras = render(Scene((white, room()), (ROOM_LAMP,)), 1, 16, 3, depth)
        result[f"room.rgb{depth}"] = extras["hidden1_rgb"][0]
        result["room.valid"], result["room.depth_m"] = extras["hidden1_valid"][0], extras["hidden1_depth_m"][0]
    lamp = SphereLight(np.array([0.0, 0.0, 0.12]), 0.02, GLOW)
    for name, hide in (("shown", False), ("unseen", True)):
        extras = render(Scene((ball,), (lamp,), hide_lights=hide), 1, 16, 1)
        result[f"{name}.rgb"], result[f"{name}.valid"] = extras["hidden1_rgb"][0], extras["hidden1_valid"][0]
    return result


# --- wavelength bands

EDGES_NM = (400.0, 430.0, 480.0, 550.0, 620.0, 700.0)
FINE_NM = tuple(float(edge) for edge in range(360, 831, 10))
TINY = View((12, 16), 130e-6, 1.9e-3, 0.036, 0.2)
WHITE, TINTED = np.ones(3), np.array([0.2, 1.0, 3.0])
PAINT = (0.8, 0.3, 0.1)


def walls() -> dict[str, Scene]:
    def wall(material: Material) -> Any:
        return upright(-0.3, -0.3, 0.31, 0.3, 0.1, material)

    return {
        "light": Scene((), (Environment(WHITE),)),
        "tinted": Scene((), (Environment(TINTED),)),
        "grey": Scene((wall(plain(0.5, 0.5, 0.5)),), (Environment(WHITE),)),
        "paint": Scene((wall(plain(*PAINT)),), (Environment(WHITE),)),
    }


def run_bands(variant: str) -> Arrays:
    result: Arrays = {}
    spectral = variant.endswith("spectral")
    for name, scene in walls().items():
        for suffix, edges in (("", EDGES_NM), (".fine", FINE_NM)) if spectral else (("", ()),):
            renderer = Renderer(variant, bands_nm=edges if spectral else ())
            clip = renderer.still(scene, TINY, samples_per_pixel=64, seed=1, source={})
            result[f"{name}{suffix}.rgb"] = clip.rgb[0]
            if spectral:
                result[f"{name}{suffix}.bands"] = clip.extras["bands"][0]
    grey, paint = walls()["grey"], walls()["paint"]
    renderer = Renderer(variant, bands_nm=EDGES_NM if spectral else ())
    frames = [grey, Scene(paint.shapes, (Environment(TINTED),)), grey]
    result["change.rgb"] = renderer.clip(
        frames, TINY, frames_per_second=30, samples_per_pixel=64, seed=2, source={}
    ).rgb
    alone = renderer.still(frames[1], TINY, samples_per_pixel=64, seed=3, source={})
    result["alone.rgb"] = alone.rgb
    if spectral:
        looks = Renderer(variant, ("albedo", "shape_id", "normal", "motion"), bands_nm=EDGES_NM)
        coarse = replace(VIEW, shape=(12, 16), pixel_pitch_m=4 * VIEW.pixel_pitch_m)
        clip = looks.clip(moves(), coarse, frames_per_second=30, samples_per_pixel=1, seed=1, source={})
        result |= {f"moves.{name}": values for name, values in clip.extras.items()}
    colours = np.random.default_rng(0).uniform(0.02, 0.98, (4, 4, 3)).astype(np.float32)
    ball = Sphere(np.array([0.0, 0, 0.1]), 0.04, Material(colours), np.eye(3))
    looks = Renderer(variant, ("albedo",), bands_nm=EDGES_NM if spectral else ())
    still = looks.still(Scene((ball,), (Environment(WHITE),)), TINY, samples_per_pixel=1, seed=1, source={})
    result["ball.albedo"] = still.extras["albedo"][0]
    return result


# --- the ray-traced lensless camera, with LLVM

LLVM = "llvm_ad_rgb"
RUNS = 16
PITCH_M = 60e-6
SKY = (1.0, 2.0, 0.5)
LENSLESS_VIEW = View((32, 32), 19.2e-6, 1.9e-3, 0.036, 0.2)
SENSOR = (60, 60)  # it holds the shadows of the whole scene by the mask of 9 cells
PATCH_EDGES = (-14.0, -15.0, 12.0, 15.0)


def random_mask(cells: int) -> NDArray[np.float64]:
    """Open, closed and grey cells without any symmetry; more of them open in one corner."""
    rng = np.random.default_rng(2)
    row, column = np.indices((cells, cells)) / cells
    amplitude = (rng.random((cells, cells)) < 0.2 + 0.3 * row + 0.2 * column).astype(float)
    amplitude[rng.random((cells, cells)) < 0.1] = 0.6
    return amplitude


def smooth_material(pixels: int, seed: int) -> Material:
    """Colours that change over about 16 texels: even over each pixel, nearly, but not over the scene."""
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).random((pixels, pixels, 3)), (4, 4, 0), mode="wrap")
    low = noise.min(axis=(0, 1))
    return Material((0.1 + 0.8 * (noise - low) / (noise.max(axis=(0, 1)) - low)).astype(np.float32))


def patch(edges: tuple[float, float, float, float], corner_depths_m: Any, material: Material) -> TriangleMesh:
    """A flat quadrilateral that the pinhole sees between these pixels from the centre: left, top, right, bottom."""
    left, top, right, bottom = edges
    tangents = np.array([(left, top), (right, top), (right, bottom), (left, bottom)]) * 19.2e-6 / 1.9e-3
    corners = np.column_stack([tangents, np.ones(4)]) * np.broadcast_to(corner_depths_m, 4)[:, np.newaxis]
    return sheet(corners, material)


def lit(*shapes: TriangleMesh) -> Scene:
    return Scene(shapes, (Environment(np.ones(3)),), hide_lights=True)


def slanted_depths() -> NDArray[np.float64]:
    """Depths of the corners on the plane 1/z = 16 + 20 x/z - 15 y/z (metres), 4.8 to 9.6 cm."""
    left, top, right, bottom = PATCH_EDGES
    tangents = np.array([(left, top), (right, top), (right, bottom), (left, bottom)]) * 19.2e-6 / 1.9e-3
    return 1 / (16 + tangents @ (20, -15))


def measured(scene: Scene, mask: NDArray[np.float64], samples: int) -> NDArray[np.float32]:
    options = {"samples_per_pixel": samples, "seeds": range(RUNS), "max_depth": 2}
    return lensless_render(scene, LENSLESS_VIEW, mask, PITCH_M, SENSOR, **options)


def clips(scene: Scene, outputs: tuple[str, ...] = ()) -> list[Clip]:
    renderer = Renderer(LLVM, outputs=outputs, max_depth=2)
    return [
        renderer.still(scene, LENSLESS_VIEW, samples_per_pixel=64, seed=1000 + s, source={}) for s in range(RUNS // 2)
    ]


def modelled(
    seen: list[Clip], mask: NDArray[np.float64], depths_m: Any, vignetting: bool = True, view: View = LENSLESS_VIEW
) -> NDArray[np.float32]:
    """The forward model of pinhole pictures, ``(runs, H, W, 3)``.

    With PSFs of pixels the edges of the surfaces, which lie between pixels, cost it no accuracy.
    """
    psfs = shadow_psfs(mask, PITCH_M, 1.9e-3, depths_m, 19.2e-6, source="pixel").astype(np.float32)
    stack = PsfStack(
        np.repeat(psfs[:, np.newaxis], 3, axis=1), np.asarray(depths_m, float), 19.2e-6, ("R", "G", "B"), "test"
    )
    model = ForwardModel(stack, SENSOR, view.shape, irradiance=FieldOfView(vignetting).irradiance(view))
    return np.stack([np.moveaxis(model.forward_clip(clip), 0, -1) for clip in seen])


def modelled_by_cells(seen: list[Clip], mask: NDArray[np.float64], depth_m: float) -> NDArray[np.float32]:
    """The same for one plane, but each cell of the mask has cos^4 of its own rays instead of the centre's."""
    rows, columns = mask.shape
    stored_y, stored_x = ((np.arange(n) - (n - 1) / 2) * 19.2e-6 for n in SENSOR)
    total = np.zeros((len(seen), *SENSOR, 3))
    for row, column in np.argwhere(mask):
        alone = np.zeros_like(mask)
        alone[row, column] = mask[row, column]
        y, x = (row - (rows - 1) / 2) * PITCH_M, (column - (columns - 1) / 2) * PITCH_M
        cosine_squared = 1 / (1 + ((stored_y[:, np.newaxis] + y) ** 2 + (stored_x + x) ** 2) / 1.9e-3**2)
        light = modelled(seen, alone, [depth_m], vignetting=False)
        total += light * cosine_squared[..., np.newaxis] ** 2
    return total.astype(np.float32)


def hidden(clip: Clip) -> Clip:
    extras = clip.extras
    return Clip(extras["hidden1_rgb"], extras["hidden1_depth_m"], extras["hidden1_valid"], clip.frame_edges_s)


def plane_case(corner_depths_m: Any, planes_m: Any, samples: int, by_cells: bool = False) -> Arrays:
    """A textured plane that stands alone."""
    mask = random_mask(9)
    scene = lit(patch(PATCH_EDGES, corner_depths_m, smooth_material(32, 1)))
    seen = clips(scene)
    arrays = {"measured": measured(scene, mask, samples), "modelled": modelled(seen, mask, planes_m)}
    if by_cells:
        arrays["by_cells"] = modelled_by_cells(seen, mask, planes_m[0])
    return arrays


def occlusion_case(samples: int) -> Arrays:
    """A black square before a wall, seen by a mask of 1 mm."""
    mask, planes_m = random_mask(17), [0.036, 0.2]
    wall = patch((-16, -16, 16, 16), 0.2, smooth_material(32, 1))
    seen = clips(lit(wall, patch((-6, -6, 6, 6), 0.036, plain(0.0, 0.0, 0.0))), ("hidden",))
    return {
        "measured": measured(lit(wall, patch((-6, -6, 6, 6), 0.036, plain(0.0, 0.0, 0.0))), mask, samples),
        "modelled": modelled(seen, mask, planes_m),
        "hidden": modelled([hidden(clip) for clip in seen], mask, planes_m),
    }


def whole_sensor_case(samples: int) -> Arrays:
    """A room with its lights in view: a wall as far as the sensor sees on three sides, a lamp and the sky beside it."""
    mask = random_mask(9)
    wall = patch((-30, -60, 60, 60), 0.2, smooth_material(64, 1))
    lamp = SphereLight(np.array([-0.05, 0.06, 0.12]), 0.02, np.array([3.0, 2.0, 1.0]))
    scene = Scene((wall,), (lamp, Environment(np.array(SKY))))
    # Two coarse pixels beyond the steepest light that reaches the sensor: half of 60 pixels, and of a shadow of 29.
    view = replace(LENSLESS_VIEW, margin=(36, 36))
    renderer = Renderer(LLVM, max_depth=2)
    options: dict[str, Any] = {"samples_per_pixel": 64, "source": {}}
    seen = [renderer.still(scene, view, seed=1000 + run, **options) for run in range(RUNS // 2)]
    alone = [replace(clip, surroundings=None) for clip in seen]
    return {
        "measured": measured(scene, mask, samples),
        "modelled": modelled(seen, mask, [0.12, 0.2], view=view.field),
        "alone": modelled(alone, mask, [0.12, 0.2]),
    }


def run_lensless(pace: str) -> Arrays:
    activate(LLVM, 2)
    quick = pace == "quick"
    depths_m, samples, by_cells = ((0.036, 0.2), 64, False) if quick else ((0.036, 0.2, 0.07, 2.0), 576, True)
    cases = {f"{depth_m:g} m": plane_case(depth_m, [depth_m], samples, by_cells) for depth_m in depths_m}
    cases["slanted"] = plane_case(slanted_depths(), depth_planes(0.036, 0.2, 25), samples)
    cases["occlusion"] = occlusion_case(samples // 2)
    cases["whole sensor"] = whole_sensor_case(samples)
    sky = Scene((), (Environment(np.array(SKY)),))
    mask = random_mask(9)[:, 1:]
    for name, seeds in (("first", range(RUNS)), ("again", [3])):
        light = lensless_render(
            sky, LENSLESS_VIEW, mask, PITCH_M, (40, 64), samples_per_pixel=64, seeds=seeds, max_depth=2
        )
        cases["sky"] = cases.get("sky", {}) | {name: light}
    return {f"{case}.{name}": array for case, arrays in cases.items() for name, array in arrays.items()}


# --- the families: their clips, and the same scenes with other seeds, whose spread is the Monte-Carlo error

NEAR_AND_FAR = {"endoscopy": (0.005, 0.1)}
CLIPS = {"high_speed": {"frames": 3}, "activity": {"frames": 3}}
FAMILIES = ("flying_things", "endoscopy", "high_speed", "activity")
FAMILY_SEEDS = 12


class Seeded(Renderer):
    """A renderer that keeps what it was asked to render, so that it can be rendered again with another seed."""

    def clip(self, frames: Any, view: View, **named: Any) -> Clip:
        """Render as asked and remember."""
        taken: list[Scene] = list(frames)
        asked[:] = [taken, view, named]
        return super().clip(taken, view, **named)


asked: list[Any] = []


def family_view(family: str, size: int) -> View:
    near_m, far_m = NEAR_AND_FAR.get(family, (0.036, 0.2))
    return View((size, size), 19.2e-6 * 128 / size, 1.9e-3, near_m, far_m)


def render_family(family: str, variant: str, size: int, noisy: bool) -> Arrays:
    make = getattr(importlib.import_module(f"scenes.{family}"), family)
    renderer = Seeded(variant, ("shape_id",))
    source = make(family_view(family, size), samples_per_pixel=4, renderer=renderer, **CLIPS.get(family, {}))
    clip = source.clip(1, np.random.default_rng(11))
    arrays = {"rgb": clip.rgb, "depth": clip.depth_m, "valid": clip.valid, "id": clip.extras["shape_id"]}
    if noisy:
        frames, view, named = asked
        again = [
            Renderer.clip(renderer, frames[:1], view, **(named | {"seed": seed})).rgb[0] for seed in range(FAMILY_SEEDS)
        ]
        arrays["noisy"] = np.stack(again)
    return {f"{family}.{name}": values for name, values in arrays.items()}


def run_families(variant: str, threads: str, order: str) -> Arrays:
    activate(variant, int(threads))
    arrays: Arrays = {}
    for family in FAMILIES if order == "forwards" else reversed(FAMILIES):
        arrays |= render_family(family, variant, 24, noisy=order == "forwards")
    return arrays


if __name__ == "__main__":
    case, *arguments, out = sys.argv[1:]
    np.savez(Path(out), allow_pickle=False, **globals()[f"run_{case}"](*arguments))
