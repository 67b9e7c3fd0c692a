"""Seconds per scene and stage of the FlatNets and the classical methods, in one run on one device.

    uv run --extra learn python benchmarks/reconstruct.py DATASET [--tuned tuned.json] [--device cuda] [--repeats 7]

Learned weights cost what random ones do, so the presets' networks are built for the data set's camera as they come. The
classical methods take the parameters and the number of iterations that `flatlight tune` found, or their defaults. All share
inversion code; the graph cut is OR-tools' and runs on the CPU whatever the device. One thread, one scene at a time, methods
by turns.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch
import yaml

from learning.camera import capture_model, measure_reference_white
from learning.classical.method import DEFAULTS, build_classical
from learning.evaluate.scoring import take_times
from learning.method import Method, describe_device
from learning.models import build_network
from learning.models.flatnet import LearnedMethod
from learning.presets import preset_texts
from learning.tune.study import load_tuned
from simulator.dataset import open_dataset

REFERENCE = "FlatNet3D"
PRESETS = {REFERENCE: "flatnet3d_64", "FlatNet3D refined": "flatnet3d_refined_64", "FlatNet2D": "flatnet2d_64"}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--tuned", type=Path)
    parser.add_argument("--noise-db", type=float, default=40.0)
    parser.add_argument("--size", default="compact")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--repeats", type=int, default=7)
    chosen = parser.parse_args()
    torch.set_num_threads(1)
    device = torch.device(chosen.device)
    train = open_dataset(chosen.dataset, "train")
    capture = capture_model(train, white=measure_reference_white(train))
    methods: list[Method] = []
    for name, preset in PRESETS.items():
        keys = yaml.safe_load(preset_texts()[preset])["network"] | {"size": chosen.size}
        methods.append(LearnedMethod(name, build_network(capture, **keys).to(device), capture))
    for name in ("cls", "admm", "pnp"):
        parameters, where = DEFAULTS[name], "by default"
        if chosen.tuned is not None:
            parameters, level = load_tuned(chosen.tuned).parameters(name, chosen.noise_db)
            where = f"tuned at {level:g} dB"
        print(f"{name}, {where}: {parameters}")
        methods.append(build_classical(capture, name, parameters).to(device))
    scenes = range(min(len(train), chosen.repeats + 1))
    measurements = torch.stack([torch.from_numpy(train.stored(scene).measurement()[0]) for scene in scenes]).to(device)
    times = take_times(methods, measurements, chosen.repeats)
    reference = next(each.total for each in times if each.method == REFERENCE)
    print(f"{describe_device(device)}; medians of {chosen.repeats} scenes, ms")
    for each in times:
        stages = ", ".join(f"{stage} {1e3 * seconds:.1f}" for stage, seconds in each.stages.items())
        print(f"{each.method:<32} {1e3 * each.total:8.1f}  {each.total / reference:6.2f} x {REFERENCE}   ({stages})")


if __name__ == "__main__":
    main()
