"""CPU seconds of one default sample by stage, with its margin and of the image alone, in turn.

    uv run python benchmarks/sample.py [--backend scalar]

The default camera and scenes (456 x 684 sensor, 128 x 128 image, all depths) with a random stack of the default size, so that
it needs no PSF computation; the cost does not depend on the values. One thread.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np

from simulator.assembly import Assembly
from simulator.camera.noise import PhysicalNoise
from simulator.config import load_config
from simulator.dataset.sample import Sample, write_sample
from simulator.optics.stack import PsfStack
from simulator.render import activate, choose_backend

ROUNDS = 12
CONFIG = Path(__file__).parents[1] / "sim_config.yaml"


def cpu(function, *arguments, **named):
    begin = time.process_time()
    result = function(*arguments, **named)
    return time.process_time() - begin, result


class Maker:
    """What makes the samples of one margin."""

    def __init__(self, margin: str, backend: str) -> None:
        bare = Assembly(load_config(CONFIG, [f"scene.margin={margin}"]), backend)
        values = np.random.default_rng(0).random((len(bare.depths_m), 3, 401, 401), np.float32)
        stack = PsfStack(values, np.array(bare.depths_m), bare.pixel_pitch_m, ("R", "G", "B"), "benchmark")
        self.assembly = bare.having(psf_stack=stack, view=bare.view)  # as workers get them
        self.prepared, self.model = cpu(lambda: self.assembly.forward_model)
        self.full_scale = float(self.model.forward_clip(self.clip(0)).max()) / 0.8

    def clip(self, index: int):
        """Draw and render a scene."""
        return self.assembly.source.clip(index, np.random.default_rng(index))

    def sample(self, index: int, folder: Path) -> dict[str, float]:
        """Make and write one sample; return the CPU seconds by stage."""
        seconds = {}
        seconds["scene and its light"], clip = cpu(self.clip, index)
        seconds["forward model"], exposure = cpu(self.model.forward_clip, clip)
        sensor = replace(self.assembly.sensor, full_scale=self.full_scale)
        seconds["noise (gaussian)"], measurement = cpu(sensor.expose, exposure, np.random.default_rng(0))
        physical = replace(sensor, noise=PhysicalNoise())
        seconds["(noise, physical)"], _ = cpu(physical.expose, exposure, np.random.default_rng(0))
        sample = Sample(measurement, sensor.noiseless(exposure), clip.rgb, clip.depth_m, clip.valid, 0)
        seconds["EXR files"], _ = cpu(write_sample, folder, "train", index, sample)
        return seconds


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--backend", choices=("auto", "llvm", "scalar"), default="auto")
    backend = choose_backend(parser.parse_args().backend).variant
    activate(backend, threads=1)
    makers = {"image alone": Maker("0", backend), "with its margin": Maker("auto", backend)}
    rows: dict[str, list[dict[str, float]]] = {name: [] for name in makers}
    with tempfile.TemporaryDirectory() as folder:
        for index in range(ROUNDS + 1):
            for name, maker in makers.items():
                seconds = maker.sample(index, Path(folder) / name)
                if index:  # the first one compiles and reads
                    rows[name].append(seconds)
    print(f"{backend}, margin {makers['with its margin'].assembly.view.margin}, median of {ROUNDS} samples, CPU-s")
    print(f"{'':22}" + "".join(f"{name:>18}" for name in makers))
    totals = dict.fromkeys(makers, 0.0)
    for stage in next(iter(rows.values()))[0]:
        values = {name: median(seconds[stage] for seconds in rows[name]) for name in makers}
        if not stage.startswith("("):
            totals = {name: totals[name] + values[name] for name in makers}
        print(f"{stage:22}" + "".join(f"{value:18.3f}" for value in values.values()))
    print(f"{'one sample':22}" + "".join(f"{value:18.3f}" for value in totals.values()))
    print(f"ratio {totals['with its margin'] / totals['image alone']:.2f}")
    print(f"prepare the model (once per worker): {', '.join(f'{maker.prepared:.2f}' for maker in makers.values())}")


if __name__ == "__main__":
    main()
