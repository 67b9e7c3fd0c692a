"""CPU seconds of one default sample, rendering aside: forward model, noise, EXR files.

    uv run python benchmarks/sample.py

Uses the default camera's sizes (456 x 684 sensor, 128 x 128 scene, 25 depths) with a random stack of the same size as the
default one, so that it needs no PSF computation; the cost does not depend on the values.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from statistics import median

import numpy as np

from simulator.camera.field import FieldOfView
from simulator.camera.forward import ForwardModel
from simulator.camera.noise import GaussianNoise, PhysicalNoise
from simulator.camera.sensor import MODELS, Sensor
from simulator.dataset.sample import Sample, write_sample
from simulator.optics.stack import PsfStack, depth_planes
from simulator.types import Clip, View

ROUNDS = 7


def cpu(function, *arguments, **named):
    begin = time.process_time()
    result = function(*arguments, **named)
    return time.process_time() - begin, result


def main() -> None:
    rng = np.random.default_rng(0)
    depths = depth_planes(0.036, 0.2, 25)
    stack = PsfStack(rng.random((25, 3, 499, 499), np.float32), depths, 19.2e-6, ("R", "G", "B"), "benchmark")
    view = View((128, 128), 19.2e-6, 1.9e-3, 0.036, 0.2)
    prepared, model = cpu(ForwardModel, stack, (456, 684), (128, 128), irradiance=FieldOfView().irradiance(view))
    smooth = np.add.outer(np.sin(np.arange(128) / 9), np.cos(np.arange(128) / 13))
    depth = (1 / (1 / 0.2 + (1 / 0.037 - 1 / 0.2) * (smooth + 2) / 4)).astype(np.float32)[None]
    clip = Clip(rng.random((1, 128, 128, 3), np.float32), depth, np.ones(depth.shape, bool), np.array([0.0, 1.0]))
    exposure = model.forward_clip(clip)
    full_scale = float(exposure.max()) / 0.8
    rows: dict[str, list[float]] = {"forward": [], "noise (gaussian)": [], "noise (physical)": [], "EXR files": []}
    with tempfile.TemporaryDirectory() as folder:
        for index in range(ROUNDS):
            seconds, exposure = cpu(model.forward_clip, clip)
            rows["forward"].append(seconds)
            for name, noise in (("gaussian", GaussianNoise(psnr_db=40)), ("physical", PhysicalNoise())):
                numbers = MODELS["imx183"]
                sensor = Sensor(
                    name="imx183", binning=8, shape=(456, 684), full_scale=full_scale, noise=noise, **numbers
                )
                seconds, measurement = cpu(sensor.expose, exposure, np.random.default_rng(0))
                rows[f"noise ({name})"].append(seconds)
            sample = Sample(measurement, sensor.noiseless(exposure), clip.rgb, clip.depth_m, clip.valid, 0)
            seconds, _ = cpu(write_sample, Path(folder), "train", index, sample)
            rows["EXR files"].append(seconds)
    print(f"prepare the model (once per worker): {prepared:.2f} CPU-s")
    for name, values in rows.items():
        print(f"{name:18} {median(values):.3f} CPU-s (median of {ROUNDS})")
    for kind in ("gaussian", "physical"):
        total = sum(median(rows[name]) for name in ("forward", f"noise ({kind})", "EXR files"))
        print(f"one sample with {kind} noise: {total:.3f} CPU-s")


if __name__ == "__main__":
    main()
