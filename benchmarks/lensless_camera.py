"""The layered forward model against the ray-traced lensless camera: agreement, occlusion, hidden layers, light from outside.

Both are geometric optics: coded masks of 60 um cells, open at random, PSFs that are their exact shadows. So the difference
is that of the model alone: depth planes, shift invariance, and one pinhole picture instead of what each opening sees.
The Monte-Carlo noise is taken out of every relative L2 error, by the scatter of 8 seeds; what is left of it is beside it.

Run: uv run --group bench python benchmarks/lensless_camera.py [--quick]        needs LLVM: flatlight doctor
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage, stats

from scenes.flying_things import draw_scene
from simulator.camera.field import Arrival, FieldOfView
from simulator.camera.forward import DepthRule, ForwardModel
from simulator.optics.stack import PsfStack, depth_planes
from simulator.render import Environment, Material, Renderer, Scene, TriangleMesh, activate, choose_backend
from simulator.render.lensless import lensless_render, shadow_psfs
from simulator.types import Clip, View

SEEDS = 8
PITCH_M, DISTANCE_M = 19.2e-6, 1.9e-3
CELL_M = 60e-6
NEAR_M, WALL_M = 0.04, 0.2
FIELD = 128
BLACK = Material(np.zeros((2, 2, 3), np.float32))


def view(size: int) -> View:
    return View((size, size), PITCH_M, DISTANCE_M, 0.036, WALL_M)


@dataclass(frozen=True)
class Camera:
    """A mask, the planes of its PSFs, and the sensor's rows and columns that are compared: the middle ones."""

    mask: NDArray[np.float64]
    depths_m: NDArray[np.float64]
    sensor: int
    source: Any = "point"
    cell_m: float = CELL_M

    def trace(self, scene: Scene, rays: float, max_depth: int = 2) -> NDArray[np.float64]:
        """Return one picture for each seed; ``rays`` in all."""
        spp = max(1, round(np.sqrt(rays / SEEDS / self.sensor**2))) ** 2
        shape = (self.sensor, self.sensor)
        light = lensless_render(
            scene,
            view(1),
            self.mask,
            self.cell_m,
            shape,
            samples_per_pixel=spp,
            seeds=range(SEEDS),
            max_depth=max_depth,
        )
        return light.astype(np.float64)

    def model(self, clips: list[Clip]) -> NDArray[np.float64]:
        """Return what the layered model makes of pinhole pictures, as ``(N, H, W, 3)``."""
        psfs = shadow_psfs(self.mask, self.cell_m, DISTANCE_M, self.depths_m, PITCH_M, source=self.source)
        values = np.repeat(psfs[:, np.newaxis].astype(np.float32), 3, axis=1)
        stack = PsfStack(values, self.depths_m, PITCH_M, ("R", "G", "B"), "benchmark")
        size = clips[0].rgb.shape[1]
        whole = max(size, self.sensor)
        light = FieldOfView().irradiance(view(size))
        forward = ForwardModel(stack, (whole, whole), (size, size), irradiance=light)
        middle = slice((whole - self.sensor) // 2, (whole + self.sensor) // 2)
        return np.stack([np.moveaxis(forward.forward_clip(c)[:, middle, middle], 0, -1) for c in clips]).astype(float)


def coded_mask(width_m: float) -> NDArray[np.float64]:
    cells = round(width_m / CELL_M)
    return (np.random.default_rng(2).random((cells, cells)) < 0.4).astype(float)


def material(pixels: int, seed: int) -> Material:
    """Colours 0.1 to 0.9 that change over about 16 texels."""
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).random((pixels, pixels, 3)), (4, 4, 0), mode="wrap")
    low = noise.min(axis=(0, 1))
    return Material((0.1 + 0.8 * (noise - low) / (noise.max(axis=(0, 1)) - low)).astype(np.float32))


def patch(half: float, corner_disparities: Any, surface: Material) -> TriangleMesh:
    """A flat square in the pinhole's picture, half its size in pixels, with 1 / z of its corners (clockwise)."""
    tangents = np.array([(-half, -half), (half, -half), (half, half), (-half, half)]) * PITCH_M / DISTANCE_M
    disparities = np.broadcast_to(corner_disparities, 4)
    corners = np.column_stack([tangents, np.ones(4)]) / disparities[:, np.newaxis]
    normal = np.cross(corners[3] - corners[0], corners[1] - corners[0])
    return TriangleMesh(
        corners,
        np.tile(normal / np.linalg.norm(normal), (4, 1)),
        np.array([(0.0, 0), (1, 0), (1, 1), (0, 1)]),
        np.array([(0, 2, 1), (0, 3, 2)]),
        surface,
    )


def lit(*shapes: TriangleMesh) -> Scene:
    return Scene(shapes, (Environment(np.ones(3)),), hide_lights=True)


def see(scene: Scene, size: int, spp: int, outputs: tuple[str, ...] = (), max_depth: int = 2) -> list[Clip]:
    """Return pinhole pictures of the scene by several seeds."""
    renderer = Renderer("llvm_ad_rgb", outputs=outputs, max_depth=max_depth)
    return [renderer.still(scene, view(size), samples_per_pixel=spp, seed=100 + s, source={}) for s in range(SEEDS)]


def hidden(clip: Clip) -> Clip:
    extras = clip.extras
    return Clip(extras["hidden1_rgb"], extras["hidden1_depth_m"], extras["hidden1_valid"], clip.frame_edges_s)


def signed_root(square: float) -> float:
    return float(np.sign(square) * np.sqrt(np.abs(square)))


def errors(traced: NDArray[np.float64], modelled: NDArray[np.float64]) -> str:
    """Say relative L2, the same without each colour's mean, resolution, level against the peak, and ratio of the sums."""
    truth = traced.mean(axis=0)
    difference = modelled.mean(axis=0) - truth
    variance = sum(part.var(axis=0, ddof=1) / len(part) for part in (traced, modelled))
    noise = float(np.sum(variance))
    square = float(np.sum(difference**2)) - noise
    varying = float(np.sum((difference - difference.mean(axis=(0, 1))) ** 2)) - noise
    contrast = float(np.sum((truth - truth.mean(axis=(0, 1))) ** 2)) - noise
    # The noise's own sum scatters like chi-squared, with as many degrees of freedom as pixels (colours share rays).
    left = np.sqrt(noise * np.sqrt(2 / (truth.size / 3)) / np.sum(truth**2))
    level = 20 * np.log10(np.sqrt(max(square, noise * 1e-3) / truth.size) / truth.max())
    return (
        f"{100 * signed_root(square / np.sum(truth**2)):8.2f} {100 * signed_root(varying / contrast):12.2f} "
        f"{100 * left:10.2f} {level:10.1f} {modelled.sum() / traced.sum():10.4f}"
    )


HEADER = f"  {'':44} {'L2 %':>8} {'no mean L2 %':>12} {'+- L2 %':>10} {'of peak dB':>10} {'sum ratio':>10}"


def agreement(rays: float) -> None:
    print("\nz-test (Welch, 8 and 8 seeds): picture 64 x 64, mask 0.54 mm, whole sensor")
    print(
        f"  {'':24} {'mean ratio':>10} {'noise %':>8} {'z mean':>7} {'z^2/exp.':>8} {'min p':>8} {'Sidak':>8} {'L2 %':>7}"
    )
    cases: dict[str, tuple[Any, NDArray[np.float64]]]
    cases = {f"plane at {z_m:g} m": (1 / z_m, np.array([z_m])) for z_m in (0.036, 0.07, 0.2, 2.0)}
    corner = 16 + np.array([(-20 + 15), (20 + 15), (20 - 15), (-20 - 15)]) * 26 * PITCH_M / DISTANCE_M
    cases["slanted"] = (corner, depth_planes(0.036, WALL_M, 25))
    for name, (disparities, depths_m) in cases.items():
        scene = lit(patch(26, disparities, material(64, 1)))
        camera = Camera(coded_mask(0.54e-3), depths_m, 86, "pixel")
        traced, modelled = camera.trace(scene, rays), camera.model(see(scene, 64, 64))
        lit_enough = modelled.mean(axis=0) > 0.05 * modelled.mean(axis=0).max()
        first, second = traced[:, lit_enough], modelled[:, lit_enough]
        test: Any = stats.ttest_ind(second, first, axis=0, equal_var=False)
        error = np.sqrt((first.var(axis=0, ddof=1) + second.var(axis=0, ddof=1)) / SEEDS)
        spread = np.mean(test.statistic**2) / np.mean(test.df / (test.df - 2))
        print(
            f"  {name:24} {modelled.sum() / traced.sum():10.5f} {100 * np.median(error / first.mean(axis=0)):8.2f} "
            f"{test.statistic.mean():7.3f} {spread:8.3f} {test.pvalue.min():8.1e} "
            f"{1 - 0.99 ** (1 / test.pvalue.size):8.1e} {errors(traced, modelled).split()[0]:>7}"
        )


def occlusion(rays: float) -> None:
    print(
        f"\nOcclusion: a square of 32 pixels at 4 cm before a wall at 20 cm, picture {FIELD} x {FIELD}, middle of the sensor"
    )
    print(HEADER)
    wall = patch(FIELD / 2, 1 / WALL_M, material(FIELD, 1))
    squares = {"black": BLACK, "textured": material(64, 3)}
    scenes = {"wall alone": lit(wall)}
    scenes |= {f"{name} square, no wall": lit(patch(16, 1 / NEAR_M, squares[name])) for name in ("textured",)}
    scenes |= {f"{name} square": lit(wall, patch(16, 1 / NEAR_M, surface)) for name, surface in squares.items()}
    for width_m in (1e-3, 3e-3, 7e-3):
        camera = Camera(coded_mask(width_m), np.array([NEAR_M, WALL_M]), FIELD)
        strip = width_m / 2 * (1 / NEAR_M - 1 / WALL_M) * DISTANCE_M / PITCH_M
        print(f"  mask {width_m * 1e3:g} mm: the strip beside an edge is {strip:.1f} pixels wide")
        for name, scene in scenes.items():
            occluded = name.endswith("square")
            traced = camera.trace(scene, rays * (width_m / 1e-3) ** 0.7)
            clips = see(scene, FIELD, 64, ("hidden",) if occluded else ())
            modelled = camera.model(clips)
            print(f"    {name:42} {errors(traced, modelled)}", flush=True)
            if occluded:
                behind = camera.model([hidden(clip) for clip in clips])
                print(f"    {'  + hidden layer':42} {errors(traced, modelled + behind)}", flush=True)


def rim(rays: float) -> None:
    """Print what one small opening at a mask's rim sees, where each error can be pointed at."""
    print(
        "\nOne opening of 5 um, 3 mm beside the axis: mean light by region of its picture, wall's radiance 0.5, square's 0.25"
    )
    strip = 6
    aside_m = strip * PITCH_M / DISTANCE_M / (1 / NEAR_M - 1 / WALL_M)
    cells = 2 * round(aside_m / 5e-6) + 1
    mask = np.zeros((1, cells))
    mask[0, -1] = 1
    grey = [Material(np.full((2, 2, 3), value, np.float32)) for value in (0.5, 0.25)]
    scene = lit(patch(FIELD / 2, 1 / WALL_M, grey[0]), patch(16, 1 / NEAR_M, grey[1]))
    shift = aside_m / PITCH_M * (1 + DISTANCE_M / WALL_M)
    sensor = 2 * int(FIELD / 2 + shift + strip + 2)
    camera = Camera(mask, np.array([NEAR_M, WALL_M]), sensor, cell_m=5e-6)
    traced = camera.trace(scene, rays).mean(axis=0)
    clips = see(scene, FIELD, 64, ("hidden",))
    modelled = camera.model(clips).mean(axis=0)
    behind = camera.model([hidden(clip) for clip in clips]).mean(axis=0)
    # Stored pixels count from the wall's picture: everything moves against the opening, near things further.
    column = np.arange(sensor) - (sensor - 1) / 2 + shift
    row = np.arange(sensor) - (sensor - 1) / 2
    rows = np.abs(row) < 12
    # The rays of a pixel have one direction here: divided by their cos^4 the picture is flat.
    squared = (column * PITCH_M / DISTANCE_M) ** 2 + (row[:, np.newaxis] * PITCH_M / DISTANCE_M) ** 2
    flat = (1 + squared[..., np.newaxis]) ** 2
    scale = 0.5 / (flat * traced)[rows][:, np.abs(column - 40) < 8].mean()
    regions = {
        "wall, far from the square": np.abs(column - 40) < 8,
        "uncovered strip, right of the square": np.abs(column - 13) < 2,
        "covered strip, left of the square": np.abs(column + 19) < 2,
        "square": np.abs(column + 4) < 8,
    }
    print(f"  {'':40} {'traced':>8} {'layered':>8} {'+ hidden':>9}")
    for name, where in regions.items():
        means = [scale * (flat * picture)[rows][:, where].mean() for picture in (traced, modelled, modelled + behind)]
        print(f"  {name:40} {means[0]:8.3f} {means[1]:8.3f} {means[2]:9.3f}")


def flying_things(rays: float) -> None:
    print("\nflying_things, 30 objects of 3.6 to 20 cm, mask 3 mm, 25 planes, middle of the sensor; lamps are not seen")
    print(HEADER)
    camera = Camera(coded_mask(3e-3), depth_planes(0.036, WALL_M, 25), FIELD)
    for index in range(3):
        scene = replace(draw_scene(view(FIELD), 30, np.random.default_rng(index)), hide_lights=True)
        traced = camera.trace(scene, rays, max_depth=5)
        wide = see(scene, 2 * FIELD + 32, 64, ("hidden",), max_depth=5)
        behind = camera.model([hidden(clip) for clip in wide])
        modelled = camera.model(wide)
        print(f"  scene {index}: {'image of all that the sensor sees':35} {errors(traced, modelled)}")
        print(f"  {'':9}{'  + hidden layer':35} {errors(traced, modelled + behind)}", flush=True)


def margins(rays: float) -> None:
    """Print what data sets measure with the default camera's sizes, over the whole sensor, with rooms and lamps in view."""
    sensor, mask, depths_m = (456, 684), coded_mask(7e-3), depth_planes(0.036, WALL_M, 25)
    psfs = shadow_psfs(mask, CELL_M, DISTANCE_M, depths_m, PITCH_M).astype(np.float32)
    stack = PsfStack(np.repeat(psfs[:, None], 3, axis=1), depths_m, PITCH_M, ("R", "G", "B"), "benchmark")
    image = view(FIELD)
    arrival = Arrival(psfs[[0, -1]], sensor, image, FieldOfView())
    auto = arrival.margin()
    spp = max(1, round(np.sqrt(rays / SEEDS / sensor[0] / sensor[1]))) ** 2
    print(f"\nflying_things, mask 7 mm, whole sensor of {sensor[0]} x {sensor[1]}, rooms and lamps seen; auto: {auto}")
    print(f"  {'':14} {'margin':>12} {'uniform left out %':>18} {'of this scene %':>16} {HEADER.strip():>60}")
    for index in range(3):
        scene = draw_scene(replace(image, margin=auto), 30, np.random.default_rng(index))
        options: dict[str, Any] = {"samples_per_pixel": spp, "seeds": range(SEEDS), "max_depth": 5}
        traced = lensless_render(scene, image, mask, CELL_M, sensor, **options).astype(np.float64)
        for margin in ((0, 0), (64, 64), (128, 128), auto):
            wide = replace(image, margin=margin)
            renderer = Renderer("llvm_ad_rgb")
            clips = [renderer.still(scene, wide, samples_per_pixel=16, seed=100 + s, source={}) for s in range(SEEDS)]
            light = FieldOfView().irradiance(wide.field)
            model = ForwardModel(stack, sensor, wide.field.shape, irradiance=light, depth_rule=DepthRule(max_clamped=1))
            modelled = np.stack([np.moveaxis(model.forward_clip(clip), 0, -1) for clip in clips]).astype(np.float64)
            missing = 100 * (1 - modelled.sum() / traced.sum())
            name, size = f"scene {index}", f"{margin[0]} x {margin[1]}"
            left = 100 * arrival.left_out(margin)
            print(f"  {name:14} {size:>12} {left:18.1f} {missing:16.1f} {errors(traced, modelled)}", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="a quarter of the rays")
    parser.add_argument(
        "--only", choices=("agreement", "occlusion", "rim", "flying_things", "margins"), help="one part"
    )
    chosen = parser.parse_args()
    rays = 5e6 if chosen.quick else 2e7
    activate(choose_backend("llvm").variant)
    parts = {"agreement": rays, "occlusion": rays, "rim": rays / 4, "flying_things": rays, "margins": rays}
    for part, count in parts.items():
        if chosen.only in (None, part):
            globals()[part](count)


if __name__ == "__main__":
    main()
