"""Renders a clip of every family: ``families_worker.py VARIANT THREADS ORDER OUT.npz``.

A process keeps to one Mitsuba variant, so that tests of both run this script. Beside the clip of each family it renders the
clip's scenes with other seeds of the path tracer, whose spread is the Monte-Carlo error.
"""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulator.render import Renderer, Scene, activate
from simulator.types import Clip, View

NEAR_AND_FAR = {"endoscopy": (0.005, 0.1)}
CLIPS = {"high_speed": {"frames": 3}, "activity": {"frames": 3}}
FAMILIES = ("flying_things", "endoscopy", "high_speed", "activity")
SEEDS = 12


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


def render(family: str, variant: str, size: int, noisy: bool) -> dict[str, NDArray[Any]]:
    make = getattr(importlib.import_module(f"scenes.{family}"), family)
    renderer = Seeded(variant, ("shape_id",))
    source = make(family_view(family, size), samples_per_pixel=4, renderer=renderer, **CLIPS.get(family, {}))
    clip = source.clip(1, np.random.default_rng(11))
    arrays = {"rgb": clip.rgb, "depth": clip.depth_m, "valid": clip.valid, "id": clip.extras["shape_id"]}
    if noisy:
        frames, view, named = asked
        again = [Renderer.clip(renderer, frames[:1], view, **(named | {"seed": seed})).rgb[0] for seed in range(SEEDS)]
        arrays["noisy"] = np.stack(again)
    return {f"{family}.{name}": values for name, values in arrays.items()}


def run(variant: str, threads: int, order: str, size: int = 24) -> dict[str, NDArray[Any]]:
    activate(variant, threads)
    arrays: dict[str, NDArray[Any]] = {}
    for family in FAMILIES if order == "forwards" else reversed(FAMILIES):
        arrays |= render(family, variant, size, noisy=order == "forwards")
    return arrays


if __name__ == "__main__":
    np.savez(Path(sys.argv[4]), allow_pickle=False, **run(sys.argv[1], int(sys.argv[2]), sys.argv[3]))
