"""Training a network on a data set: from the YAML file to checkpoints; an interrupted training goes on by itself."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import nn

from learning.capture import capture_model
from learning.checkpoint import load_checkpoint, save_checkpoint
from learning.config.load import load_file
from learning.config.train import DataConfig, TrainConfig
from learning.data import ExampleSet, check_dataset
from learning.display import measure_white
from learning.losses import ReconstructionLoss
from learning.models import build_network
from learning.training.distributed import Processes, processes, synchronise_batch_norm
from learning.training.folder import BEST, LAST, STATE, begin
from learning.training.loop import Training
from learning.training.optimiser import build_optimiser
from learning.training.precision import Precision
from learning.training.state import Progress, load_state
from learning.training.stopping import stop_signals
from simulator import __version__
from simulator.dataset import open_dataset
from simulator.dataset.reader import Dataset
from simulator.errors import InputError
from simulator.optics.cache import cache_folder

_MOST_WORKERS = 8


@dataclass(frozen=True)
class TrainResult:
    """What became of a training.

    Attributes:
        folder: holds ``best.safetensors``, ``last.safetensors`` and the rest.
        steps: taken in this sitting; 0 of a training that was finished before.
        seconds: of all sittings.
        best: step and metrics of the best validation.
    """

    folder: Path
    steps: int
    seconds: float
    best: dict[str, float]


def train(
    config: TrainConfig | Path | str,
    overrides: Sequence[str] = (),
    *,
    show: Callable[[str, int, int], None] | None = None,
    say: Callable[[str], None] | None = None,
) -> TrainResult:
    """Train a network, or go on with a training that was interrupted; under torchrun with all of its processes.

    Args:
        config: the training, or its YAML file.
        overrides: ``a.b=c`` each; of a file.
        show: called with a stage, and how much of how much is done.
        say: called with lines for a person.

    Raises:
        InputError: a mistake in the file, data that nothing can be learned from, or another training in the folder.
        KeyboardInterrupt: when it was asked to stop; the same call goes on from there.
        StorageError: the disk is full or protected; the same call goes on from the last state.
    """
    if not isinstance(config, TrainConfig):
        config = load_file(TrainConfig, config, overrides)
    with processes(config.device) as group, torch.random.fork_rng(), stop_signals() as stop:
        quiet = not group.leader
        training = _prepare(
            config, group, _nothing if quiet or show is None else show, _nothing if quiet or say is None else say
        )
        first = training.progress.step
        if first < config.steps:
            training.run(stop)
    progress = training.progress
    return TrainResult(training.folder, progress.step - first, progress.seconds, progress.best)


def _prepare(
    config: TrainConfig, group: Processes, show: Callable[[str, int, int], None], say: Callable[[str], None]
) -> Training:
    """Build everything, and read the state where there is one."""
    if config.batch % group.ranks:
        msg = f"batch: got {config.batch} for {group.ranks} processes, which share it equally; choose a multiple"
        raise InputError(msg)
    train_data, held_out = _data_sets(config)
    white = measure_white(train_data)
    stack = config.data.stack
    if stack not in ("nominal", "captured"):
        stack = config.resolve_path(stack)
    capture = capture_model(train_data, stack, white=white)
    folder = config.resolve_path(config.output)
    record = {split.split: _identity(split) for split in (train_data, held_out)}
    record["camera"] = {"stack": capture.stack.fingerprint, "white": white}
    if group.leader:
        begin(folder, config.dump(), record)
    torch.manual_seed(config.seed)
    network = build_network(capture, config.network.name, config.network.size, **config.network.changes)
    optimiser_network = _placed(network, group)
    loss = ReconstructionLoss(**config.loss.model_dump(), seed=config.seed).to(group.device)
    optimiser = build_optimiser(optimiser_network, config.optimiser)
    progress = Progress()
    if (folder / STATE).exists():
        progress = load_state(folder / STATE, optimiser_network, optimiser)
        say(f"going on after step {progress.step} of {config.steps} in {folder}")
        if progress.step > config.steps:
            msg = f"steps: got {config.steps}, but the training in {folder} has done {progress.step}; they can only be raised"
            raise InputError(msg)
    elif config.start is not None:
        from learning.models.transfer import transfer

        path = config.resolve_path(config.start)
        for line in transfer(network, load_checkpoint(path, network=config.network.name)):
            say(f"{path.name}: {line}")
    examples = _examples(train_data, config.data, config.seed, say)
    checks = _examples(held_out, config.data, config.seed, say)
    group.gather(None)  # the leader's folder is there before anybody looks for it
    training = Training(
        config=config,
        folder=folder,
        capture=capture,
        network=optimiser_network,
        optimiser=optimiser,
        loss=loss,
        examples=examples,
        held_out=checks,
        precision=Precision.choose(config.precision, group.device),
        group=group,
        workers=_workers(config.data, group),
        progress=progress,
        save_network=lambda best: _save_network(training, record, best),
        show=show,
        say=say,
    )
    return training


def _data_sets(config: TrainConfig) -> tuple[Dataset, Dataset]:
    root = config.resolve_path(config.data.train)
    other = root if config.data.validation is None else config.resolve_path(config.data.validation)
    train_data, held_out = open_dataset(root, "train"), open_dataset(other, "validation")
    for dataset in (train_data, held_out):
        check_dataset(dataset)
    for what in ("scene_shape", "sensor_shape", "channels"):
        first, second = getattr(train_data.info, what), getattr(held_out.info, what)
        if first != second:
            msg = f"data.validation: {other} has {what} {second}, data.train {first}; validate on the same camera"
            raise InputError(msg)
    return train_data, held_out


def _identity(dataset: Dataset) -> dict[str, Any]:
    return {"fingerprint": dataset.fingerprint, "name": dataset.info.name, "samples": len(dataset)}


def _placed(network: nn.Module, group: Processes) -> nn.Module:
    for module in network.modules():
        if isinstance(module, nn.Conv2d):
            module.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
    if group.ranks > 1:
        network = synchronise_batch_norm(network, group.device.type)
    return network.to(group.device)


def _examples(dataset: Dataset, config: DataConfig, seed: int, say: Callable[[str], None]) -> ExampleSet:
    cache = None
    if config.cache:
        cache = cache_folder() / "samples" if config.cache is True else Path(config.cache).expanduser()
        say(f"{dataset.split}: {len(dataset)} samples, decoded in {cache}")
    return ExampleSet(dataset, noise_db=config.noise_db, seed=seed, cache=cache)


def _workers(config: DataConfig, group: Processes) -> int:
    if config.workers != "auto":
        return config.workers
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(max(cores // group.ranks - 1, 0), _MOST_WORKERS)


def _save_network(training: Training, data: dict[str, Any], best: bool) -> None:
    config, progress = training.config, training.progress
    device = training.group.device
    metrics = {"best": progress.best, "last": progress.last}
    save_checkpoint(
        training.folder / (BEST if best else LAST),
        training.network,  # pyright: ignore[reportArgumentType]
        architecture={"network": config.network.name, "size": config.network.size, **config.network.changes},
        capture=training.capture,
        record={
            "name": config.name,
            "config": config.dump(),
            "command": shlex.join(sys.argv),
            "data sets": data,
            "loss": training.loss.record(),  # pyright: ignore[reportCallIssue]
            "metrics": metrics,
            "step": progress.step,
            "seconds": progress.seconds,
            "precision": training.precision.kind,
            "device": torch.cuda.get_device_name(device) if device.type == "cuda" else "cpu",
            "processes": training.group.ranks,
            "versions": {"flatlight": __version__, "torch": str(torch.__version__)},
        },
    )


def _nothing(*_: object) -> None:
    """Say and show nothing."""
