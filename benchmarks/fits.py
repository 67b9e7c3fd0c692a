"""What networks fitted to one capture reach with more and more iterations, beside methods untrained for this camera.

    uv run --extra learn python benchmarks/fits.py TEST --training TRAINING --states FOLDER [--scenes 8] \
        [--methods nstm,udn] [--iterations 2000] [--marks 100,200,500,1000] [--beside fista:iterations=2000,pnp_clips] \
        [--checkpoint best.safetensors]

TEST is a data set of clips; of its test split the first scenes of each background are taken, as many of each, as stored.
The methods know the PSFs of TRAINING. Fits take minutes to hours; their states lie in FOLDER, and the same call goes on
from there. One thread. Scores are means over the captures, also by background; seconds are per capture. Of each fit, the
residual at each mark is told in units of the noise in that capture: below 1 it explains the noise, too.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.utils.data import default_collate

from learning.camera import capture_model, measure_reference_white
from learning.checkpoint import load_checkpoint
from learning.classical.by_name import build_method
from learning.classical.clips import ClipMethod
from learning.data import Example, ExampleSet
from learning.method import Estimate
from learning.metrics import measure
from learning.models import learned_method
from simulator.dataset import open_dataset

SCORES = {"psnr": "{:6.2f}", "moving_psnr": "{:6.2f}", "ssim": "{:6.3f}", "flip": "{:6.3f}"}


def number(text: str) -> float | int | str:
    """Return a parameter's value: 200, 0.1 or a word."""
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("test", type=Path)
    parser.add_argument("--training", type=Path, required=True)
    parser.add_argument("--states", type=Path, required=True)
    parser.add_argument("--scenes", type=int, default=8)
    parser.add_argument("--methods", default="nstm,udn")
    parser.add_argument("--iterations", type=int, default=2000)
    parser.add_argument("--marks", default="100,200,500,1000")
    parser.add_argument("--beside", default="static,joint,fista,pnp_clips", help="NAME:PARAMETER=VALUE:..., ...")
    parser.add_argument("--checkpoint", type=Path)
    chosen = parser.parse_args()
    torch.set_num_threads(1)
    chosen.states.mkdir(parents=True, exist_ok=True)
    train, test = open_dataset(chosen.training, "train"), open_dataset(chosen.test, "test")
    white = measure_reference_white(train)
    capture = capture_model(test, white=white).with_assumed(capture_model(train, white=white))
    scenes = [test.stored(at).description["metadata"]["scene"] for at in range(len(test))]
    backgrounds = [str(scene.get("background", "all")) for scene in scenes]
    kinds = sorted(set(backgrounds))
    share = chosen.scenes // len(kinds)
    if share < 1:
        parser.error(f"--scenes: got {chosen.scenes}, expected at least one of each: {', '.join(kinds)}")
    places = [at for kind in kinds for at in [at for at, each in enumerate(backgrounds) if each == kind][:share]]
    every, groups = ExampleSet(test), [backgrounds[at] for at in places]
    both = {test.ids[at]: test.stored(at).measurement() for at in places}
    examples = {test.ids[at]: Example(*default_collate([tuple(every[at])])) for at in places}

    def judge(title: str, image: Iterable[Tensor], seconds: Iterable[float]) -> None:
        scores = [
            measure(Estimate(each, torch.zeros_like(each[:, :, :1])), example, capture)[0]
            for each, example in zip(image, examples.values(), strict=True)
        ]
        show(title, scores, list(seconds), groups)

    print(f"{'':38}{'group':>8}{'':4}" + "".join(f"{name:>12}" for name in SCORES) + f"{'s':>10}")
    for spec in filter(None, chosen.beside.split(",")):
        name, *settings = spec.split(":")
        parameters = {key: number(value) for key, value in (each.split("=") for each in settings)}
        judge(spec, *timed(build_method(capture, name, parameters), examples))
    if chosen.checkpoint is not None:
        network = load_checkpoint(chosen.checkpoint, capture=capture).network
        judge("VideoNet", *timed(learned_method("VideoNet", network, capture), examples))
    marks = sorted({*map(int, filter(None, chosen.marks.split(","))), chosen.iterations})
    marks = [mark for mark in marks if mark <= chosen.iterations]
    for name in filter(None, chosen.methods.split(",")):
        method = build_method(capture, name, {"iterations": chosen.iterations})
        assert isinstance(method, ClipMethod)
        fitting = method.fitting
        assert fitting is not None, f"{name} is not fitted to captures"
        fits = []
        for scene, example in examples.items():
            seen, clean = (fitting.problem.target(torch.from_numpy(each)[None]) for each in both[scene])
            noise = float((seen - clean).square().mean().sqrt())
            state = chosen.states / f"{name}_{chosen.iterations}_{scene}.pt"
            fits.append(fitting.fit(example.measurement, snapshots=marks, state=state, save_every=100))
            if missing := [mark for mark in marks if mark not in fits[-1].snapshots]:
                parser.error(f"--marks: {state} was fitted without {missing}; give its own marks, or delete it")
            of_marks = ", ".join(f"{fits[-1].snapshots[mark].residual / noise:.2f}" for mark in marks)
            print(f"{name}, {scene}: residual over noise {of_marks}; {fits[-1].seconds:.0f} s", flush=True)
        for mark in marks:
            kept = [fit.snapshots[mark] for fit in fits]
            images = (method.estimate(each.film).image for each in kept)
            judge(f"{name}, {mark} of {chosen.iterations}", images, [each.seconds for each in kept])


def timed(method: Any, examples: dict[str, Example]) -> tuple[list[Tensor], list[float]]:
    """Return a method's images of each capture, and its seconds."""
    images, seconds = [], []
    for example in examples.values():
        before = time.perf_counter()
        images.append(method.reconstruct(example.measurement).image)
        seconds.append(time.perf_counter() - before)
    return images, seconds


def show(title: str, scores: list[dict[str, float]], seconds: list[float], groups: list[str]) -> None:
    """Print the means over all captures, and over those of each group."""
    for group in dict.fromkeys(["all", *groups]):
        own = [score for score, of in zip(scores, groups, strict=True) if group in ("all", of)]
        means = [form.format(mean(score[name] for score in own)) for name, form in SCORES.items()]
        spent = f"{statistics.mean(seconds):10.2f}" if group == "all" else ""
        head = title if group == "all" else ""
        print(f"{head:38}{group:>8}{len(own):4}" + "".join(f"{each:>12}" for each in means) + spent, flush=True)


def mean(values: Iterable[float]) -> float:
    """Return the mean of what is a number: a clip in which nothing moves has no PSNR of moving pixels."""
    return statistics.mean(value for value in values if value == value)


if __name__ == "__main__":
    main()
