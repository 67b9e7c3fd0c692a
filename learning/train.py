"""Training a network on a data set: from the YAML file to checkpoints; an interrupted training goes on by itself."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import nn

from learning.checkpoint import load_checkpoint, save_checkpoint
from learning.config.load import load_file
from learning.config.train import TrainConfig
from learning.losses import ReconstructionLoss
from learning.models import build_network
from learning.models.flatnet import FlatNet
from learning.models.transfer import transfer
from learning.training.distributed import Processes, processes, synchronise_batch_norm
from learning.training.folder import BEST, LAST, STATE, check_folder, described, sole_use
from learning.training.loop import Training
from learning.training.material import count_workers, find_material, open_examples
from learning.training.optimiser import build_optimiser
from learning.training.precision import Precision
from learning.training.state import Progress, load_state
from learning.training.stopping import stop_signals
from simulator import __version__
from simulator.errors import InputError


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
    with processes(config.device) as group, torch.random.fork_rng(_generators(group)):
        show_all, say_all = (show or _nothing, say or _nothing) if group.leader else (_nothing, _nothing)
        training = _prepare(config, group, show_all, say_all)
        first = training.progress.step
        if first < config.steps:
            say_all(_describe(training))
            with stop_signals() as stop, sole_use(training.folder, training.parts) if group.leader else nullcontext():
                training.run(stop)
    progress = training.progress
    return TrainResult(training.folder, progress.step - first, progress.seconds, progress.best)


def _prepare(
    config: TrainConfig, group: Processes, show: Callable[[str, int, int], None], say: Callable[[str], None]
) -> Training:
    """Build everything, and read the state where there is one."""
    material = find_material(config)
    for what, count in (("batch", config.batch), ("validation split", len(material.validation))):
        if count < group.ranks or (what == "batch" and count % group.ranks):
            msg = f"{what}: got {count} for {group.ranks} processes, which share it; choose a multiple, or other processes"
            raise InputError(msg)
    folder = config.resolve_path(config.output)
    parts = described(config.dump(), material.describe())
    check_folder(folder, parts)
    torch.manual_seed(config.seed)
    network = build_network(material.capture, config.network.name, config.network.size, **config.network.changes)
    begun = (folder / STATE).exists()
    if config.start is not None and not begun:
        _warm_start(network, config, say)
    placed = _placed(network, group)
    loss = ReconstructionLoss(**config.loss.model_dump(), seed=config.seed).to(group.device)
    optimiser = build_optimiser(placed, config.optimiser)
    progress = load_state(folder / STATE, placed, optimiser) if begun else Progress()
    if begun:
        say(f"{folder}: going on after step {progress.step} of {config.steps}")
    if progress.step > config.steps:
        msg = f"steps: got {config.steps}, but {folder} has done {progress.step}; they can be raised, not lowered"
        raise InputError(msg)
    precision = Precision.choose(config.precision, group.device)
    examples, held_out = (
        open_examples(split, config.data, config.seed, say) for split in (material.train, material.validation)
    )
    training = Training(
        config=config,
        folder=folder,
        parts=parts,
        capture=material.capture,
        network=placed,
        optimiser=optimiser,
        loss=loss,
        examples=examples,
        held_out=held_out,
        precision=precision,
        group=group,
        workers=count_workers(config.data, group.ranks),
        progress=progress,
        save_network=lambda best: _save_network(training, material.describe(), best),
        show=show,
        say=say,
    )
    return training


def _warm_start(network: FlatNet, config: TrainConfig, say: Callable[[str], None]) -> None:
    """Begin with the weights of a checkpoint."""
    path = config.resolve_path(config.start or "")
    checkpoint = load_checkpoint(path, network=config.network.name)
    for line in transfer(network, checkpoint):
        say(f"{path.name}: {line}")


def _placed(network: nn.Module, group: Processes) -> nn.Module:
    """Bring a network to its device and to the processes that share a batch."""
    for module in network.modules():
        if isinstance(module, nn.Conv2d):
            module.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
    if group.ranks > 1:
        network = synchronise_batch_norm(network, group.device.type)
    return network.to(group.device)


def _save_network(training: Training, data: dict[str, Any], best: bool) -> None:
    config, progress = training.config, training.progress
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
            "validation": {"best": progress.best, "last": progress.last},
            "step": progress.step,
            "seconds": progress.seconds,
            "precision": training.precision.kind,
            "device": _device_name(training.group.device),
            "processes": training.group.ranks,
            "versions": {"flatlight": __version__, "torch": str(torch.__version__)},
        },
    )


def _describe(training: Training) -> str:
    network, group = training.network, training.group
    parameters = sum(parameter.numel() for parameter in network.parameters())
    several = f" in each of {group.ranks} processes" if group.ranks > 1 else ""
    return (
        f"{training.config.network.name}: {parameters / 1e6:.2f} million parameters, {training.precision.kind}, "
        f"{_device_name(group.device)}, {training.workers} workers{several}"
    )


def _device_name(device: torch.device) -> str:
    return (
        torch.cuda.get_device_name(device) if device.type == "cuda" else f"CPU with {torch.get_num_threads()} threads"
    )


def _generators(group: Processes) -> list[torch.device]:
    """Return the devices, beside the CPU, whose generators a training must leave as they were."""
    return [group.device] if group.device.type == "cuda" else []


def _nothing(*_: object) -> None:
    """Say and show nothing."""
