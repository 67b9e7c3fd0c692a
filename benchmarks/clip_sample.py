"""CPU seconds of one sample of a clip, rendering aside: forward model, noise, truth of the slivers, EXR files.

    uv run python benchmarks/clip_sample.py

The thesis's sizes: 60 frames of 160 x 160 on one plane, seen by 320 x 384 pixels through a dual rolling shutter, ten slivers.
With a random stack and random pictures, so that it needs no PSF and no rendering: neither convolutions nor noise cost more or
less for other values. Files do: random pictures hardly compress, so a smooth one is stored as well, with a truth as black as
that of bright things on black.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from common import single_threaded, versions

from simulator.camera.colour import clipped_share
from simulator.camera.field import FieldOfView
from simulator.camera.forward import ForwardModel
from simulator.camera.noise import GaussianNoise, PhysicalNoise
from simulator.camera.planes import clamped_share
from simulator.camera.sensor import MODELS, Sensor
from simulator.camera.shutter import DualRollingShutter
from simulator.camera.slivers import exposed_part, sliver_means
from simulator.dataset.sample import Sample, write_sample
from simulator.optics.stack import PsfStack
from simulator.types import Clip, View

ROUNDS = 7
FRAMES, SLIVERS, SCENE, SENSOR, BINNING = 60, 10, (160, 160), (320, 384), 8
FRAME_S, EXPOSURE_S, LINE_S = 10e-3 / FRAMES, 0.86e-3, 7.14e-6
LIMIT_S = 0.8


def cpu(function: Callable[..., Any], *arguments: Any, **named: Any) -> tuple[float, Any]:
    """Return the CPU seconds that a call takes, and its result."""
    begin = time.process_time()
    result = function(*arguments, **named)
    return time.process_time() - begin, result


def clips(rng: np.random.Generator) -> dict[str, Clip]:
    """Return the clips: noise, which does not compress, and squares that move on black, as the families draw."""
    noise = rng.random((FRAMES, *SCENE, 3), np.float32)
    squares = np.zeros_like(noise)
    for frame in range(FRAMES):
        for row, column in ((20, 10 + frame), (60, 100 - frame), (90 + frame // 2, 60)):
            texture = noise[0, row : row + 40, :40]  # moves with its square
            squares[frame, row : row + 40, column : column + 40] = texture
    depth = np.full(noise.shape[:3], 0.3, np.float32)
    edges_s = np.arange(FRAMES + 1) * FRAME_S
    return {
        name: Clip(rgb, depth, np.ones(depth.shape, bool), edges_s)
        for name, rgb in (("noise everywhere", noise), ("squares on black", squares))
    }


def main() -> None:
    """Print the table."""
    single_threaded()
    rng = np.random.default_rng(0)
    view = View(SCENE, 19.2e-6, 1.9e-3, 0.3, 0.3)
    shutter = DualRollingShutter(EXPOSURE_S, LINE_S, binning=BINNING)
    # The PSF of a mask 3.07 mm wide, seen from 30 cm, takes 161 pixels of 19.2 um.
    stack = PsfStack(rng.random((1, 3, 161, 161), np.float32), np.array([0.3]), 19.2e-6, ("R", "G", "B"), "benchmark")
    irradiance = FieldOfView().irradiance(view)
    prepared, model = cpu(ForwardModel, stack, SENSOR, SCENE, shutter, irradiance=irradiance)
    print(versions("flatlight", "numpy", "scipy", "OpenEXR"))
    print(f"{FRAMES} frames of {SCENE} on one plane, {SENSOR} pixels, dual rolling shutter, {SLIVERS} slivers")
    print(f"prepare the model (once per worker): {prepared:.3f} CPU-s")
    for name, clip in clips(rng).items():
        rows = one_clip(model, clip)
        print(f"\n{name}: CPU-s, medians of {ROUNDS}")
        for row, seconds in rows.items():
            print(f"  {row:32} {seconds:.3f}")
        always = ("forward", "truth of the slivers", "shares of clipped values")
        for noise in ("gaussian", "physical"):
            total = sum(rows[row] for row in (*always, f"noise ({noise})", "EXR files"))
            print(f"  one sample with {noise} noise: {total:.3f} (limit {LIMIT_S})")
        more = (*always, "noise (gaussian)", "global measurements", "EXR files with global ones")
        print(f"  one sample with gaussian noise and global measurements: {sum(rows[row] for row in more):.3f}")


def shares(model: ForwardModel, clip: Clip) -> tuple[float, float]:
    """Return what the recipe records of a clip's colours and depths."""
    colours = clip.rgb.reshape(-1, *clip.rgb.shape[2:])
    return (
        clipped_share(colours, model.scene_to_camera),
        clamped_share(clip.depth_m, clip.valid, model.stack.depths_m),
    )


def one_clip(model: ForwardModel, clip: Clip) -> dict[str, float]:
    """Return the median CPU seconds of each part."""
    shutter = model.shutter
    assert shutter is not None
    full_scale = float(model.forward_clip(clip).max()) / 0.8
    numbers = MODELS["imx183"]
    noises = {"gaussian": GaussianNoise(std=5e-3), "physical": PhysicalNoise()}
    sensors = {
        name: Sensor(name="imx183", binning=BINNING, shape=SENSOR, full_scale=full_scale, noise=noise, **numbers)
        for name, noise in noises.items()
    }
    rows: dict[str, list[float]] = {}

    def timed(row: str, function: Callable[..., Any], *arguments: Any, **named: Any) -> Any:
        seconds, result = cpu(function, *arguments, **named)
        rows.setdefault(row, []).append(seconds)
        return result

    with tempfile.TemporaryDirectory() as folder:
        for index in range(ROUNDS):
            exposure = timed("forward", model.forward_clip, clip)
            for name, sensor in sensors.items():
                measurement = timed(f"noise ({name})", sensor.expose, exposure, np.random.default_rng(index))
            truth = timed("truth of the slivers", lambda: sliver_means(exposed_part(clip, shutter, SENSOR[0]), SLIVERS))
            timed("shares of clipped values", shares, model, clip)
            targets = timed("global measurements", lambda: np.stack(list(model.global_measurements(clip, SLIVERS))))
            measured = targets / np.float32(full_scale)
            sensor = sensors["gaussian"]
            measurement = sensor.expose(exposure, np.random.default_rng(index))
            values = (measurement, sensor.noiseless(exposure), truth.rgb, truth.depth_m, truth.valid, 0)
            edges_s = truth.frame_edges_s
            sample = Sample(*values, frame_edges_s=edges_s)
            timed("EXR files", write_sample, Path(folder), "train", 2 * index, sample)
            sample = Sample(*values, frame_edges_s=edges_s, global_measurements=measured)
            timed("EXR files with global ones", write_sample, Path(folder), "train", 2 * index + 1, sample)
    return {row: median(seconds) for row, seconds in rows.items()}


if __name__ == "__main__":
    main()
