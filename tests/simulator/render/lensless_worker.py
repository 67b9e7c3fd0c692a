"""Measures and models the cases of the lensless camera's tests with LLVM: ``lensless_worker.py quick|slow OUT.npz``.

A process keeps to one Mitsuba variant, and that of the test process is the scalar one.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
from geometry_cases import sheet
from numpy.typing import NDArray
from scipy import ndimage

from simulator.camera.forward import ForwardModel
from simulator.camera.planes import mask_irradiance
from simulator.optics.stack import PsfStack, depth_planes
from simulator.render import Environment, Material, Renderer, Scene, TriangleMesh, activate
from simulator.render.lensless import lensless_render, shadow_psfs
from simulator.types import Clip, View

VARIANT = "llvm_ad_rgb"
RUNS = 16
PITCH_M = 60e-6
SKY = (1.0, 2.0, 0.5)
VIEW = View((32, 32), 19.2e-6, 1.9e-3, 0.036, 0.2)
SENSOR = (60, 60)  # it holds the shadows of the whole scene by the mask of 9 cells
EDGES = (-14.0, -15.0, 12.0, 15.0)


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


BLACK = Material(np.zeros((2, 2, 3), dtype=np.float32))


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
    left, top, right, bottom = EDGES
    tangents = np.array([(left, top), (right, top), (right, bottom), (left, bottom)]) * 19.2e-6 / 1.9e-3
    return 1 / (16 + tangents @ (20, -15))


def measured(scene: Scene, mask: NDArray[np.float64], samples: int) -> NDArray[np.float32]:
    options = {"samples_per_pixel": samples, "seeds": range(RUNS), "max_depth": 2}
    return lensless_render(scene, VIEW, mask, PITCH_M, SENSOR, **options)


def clips(scene: Scene, outputs: tuple[str, ...] = ()) -> list[Clip]:
    renderer = Renderer(VARIANT, outputs=outputs, max_depth=2)
    return [renderer.still(scene, VIEW, samples_per_pixel=64, seed=1000 + s, source={}) for s in range(RUNS // 2)]


def modelled(
    seen: list[Clip], mask: NDArray[np.float64], depths_m: Any, vignetting: bool = True
) -> NDArray[np.float32]:
    """The forward model of pinhole pictures, ``(runs, H, W, 3)``.

    With PSFs of pixels the edges of the surfaces, which lie between pixels, cost it no accuracy.
    """
    psfs = shadow_psfs(mask, PITCH_M, 1.9e-3, depths_m, 19.2e-6, source="pixel").astype(np.float32)
    stack = PsfStack(
        np.repeat(psfs[:, np.newaxis], 3, axis=1), np.asarray(depths_m, float), 19.2e-6, ("R", "G", "B"), "test"
    )
    model = ForwardModel(stack, SENSOR, VIEW.shape, irradiance=mask_irradiance(VIEW, vignetting))
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


def plane_case(corner_depths_m: Any, planes_m: Any, samples: int, by_cells: bool = False) -> dict[str, NDArray[Any]]:
    """A textured plane that stands alone."""
    mask = random_mask(9)
    scene = lit(patch(EDGES, corner_depths_m, smooth_material(32, 1)))
    seen = clips(scene)
    arrays = {"measured": measured(scene, mask, samples), "modelled": modelled(seen, mask, planes_m)}
    if by_cells:
        arrays["by_cells"] = modelled_by_cells(seen, mask, planes_m[0])
    return arrays


def occlusion_case(samples: int) -> dict[str, NDArray[Any]]:
    """A black square before a wall, seen by a mask of 1 mm."""
    mask, planes_m = random_mask(17), [0.036, 0.2]
    wall = patch((-16, -16, 16, 16), 0.2, smooth_material(32, 1))
    seen = clips(lit(wall, patch((-6, -6, 6, 6), 0.036, BLACK)), ("hidden",))
    return {
        "measured": measured(lit(wall, patch((-6, -6, 6, 6), 0.036, BLACK)), mask, samples),
        "modelled": modelled(seen, mask, planes_m),
        "hidden": modelled([hidden(clip) for clip in seen], mask, planes_m),
    }


def run(depths_m: tuple[float, ...], samples: int, by_cells: bool = False) -> dict[str, NDArray[Any]]:
    cases = {f"{depth_m:g} m": plane_case(depth_m, [depth_m], samples, by_cells) for depth_m in depths_m}
    cases["slanted"] = plane_case(slanted_depths(), depth_planes(0.036, 0.2, 25), samples)
    cases["occlusion"] = occlusion_case(samples // 2)
    sky = Scene((), (Environment(np.array(SKY)),))
    mask = random_mask(9)[:, 1:]
    for name, seeds in (("first", range(RUNS)), ("again", [3])):
        light = lensless_render(sky, VIEW, mask, PITCH_M, (40, 64), samples_per_pixel=64, seeds=seeds, max_depth=2)
        cases["sky"] = cases.get("sky", {}) | {name: light}
    return {f"{case}.{name}": array for case, arrays in cases.items() for name, array in arrays.items()}


if __name__ == "__main__":
    activate(VARIANT, 2)
    quick, depths_m = sys.argv[1] == "quick", (0.036, 0.2)
    arrays = run(depths_m, 64) if quick else run((*depths_m, 0.07, 2.0), 576, by_cells=True)
    np.savez(Path(sys.argv[2]), allow_pickle=False, **arrays)
