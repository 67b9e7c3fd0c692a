"""Parameters, floating-point operations, seconds and memory of a training step of VideoNet in 2D and 3D, for one camera.

    uv run --extra learn python benchmarks/video_training.py DATASET [--batch 4] [--rounds 3] [--precision bfloat16]

Each network has a process of its own, so that its peak of memory is its own; one thread; the joint estimate is given, as a
training keeps it. Operations are those of convolutions and matrix products (`torch.utils.flop_counter`), not those of FFTs.
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import subprocess
import sys
import time
from pathlib import Path

import torch
import yaml
from torch.utils.flop_counter import FlopCounterMode

from learning.camera import capture_model, measure_reference_white
from learning.clip_loss import ClipLoss
from learning.config import ClipLossConfig, VideoNetworkConfig
from learning.models import VideoNet, build_network
from learning.presets import preset_texts
from simulator.dataset import open_dataset

NETWORKS = {
    "2D, as in the preset": {},
    "2D, with MeasNet": {"measnet": True},
    "2D, from slivers, MeasNet": {"initial_estimate": "slivers", "measnet": True, "refinements": 0, "repeats": 0},
    "2D, U-Net as in the thesis": {"size": "thesis", "refinements": 0, "repeats": 0},
    "3D, smaller": {"dimensions": 3, "filters": 12, "levels": 3, "refinements": 1, "repeats": 0},
}
"""By what differs from the preset videonet_64."""


def one(dataset: Path, name: str, batch: int, rounds: int, precision: str) -> dict[str, float]:
    """Return the figures of one network, in this process."""
    torch.set_num_threads(1)
    train = open_dataset(dataset, "train")
    capture = capture_model(train, white=measure_reference_white(train))
    config = VideoNetworkConfig(**yaml.safe_load(preset_texts()["videonet_64"])["network"] | NETWORKS[name])
    network, loss = build_network(capture, config.name, config.size, **config.changes), ClipLoss(ClipLossConfig())
    assert isinstance(network, VideoNet)
    optimiser = torch.optim.AdamW(network.parameters())
    measurement = torch.rand(batch, len(capture.stack.channels), *capture.sensor_shape)
    start = network.initial_estimate(measurement)
    image = torch.rand(batch, capture.frames, 3, *capture.scene_shape)
    seen = measurement[:, None].expand(-1, capture.frames, -1, -1, -1)

    def step() -> None:
        optimiser.zero_grad(set_to_none=True)
        with torch.autocast("cpu", torch.bfloat16, enabled=precision == "bfloat16"):
            film = network(measurement, start)
        loss(film._replace(image=film.image.float()), image, seen)["total"].backward()
        optimiser.step()

    with FlopCounterMode(display=False) as counter, torch.no_grad():
        network(measurement, start)
    seconds = []
    for number in range(rounds + 1):
        begin = time.process_time()
        step()
        if number:
            seconds.append(time.process_time() - begin)
    return {
        "parameters": sum(each.numel() for each in network.parameters()),
        "flops": counter.get_total_flops() / batch,
        "seconds": statistics.median(seconds) / batch,
        "bytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--batch", type=int, default=4)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--precision", choices=("float32", "bfloat16"), default="float32")
    parser.add_argument("--one", choices=NETWORKS, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.one:
        print(json.dumps(one(chosen.dataset, chosen.one, chosen.batch, chosen.rounds, chosen.precision)))
        return
    print(f"{'':28} {'parameters':>10} {'GFLOP forward':>14} {'CPU s per clip':>15} {'x the first':>12} {'peak GB':>8}")
    first = None
    for name in NETWORKS:
        command = [sys.executable, *sys.argv, "--one", name]
        found = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()[-1])
        first = first or found["seconds"]
        numbers = f"{found['parameters'] / 1e6:9.2f}M {found['flops'] / 1e9:14.2f} {found['seconds']:15.3f}"
        print(f"{name:28} {numbers} {found['seconds'] / first:12.2f} {found['bytes'] / 1e9:8.2f}")


if __name__ == "__main__":
    main()
