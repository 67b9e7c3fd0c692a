"""Seconds per scene and stage, and memory, of the networks and the classical methods, on one device.

Those of stills, of clips of one plane, or of clips with depth: which, the data set says.

    uv run --extra learn python benchmarks/reconstruct.py DATASET [--tuned tuned.json] [--fitted N] \
        [--device cuda] [--repeats 7]

Learned weights cost what random ones do, so the presets' networks are built for the data set's camera as they come. The
classical methods take the parameters and the number of iterations that `flatlight tune` found, or their defaults. All share
inversion code; the graph cut is OR-tools' and runs on the CPU whatever the device. One thread, one scene at a time, methods
by turns, all in one run; then each once more in a process of its own, to see how much of the host's memory it takes beyond
what that process has when the method is built (Linux only).
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import torch
import yaml

from learning.camera import CaptureModel, capture_model, measure_reference_white
from learning.classical.by_name import ALL_DEFAULTS, build_method
from learning.classical.clip_depth import CLIP_DEPTH_DEFAULTS
from learning.classical.clips import CLIP_DEFAULTS
from learning.classical.method import DEFAULTS
from learning.evaluate.scoring import take_times
from learning.method import Method, describe_device
from learning.models import build_network, learned_method
from learning.presets import preset_texts
from learning.tune.study import load_tuned
from simulator.dataset import open_dataset

PRESETS = {"FlatNet3D": "flatnet3d_64", "FlatNet3D refined": "flatnet3d_refined_64", "FlatNet2D": "flatnet2d_64"}
FITTED = ("udn", "nstm")
VIDEONETS = {
    "VideoNet": {},
    "VideoNet from slivers": {"initial_estimate": "slivers", "measnet": True, "refinements": 0, "repeats": 0},
    "VideoNet 3D, smaller": {"dimensions": 3, "filters": 12, "levels": 3, "refinements": 1, "repeats": 0},
}
"""By what differs from the preset videonet_64."""
CLASSES = [f"class {number}" for number in range(10)]


def preset(name: str) -> dict[str, Any]:
    """Return the network of a preset."""
    return yaml.safe_load(preset_texts()[name])["network"]


def networks(capture: CaptureModel) -> dict[str, dict[str, Any]]:
    """Return the networks for a camera; all methods are compared with the first."""
    if capture.timing is None:
        return {name: preset(own) for name, own in PRESETS.items()}
    if len(capture.stack.depths_m) > 1:
        still = preset("flatnet3d_refined_64")
        return {"VideoNet3D": preset("videonet3d_64") | {"still": {"network": still.pop("name"), **still}}}
    videonets = {name: preset("videonet_64") | changes for name, changes in VIDEONETS.items()}
    return videonets | {"ActivityNet": preset("activitynet_64") | {"classes": CLASSES}}


def classical_methods(capture: CaptureModel) -> list[str]:
    """Return the names of the classical methods for a camera."""
    if capture.timing is None:
        return list(DEFAULTS)
    return list(CLIP_DEPTH_DEFAULTS if len(capture.stack.depths_m) > 1 else CLIP_DEFAULTS)


def builders(capture: CaptureModel, chosen: argparse.Namespace) -> dict[str, Callable[[], Method]]:
    """Return what builds each method for a camera; the first one is what all compare with."""
    device, kinds = torch.device(chosen.device), networks(capture)

    def network(name: str) -> Method:
        return learned_method(name, build_network(capture, **kinds[name] | {"size": chosen.size}).to(device), capture)

    def classical(name: str, parameters: Mapping[str, Any]) -> Method:
        return build_method(capture, name, parameters).to(device)

    made: dict[str, Callable[[], Method]] = {name: partial(network, name) for name in kinds}
    for name in classical_methods(capture):
        if name in FITTED and not chosen.fitted:
            continue
        parameters, where = ALL_DEFAULTS[name], "by default"
        if name in FITTED:
            parameters = parameters | {"iterations": chosen.fitted}
        elif chosen.tuned is not None:
            parameters, level = load_tuned(chosen.tuned).parameters(name, chosen.noise_db)
            where = f"tuned at {level:g} dB"
        if not chosen.only:
            print(f"{name}, {where}: {parameters}")
        made[name] = partial(classical, name, parameters)
    return made


def memory_kib(name: str) -> int:
    """Return a number of this process's status, of Linux."""
    status = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in status if line.startswith(f"{name}:"))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--tuned", type=Path)
    parser.add_argument("--noise-db", type=float, default=40.0)
    parser.add_argument("--size", default="compact")
    parser.add_argument("--device", default="cpu")
    parser.add_argument(
        "--fitted",
        type=int,
        default=0,
        metavar="N",
        help="also N iterations of methods that are fitted to each capture",
    )
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument("--only", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    torch.set_num_threads(1)
    train = open_dataset(chosen.dataset, "train")
    made = builders(capture_model(train, white=measure_reference_white(train)), chosen)
    scenes = range(min(len(train), chosen.repeats + 1))
    measurements = torch.stack([torch.from_numpy(train.stored(scene).measurement()[0]) for scene in scenes])
    measurements = measurements.to(chosen.device)
    if chosen.only:
        method = made[chosen.only]()
        Path("/proc/self/clear_refs").write_text("5")  # the peak is what there is
        before = memory_kib("VmHWM")
        method.reconstruct(measurements[:1])
        print(memory_kib("VmHWM") - before)
        return
    times = take_times([build() for build in made.values()], measurements, chosen.repeats)
    print(f"{describe_device(torch.device(chosen.device))}; medians of {chosen.repeats} scenes, ms")
    for name, each in zip(made, times, strict=True):
        command = [sys.executable, *sys.argv, "--only", name]
        peak = int(subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[-1])
        numbers = f"{1e3 * each.total:8.1f}  {each.total / times[0].total:6.2f} x {times[0].method}"
        stages = ", ".join(f"{stage} {1e3 * seconds:.1f}" for stage, seconds in each.stages.items())
        print(f"{each.method:<32} {numbers}  {peak / 2**10:5.0f} MiB   ({stages})")


if __name__ == "__main__":
    main()
