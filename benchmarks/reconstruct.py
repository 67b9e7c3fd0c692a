"""Seconds per scene and stage of the networks and the classical methods, of stills or clips, in one run on one device.

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

from learning.camera import CaptureModel, capture_model, measure_reference_white
from learning.classical.by_name import ALL_DEFAULTS, build_method
from learning.classical.clips import CLIP_DEFAULTS
from learning.classical.method import DEFAULTS
from learning.config import VideoNetworkConfig
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


def networks(capture: CaptureModel, size: str, device: torch.device) -> list[Method]:
    """Return the networks for a camera of stills or clips, with random weights; the first one is what all compare with."""
    if capture.timing is not None:
        preset = VideoNetworkConfig(**yaml.safe_load(preset_texts()["videonet_64"])["network"]).changes
        built = {
            name: build_network(capture, "videonet", size, **preset | changes) for name, changes in VIDEONETS.items()
        }
    else:
        keys = {name: yaml.safe_load(preset_texts()[preset])["network"] for name, preset in PRESETS.items()}
        built = {name: build_network(capture, **own | {"size": size}) for name, own in keys.items()}
    return [learned_method(name, network.to(device), capture) for name, network in built.items()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--tuned", type=Path)
    parser.add_argument("--noise-db", type=float, default=40.0)
    parser.add_argument("--size", default="compact")
    parser.add_argument("--device", default="cpu")
    parser.add_argument(
        "--fitted", action="store_true", help="also methods that are fitted to each capture: minutes each"
    )
    parser.add_argument("--repeats", type=int, default=7)
    chosen = parser.parse_args()
    torch.set_num_threads(1)
    device = torch.device(chosen.device)
    train = open_dataset(chosen.dataset, "train")
    capture = capture_model(train, white=measure_reference_white(train))
    methods = networks(capture, chosen.size, device)
    for name in DEFAULTS if capture.timing is None else CLIP_DEFAULTS:
        if name in FITTED and not chosen.fitted:
            continue
        parameters, where = ALL_DEFAULTS[name], "by default"
        if chosen.tuned is not None:
            parameters, level = load_tuned(chosen.tuned).parameters(name, chosen.noise_db)
            where = f"tuned at {level:g} dB"
        print(f"{name}, {where}: {parameters}")
        methods.append(build_method(capture, name, parameters).to(device))
    scenes = range(min(len(train), chosen.repeats + 1))
    measurements = torch.stack([torch.from_numpy(train.stored(scene).measurement()[0]) for scene in scenes]).to(device)
    times = take_times(methods, measurements, chosen.repeats)
    reference = times[0].total
    print(f"{describe_device(device)}; medians of {chosen.repeats} scenes, ms")
    for each in times:
        stages = ", ".join(f"{stage} {1e3 * seconds:.1f}" for stage, seconds in each.stages.items())
        print(
            f"{each.method:<32} {1e3 * each.total:8.1f}  {each.total / reference:6.2f} x {times[0].method}   ({stages})"
        )


if __name__ == "__main__":
    main()
