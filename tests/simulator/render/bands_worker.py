"""Renders the cases of test_bands.py with one spectral variant: ``bands_worker.py VARIANT OUT.npz``."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from geometry_cases import VIEW, moves, plain, upright
from numpy.typing import NDArray

from scenes.flying_things import draw_scene
from simulator.render import Environment, Material, Renderer, Scene, Sphere
from simulator.types import View

EDGES_NM = (400.0, 430.0, 480.0, 550.0, 620.0, 700.0)
FINE_NM = tuple(float(edge) for edge in range(360, 831, 10))
SMALL = View((12, 16), 130e-6, 1.9e-3, 0.036, 0.2)
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


def run(variant: str) -> dict[str, NDArray[Any]]:
    result: dict[str, NDArray[Any]] = {}
    spectral = variant.endswith("spectral")
    for name, scene in walls().items():
        for suffix, edges in (("", EDGES_NM), (".fine", FINE_NM)) if spectral else (("", ()),):
            renderer = Renderer(variant, bands_nm=edges if spectral else ())
            clip = renderer.still(scene, SMALL, samples_per_pixel=64, seed=1, source={})
            result[f"{name}{suffix}.rgb"] = clip.rgb[0]
            if spectral:
                result[f"{name}{suffix}.bands"] = clip.extras["bands"][0]
    grey, paint = walls()["grey"], walls()["paint"]
    renderer = Renderer(variant, bands_nm=EDGES_NM if spectral else ())
    frames = [grey, Scene(paint.shapes, (Environment(TINTED),)), grey]
    result["change.rgb"] = renderer.clip(
        frames, SMALL, frames_per_second=30, samples_per_pixel=64, seed=2, source={}
    ).rgb
    alone = renderer.still(frames[1], SMALL, samples_per_pixel=64, seed=3, source={})
    result["alone.rgb"] = alone.rgb
    if spectral:
        looks = Renderer(variant, ("albedo", "shape_id", "normal", "motion"), bands_nm=EDGES_NM)
        coarse = replace(VIEW, shape=(12, 16), pixel_pitch_m=4 * VIEW.pixel_pitch_m)
        clip = looks.clip(moves(), coarse, frames_per_second=30, samples_per_pixel=1, seed=1, source={})
        result |= {f"moves.{name}": values for name, values in clip.extras.items()}
    colours = np.random.default_rng(0).uniform(0.02, 0.98, (4, 4, 3)).astype(np.float32)
    ball = Sphere(np.array([0.0, 0, 0.1]), 0.04, Material(colours), np.eye(3))
    looks = Renderer(variant, ("albedo",), bands_nm=EDGES_NM if spectral else ())
    still = looks.still(Scene((ball,), (Environment(WHITE),)), SMALL, samples_per_pixel=1, seed=1, source={})
    result["ball.albedo"] = still.extras["albedo"][0]
    things = draw_scene(SMALL, 12, np.random.default_rng(5))
    result["things.rgb"] = renderer.still(things, SMALL, samples_per_pixel=16, seed=4, source={}).rgb[0]
    return result


if __name__ == "__main__":
    np.savez(Path(sys.argv[2]), allow_pickle=False, **run(sys.argv[1]))
