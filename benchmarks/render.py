"""CPU seconds of rendered samples, the share of path tracing in them, compiled kernels, memory, and a naive loop beside it.

    uv run python benchmarks/render.py            # all parts, about four minutes
    uv run python benchmarks/render.py --scenes 50

Each part runs in a process of its own with an empty kernel cache. "Path tracing" is the time inside Mitsuba's rendering
calls: `mi.render` and the rays of the depth map. The naive loop is what one writes first: a new `load_dict` with the `aov`
integrator for every picture, held in a variable until the next one replaces it. It is slow for two reasons, so it runs twice:
with 20 to 40 things, where every new number compiles new kernels, and with always 30 in the same slots.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from simulator.types import View

WARM_UP = 2  # samples that are not counted: the first compiles the kernels, and textures are made once per process


def view(size: int) -> View:
    """The default camera's field of view, seen with fewer pixels."""
    return View((size, size), 19.2e-6 * 128 / size, 1.9e-3, 0.036, 0.2)


class Clock:
    """CPU seconds inside Mitsuba's rendering calls."""

    def __init__(self) -> None:
        import mitsuba as mi

        from simulator.render import renderer

        self.seconds = 0.0
        mi.render = self._timed(mi.render)
        renderer.centre_depth = self._timed(renderer.centre_depth)

    def _timed(self, function: Callable[..., Any]) -> Callable[..., Any]:
        def run(*arguments: Any, **named: Any) -> Any:
            begin = time.process_time()
            result = np.array(function(*arguments, **named))  # waits for the result
            self.seconds += time.process_time() - begin
            return result

        return run


def compiled() -> int:
    """Kernels compiled since the last call; 0 for scalar variants, which have none."""
    import drjit as dr

    return sum(not kernel.get("cache_hit", True) for kernel in dr.kernel_history())


def megabytes() -> float:
    """Memory that this process holds."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGESIZE") / 2**20


def run(make: Iterator[int], count: int) -> dict[str, Any]:
    """Take ``count`` samples after the warm-up; ``make`` yields the number of pictures in each."""
    clock = Clock()
    seconds, shares, kernels = [], [], 0
    for number in range(count + WARM_UP):
        begin, inside = time.process_time(), clock.seconds
        pictures = next(make)
        total, traced = time.process_time() - begin, clock.seconds - inside
        found = compiled()
        if number >= 1:
            kernels += found
        if number >= WARM_UP:
            seconds.append(total / pictures)
            shares.append(traced / total)
    return {"seconds": median(seconds), "share": median(shares), "kernels": kernels}


def sampled(family: str, backend: str, size: int, samples: int, **parameters: Any) -> Iterator[int]:
    """Clips of a family, one after the other."""
    import importlib

    from simulator.render import Renderer

    source = getattr(importlib.import_module(f"scenes.{family}"), family)(
        view(size), samples_per_pixel=samples, renderer=Renderer(backend), **parameters
    )
    number = 0
    while True:
        yield source.clip(number, np.random.default_rng(number)).rgb.shape[0]
        number += 1


def naive(backend: str, size: int, samples: int, fewest: int, most: int) -> Iterator[int]:
    """The first loop that one writes: colour and depth of flying things by `load_dict` and `aov`."""
    import mitsuba as mi

    from scenes.flying_things import draw_scene
    from simulator.render import activate, mitsuba_scene

    activate(backend, 1)
    looked_from = view(size)
    scene = None
    number = 0
    while True:
        rng = np.random.default_rng(number)
        drawn = draw_scene(looked_from, int(rng.integers(fewest, most + 1)), rng)
        parts = mitsuba_scene.scene_parts(drawn, looked_from, 5)
        parts["integrator"] = {"type": "aov", "aovs": "depth:depth", "path": parts["integrator"]}
        scene = mi.load_dict(parts)  # the old scene lives until now
        np.array(mi.render(scene, spp=samples, seed=number))
        yield 1
        number += 1


def memory(backend: str, count: int) -> dict[str, Any]:
    """Growth over new scenes of 32 x 32 pixels, counted from the tenth."""
    source = sampled("flying_things", backend, 32, 1)
    start = 0.0
    for number in range(count):
        next(source)
        if number == 10:
            start = megabytes()
    return {"start": start, "growth": megabytes() - start}


PARTS: dict[str, tuple[str, Callable[[str], Iterator[int]], int, float | None]] = {
    # name: (what it is, the samples, how many, the limit in CPU seconds with llvm)
    "scenes": (
        "flying_things, 128 x 128, 16 spp, new scenes",
        lambda b: sampled("flying_things", b, 128, 16),
        20,
        0.40,
    ),
    "naive": ("by load_dict + aov, 20 to 40 things", lambda b: naive(b, 128, 16, 20, 40), 8, None),
    "fixed": ("by load_dict + aov, always 30 things", lambda b: naive(b, 128, 16, 30, 30), 8, None),
    "frames": (
        "high_speed, 128 x 128, 16 spp, clip frames",
        lambda b: sampled("high_speed", b, 128, 16, frames=20),
        4,
        0.30,
    ),
    "small": ("high_speed, 64 x 64, 4 spp, clip frames", lambda b: sampled("high_speed", b, 64, 4, frames=20), 8, 0.03),
    "activity": ("activity, 64 x 64, 4 spp, clip frames", lambda b: sampled("activity", b, 64, 4, frames=20), 8, 0.03),
    "endoscopy": ("endoscopy, 128 x 128, 16 spp, new scenes", lambda b: endoscopy(b), 10, None),
}


def endoscopy(backend: str) -> Iterator[int]:
    """Stills of hollow organs, which need a depth range of their own."""
    from scenes.endoscopy import endoscopy as family
    from simulator.render import Renderer

    looked_from = View((128, 128), 19.2e-6, 1.9e-3, 0.005, 0.1)
    source = family(looked_from, samples_per_pixel=16, renderer=Renderer(backend))
    number = 0
    while True:
        source.clip(number, np.random.default_rng(number))
        yield 1
        number += 1


def part(name: str, backend: str, count: int) -> dict[str, Any]:
    """Run one part here."""
    import drjit as dr

    from simulator.render import activate

    activate(backend, 1)
    if name == "memory":
        return memory(backend, count)
    dr.set_flag(dr.JitFlag.KernelHistory, True)  # a list that grows until it is read
    return run(PARTS[name][1](backend), min(count, PARTS[name][2]))


def apart(name: str, backend: str, count: int) -> dict[str, Any]:
    """Run one part in a process of its own with an empty kernel cache."""
    with tempfile.TemporaryDirectory() as home:
        command = [sys.executable, __file__, "--part", name, "--backend", backend, "--scenes", str(count)]
        done = subprocess.run(
            command, env=os.environ | {"HOME": home}, check=True, stdout=subprocess.PIPE, text=True, cwd=Path.cwd()
        )
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=500, help="scenes of the memory part; other parts take fewer")
    parser.add_argument("--backend", default="llvm_ad_rgb", help="llvm_ad_rgb or scalar_rgb")
    parser.add_argument("--part", choices=[*PARTS, "memory"], help="one part, in this process, as JSON")
    chosen = parser.parse_args()
    if chosen.part:
        print(json.dumps(part(chosen.part, chosen.backend, chosen.scenes)))
        return
    print(f"{chosen.backend}, one thread; medians of CPU seconds per picture")
    print(f"{'':48} {'CPU s':>7} {'limit':>6} {'path tracing':>13} {'kernels after the first':>24}")
    results = {}
    for name, (title, _, _, limit) in PARTS.items():
        results[name] = found = apart(name, chosen.backend, chosen.scenes)
        bound = "" if limit is None or not chosen.backend.startswith("llvm") else f"{limit:.2f}"
        print(f"{title:48} {found['seconds']:7.3f} {bound:>6} {found['share']:13.0%} {found['kernels']:24d}")
    for name in ("naive", "fixed"):
        ratio = results[name]["seconds"] / results["scenes"]["seconds"]
        print(f"{PARTS[name][0]}: {ratio:.1f} times as long as ours")
    found = apart("memory", chosen.backend, chosen.scenes)
    print(f"memory over {chosen.scenes} scenes: {found['start']:.0f} MiB, then {found['growth']:+.0f} MiB (limit +100)")


if __name__ == "__main__":
    main()
