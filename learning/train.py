"""Training a network on a data set: from the YAML file to checkpoints; an interrupted training goes on by itself."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from torch import nn

from learning.checkpoint import save_checkpoint
from learning.config.load import load_file
from learning.config.train import TrainConfig
from learning.training.distributed import Processes, processes, synchronise_batch_norm
from learning.training.folder import BEST, LAST, STATE
from learning.training.loop import Training
from learning.training.material import count_workers, open_examples
from learning.training.optimiser import build_optimiser, learning_rate
from learning.training.plan import Plan, held_folder, make_plan
from learning.training.record import portable_command, portable_config
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
    command = None
    if not isinstance(config, TrainConfig):
        command, config = portable_command(config, overrides), load_file(TrainConfig, config, overrides)
    with processes(config.device) as group, torch.random.fork_rng(_generators(group)):
        show_all, say_all = (show or _nothing, say or _nothing) if group.leader else (_nothing, _nothing)
        plan = make_plan(config, group, command)
        with held_folder(plan):
            training = _prepare(plan, show_all, say_all)
            first = training.progress.step
            if first < config.steps:
                say_all(_describe(training))
                with stop_signals() as stop:
                    training.run(stop)
    progress = training.progress
    return TrainResult(training.folder, progress.step - first, progress.seconds, progress.best)


def _prepare(plan: Plan, show: Callable[[str, int, int], None], say: Callable[[str], None]) -> Training:
    """Build everything, and read the state where there is one; the folder must be held, see `held_folder`."""
    config, group, material, folder = plan.config, plan.group, plan.material, plan.folder
    placed = _placed(plan.network, group)
    loss = plan.loss.to(group.device)
    optimiser = build_optimiser(placed, config.optimiser)
    begun = (folder / STATE).exists()
    progress = load_state(folder / STATE, placed, optimiser) if begun else Progress()
    if begun:
        say(f"{folder}: going on after step {progress.step} of {config.steps}")
    else:
        for line in plan.taken:
            say(line)
    if progress.step > config.steps:
        msg = f"steps: got {config.steps}, but {folder} has done {progress.step}; they can be raised, not lowered"
        raise InputError(msg)
    _note_length(progress, config, say)
    examples, held_out = (open_examples(split, config, say) for split in (material.train, material.validation))
    training = Training(
        config=config,
        folder=folder,
        capture=material.capture,
        network=placed,
        optimiser=optimiser,
        loss=loss,
        examples=examples,
        held_out=held_out,
        precision=plan.precision,
        group=group,
        workers=count_workers(config, group.ranks),
        progress=progress,
        save_network=lambda best: _save_network(training, plan, best),
        show=show,
        say=say,
    )
    return training


def _note_length(progress: Progress, config: TrainConfig, say: Callable[[str], None]) -> None:
    """Keep a record of the steps that the learning rate's schedule is stretched over, and say when they change."""
    step, steps = progress.step, config.steps
    before = progress.lengths[-1][1] if progress.lengths else steps
    if step == steps or (progress.lengths and before == steps):
        return
    progress.lengths.append([step, steps])
    if before != steps:
        last, now = (learning_rate(n, of, config.optimiser) for n, of in ((step - 1, before), (step, steps)))
        say(f"steps: {before} -> {steps} after step {step}; the learning rate goes from {last:.3g} to {now:.3g} there")


def _placed(network: nn.Module, group: Processes) -> nn.Module:
    """Bring a network to its device and to the processes that share a batch."""
    for module in network.modules():
        if isinstance(module, nn.Conv2d):
            module.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]
    if group.ranks > 1:
        network = synchronise_batch_norm(network, group.device.type)
    return network.to(group.device)


def _save_network(training: Training, plan: Plan, best: bool) -> None:
    config, progress = training.config, training.progress
    save_checkpoint(
        training.folder / (BEST if best else LAST),
        training.network,  # pyright: ignore[reportArgumentType]
        architecture={"network": config.network.name, "size": config.network.size, **config.network.changes},
        capture=training.capture,
        record={
            "name": config.name,
            "config": portable_config(config),
            "command": plan.command or "learning.train.train, called from Python",
            "data sets": plan.material.describe(),
            "start": plan.start and plan.start.record(),
            "loss": training.loss.record(),  # pyright: ignore[reportCallIssue]
            "validation": {"best": progress.best, "last": progress.last},
            "step": progress.step,
            "steps": [{"from": first, "of": steps} for first, steps in progress.lengths],
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
