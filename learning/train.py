"""Training a network on a data set: from the YAML file to checkpoints; an interrupted training goes on by itself."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader

from learning.camera import CaptureModel, capture_model
from learning.checkpoint import Checkpoint, load_checkpoint, save_checkpoint, transfer
from learning.config import OptimiserConfig, TrainConfig, load_file
from learning.data import Batches, Example, ExampleSet, check_dataset
from learning.distributed import Precision, Processes, processes, synchronise_batch_norm
from learning.losses import ReconstructionLoss
from learning.method import measure_white
from learning.models import build_network
from learning.models.flatnet import FlatNet
from learning.resume import (
    BEST,
    LAST,
    STATE,
    Progress,
    Stop,
    described,
    diverged,
    diverged_in_validation,
    ignore_interrupts,
    load_state,
    portable_command,
    portable_config,
    save_state,
    sole_use,
    stop_signals,
    unwrapped,
)
from learning.validation import SHOWN, Log, draw, to_device, true_estimate, validate
from simulator import __version__
from simulator.dataset import open_dataset
from simulator.dataset.dataset_info import PSF_FOLDER
from simulator.dataset.psf_files import read_psf_stack
from simulator.dataset.reader import Dataset
from simulator.errors import InputError
from simulator.files import sha256_file
from simulator.optics.cache import cache_folder


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


@dataclass(frozen=True, eq=False)
class Plan:
    """What can be known of a training without its folder.

    Attributes:
        config: the configuration.
        group: the processes that share the work.
        command: that started it; None where it was called from Python.
        material: what is learned from.
        precision: of the network.
        start: the checkpoint that it begins with.
        network: with the weights to begin with, on the CPU.
        taken: lines that say what it took from ``start``.
        loss: on the CPU.
    """

    config: TrainConfig
    group: Processes
    command: str | None
    material: Material
    precision: Precision
    start: Start | None
    network: FlatNet
    taken: list[str]
    loss: ReconstructionLoss

    @property
    def folder(self) -> Path:
        """Where it writes."""
        return self.config.resolve_path(self.config.output)

    @property
    def parts(self) -> dict[str, Any]:
        """What decides its numbers; see `learning.resume.described`."""
        start = self.start and self.start.describe()
        return described(self.config.dump(), self.material.describe(), precision=self.precision.kind, start=start)


def make_plan(config: TrainConfig, group: Processes, command: str | None) -> Plan:
    """Read what a training needs and build its network, which is seeded; a mistake then leaves no folder behind.

    Raises:
        InputError: a mistake in the configuration, or data that nothing can be learned from.
    """
    material = find_material(config)
    for what, count in (("batch", config.batch), ("validation split", len(material.validation))):
        if count < group.ranks or (what == "batch" and count % group.ranks):
            msg = f"{what}: got {count} for {group.ranks} processes, which share it; choose a multiple, or other processes"
            raise InputError(msg)
    precision, start = Precision.choose(config.precision, group.device), Start.find(config)
    choices = config.loss.model_dump(exclude={"perceptual_seed"})
    loss = ReconstructionLoss(**choices, seed=config.loss.perceptual_seed)
    torch.manual_seed(config.seed)
    network = build_network(material.capture, config.network.name, config.network.size, **config.network.changes)
    taken = start.give(network) if start is not None else []
    return Plan(config, group, command, material, precision, start, network, taken, loss)


@contextmanager
def held_folder(plan: Plan) -> Iterator[None]:
    """Let the leader take the folder; the other processes wait until it has, and give up where it could not.

    Raises:
        InputError: see `learning.resume.sole_use`.
        StorageError: the folder cannot be written to.
    """
    with ExitStack() as stack:
        error = None
        if plan.group.leader:
            try:
                stack.enter_context(sole_use(plan.folder, plan.parts))
            except InputError as found:
                error = found
        told = plan.group.gather(None if error is None else str(error))[0]
        if told is not None:
            raise error or InputError(told)
        yield


_MOST_WORKERS = 8
_SHOWN = 12  # numbers in a message
_NUMBERS = ("scene_shape", "sensor_shape", "gain", "offset", "irradiance", "scene_to_camera")
_CURES = {
    "scene_shape": "scene.size",
    "sensor_shape": "camera.sensor.shape",
    "channels": "camera.sensor.readout",
    "range of depths, 1/m": "psf.near_cm, psf.far_cm",
    "mask": "camera.mask, camera.mask_to_sensor_mm",
    "scene_to_camera": "camera.scene_to_camera",
    "irradiance": "forward.vignetting",
    "offset": "camera.noise.type, camera.sensor.black_level_dn",
    "gain": "camera.exposure.full_scale",
}
"""What makes a camera, and what of the data set's configuration decides it; from coarse to fine."""


@dataclass(frozen=True)
class Material:
    """What a training learns from.

    Attributes:
        train: the split that is learned from.
        validation: the split that is measured.
        capture: the camera, with the PSFs that the inversion knows and the white of the pictures.
    """

    train: Dataset
    validation: Dataset
    capture: CaptureModel

    def describe(self) -> dict[str, Any]:
        """Return what decides a training's numbers, plain."""
        splits = {
            split.split: {"name": split.info.name, "fingerprint": split.fingerprint, "samples": len(split)}
            for split in (self.train, self.validation)
        }
        return {**splits, "stack": self.capture.stack.fingerprint, "white": self.capture.white}


def find_material(config: TrainConfig) -> Material:
    """Open the data sets of a training and look at some of their samples.

    The validation split must come from the same camera: mask, sensor, exposure and range of depths. How finely its PSFs were
    computed may differ (``psf.model``, ``psf.depths``), so that what is learned from a fast model can be measured on an exact
    one; the data set's fingerprint tells.

    Raises:
        InputError: no such data set or stack, an empty split, data that nothing can be learned from, or a validation split of
            another camera: what differs is named.
    """
    root = config.resolve_path(config.data.train)
    other = root if config.data.validation is None else config.resolve_path(config.data.validation)
    train, validation = open_dataset(root, "train"), open_dataset(other, "validation")
    for dataset in (train, validation):
        check_dataset(dataset)
    stack = config.data.stack
    known = stack if stack in ("nominal", "captured") else config.resolve_path(stack)
    capture = capture_model(train, known, white=measure_white(train))
    if other != root:
        _check_same_camera(train, validation)
    return Material(train, validation, capture)


def _check_same_camera(train: Dataset, validation: Dataset) -> None:
    """Refuse a validation split that was measured otherwise than what is learned from."""
    first, second = _camera(train), _camera(validation)
    for what, cure in _CURES.items():
        one, two = first[what], second[what]
        if np.shape(one) == np.shape(two) and (
            one == two if isinstance(one, str) else np.allclose(one, two, rtol=1e-5)
        ):
            continue
        short = " and ".join(
            f"{where} {value.tolist() if np.size(value) <= _SHOWN else 'another'}"
            for where, value in ((validation.root, np.asarray(two)), (f"data.train {train.root}", np.asarray(one)))
        )
        msg = f"data.validation: {what} differs: {short}; validate on data of the same camera ({cure})"
        raise InputError(msg)


def _camera(dataset: Dataset) -> dict[str, Any]:
    """Return what makes a data set's camera, by the names of `_CURES`."""
    capture = capture_model(dataset)
    stack = read_psf_stack(dataset.root / PSF_FOLDER)
    made = stack.provenance
    mask = made.get("mask")
    optics = f"{mask['sha256']} at {made.get('mask_to_sensor_m')} m" if mask else f"PSFs {stack.fingerprint}"
    values = {name: getattr(capture, name) for name in _NUMBERS}
    depths = np.array([1 / capture.near_m, 1 / capture.far_m])
    return {**values, "channels": " ".join(stack.channels), "mask": optics, "range of depths, 1/m": depths}


def open_examples(dataset: Dataset, config: TrainConfig, say: Callable[[str], None]) -> ExampleSet:
    """Return the examples of a split, with the noise and the cache of the configuration.

    Args:
        dataset: the split.
        config: the training.
        say: told where samples are kept.
    """
    cache = None
    place = config.data.cache
    if place:
        cache = cache_folder() / "samples" if place is True else config.resolve_path(place)
        say(f"{dataset.split}: {len(dataset)} samples, kept decoded in {cache}")
    return ExampleSet(dataset, noise_db=config.data.noise_db, seed=config.seed, cache=cache)


def count_workers(config: TrainConfig, processes: int) -> int:
    """Return how many workers each process has for reading: at most one less than there are cores for it."""
    if config.data.workers != "auto":
        return config.data.workers
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(max(cores // processes - 1, 0), _MOST_WORKERS)


@dataclass(frozen=True)
class Start:
    """A checkpoint to begin with.

    Attributes:
        path: its file.
        sha256: of the file.
        checkpoint: what it holds.
    """

    path: Path
    sha256: str
    checkpoint: Checkpoint

    @classmethod
    def find(cls, config: TrainConfig) -> Start | None:
        """Read the checkpoint of a configuration; None where it names none.

        Raises:
            InputError: no checkpoint, a damaged one, or one of another network.
        """
        if config.start is None:
            return None
        path = config.resolve_path(config.start)
        checkpoint = load_checkpoint(path, network=config.network.name)
        return cls(path, sha256_file(path), checkpoint)

    def describe(self) -> dict[str, Any]:
        """Return what decides a training's numbers, plain: its content, wherever it lies and however it is called."""
        return {"sha256": self.sha256, "architecture": self.checkpoint.architecture}

    def record(self) -> dict[str, Any]:
        """Return the same with what the network had learned from before, which an evaluation must not test it on."""
        before = {key: self.checkpoint.record.get(key) for key in ("data sets", "start")}
        return self.describe() | {"file": self.path.name} | before

    def give(self, network: FlatNet) -> list[str]:
        """Put the weights into a network, and say in lines what was taken.

        Raises:
            InputError: another size, or other channels.
        """
        return [f"{self.path.name}: {line}" for line in transfer(network, self.checkpoint)]


_CONVOLUTION = 4  # dimensions of its weights, at least: norms, biases and the inversion's P and lambda must not decay


def build_optimiser(network: nn.Module, config: OptimiserConfig) -> torch.optim.Optimizer:
    """Return AdamW over all parameters that learn; without weight decay it is Adam."""
    learning = [parameter for parameter in network.parameters() if parameter.requires_grad]
    groups = [
        {"params": [each for each in learning if each.ndim >= _CONVOLUTION], "weight_decay": config.weight_decay},
        {"params": [each for each in learning if each.ndim < _CONVOLUTION], "weight_decay": 0.0},
    ]
    return torch.optim.AdamW([group for group in groups if group["params"]], lr=config.learning_rate)


def learning_rate(step: int, steps: int, config: OptimiserConfig) -> float:
    """Return the learning rate of a step.

    Args:
        step: 0 to ``steps - 1``.
        steps: of the whole training.
        config: the optimiser's section.

    Example:
        >>> config = OptimiserConfig(learning_rate=0.1, warm_up=0.2)
        >>> [round(learning_rate(step, 10, config), 4) for step in (0, 1, 2, 6, 9)]
        [0.05, 0.1, 0.1, 0.05, 0.0038]
    """
    rising = round(config.warm_up * steps)
    if step < rising:
        return config.learning_rate * (step + 1) / rising
    if config.schedule == "constant":
        return config.learning_rate
    share = (step - rising) / (steps - rising)
    return config.learning_rate * (1 + math.cos(math.pi * share)) / 2


@dataclass(eq=False)
class Training:
    """All that a training works with.

    Attributes:
        config: its configuration.
        folder: where it writes.
        capture: the camera.
        network: on its device; what is saved.
        optimiser: of the network's parameters.
        loss: on the same device.
        examples: what is learned from.
        held_out: what is validated on.
        precision: of the network.
        group: the processes that share the work.
        workers: that read, per process.
        progress: how far it is.
        save_network: writes a checkpoint: the best so far (True), or the last.
        show: called with a stage, and how much of how much is done.
        say: called with a line.
    """

    config: TrainConfig
    folder: Path
    capture: CaptureModel
    network: nn.Module
    optimiser: torch.optim.Optimizer
    loss: nn.Module
    examples: ExampleSet
    held_out: ExampleSet
    precision: Precision
    group: Processes
    workers: int
    progress: Progress
    save_network: Callable[[bool], None]
    show: Callable[[str, int, int], None]
    say: Callable[[str], None]

    def run(self, stop: Stop) -> None:
        """Train to the end.

        Raises:
            KeyboardInterrupt: when it was asked to stop; the state is saved.
            DivergedError: a loss or gradient that is not finite.
            StorageError: the disk is full or protected; the last state is kept.
        """
        progress, config = self.progress, self.config
        log = Log(self.folder, progress.step) if self.group.leader else None
        try:
            self._run(stop, log)
        finally:
            if log is not None:
                log.close()
        self.show("steps", progress.step, config.steps)

    def _run(self, stop: Stop, log: Log | None) -> None:
        progress, config = self.progress, self.config
        wrapped = self.group.wrap(self.network)
        batches = self._batches()
        checks = self._validation_batches()
        self.network.train()
        saved = time.monotonic()
        since, logged = time.monotonic(), progress.step
        while progress.step < config.steps:
            begin = time.monotonic()
            with unwrapped():
                batch = next(batches)
            asked = self._step(wrapped, batch, stop)
            progress.seconds += time.monotonic() - begin
            self.show("steps", progress.step, config.steps)
            if progress.step % config.log_every == 0 or progress.step == config.steps:
                # Of this sitting: an earlier one may have counted steps of this line before it was stopped.
                rate = (progress.step - logged) * config.batch / (time.monotonic() - since)
                self._write_log(log, rate)
                since, logged = time.monotonic(), progress.step
            if progress.step % config.validate_every == 0 or progress.step == config.steps:
                begin = time.monotonic()
                self._validate(checks, log)
                progress.seconds += time.monotonic() - begin
                since += time.monotonic() - begin
            halted = asked if self.group.ranks > 1 else stop.wanted  # several must agree on the step
            over = halted or progress.step == config.steps
            if self.group.leader and (over or time.monotonic() - saved > config.checkpoint_every_s):
                self._save()
                saved = time.monotonic()
            if halted and progress.step < config.steps:
                self.say(f"stopped after step {progress.step} of {config.steps}; the same command goes on from there")
                raise KeyboardInterrupt

    def _step(self, wrapped: nn.Module, batch: Example, stop: Stop) -> bool:
        """Learn from a batch and return whether any process was asked to stop."""
        progress, config = self.progress, self.config
        rate = learning_rate(progress.step, config.steps, config.optimiser)
        for group in self.optimiser.param_groups:
            group["lr"] = rate
        example = to_device(batch, self.group.device)
        self.optimiser.zero_grad(set_to_none=True)
        estimate = self.precision.estimate(wrapped, example.measurement)
        terms: dict[str, Tensor] = self.loss(estimate, *true_estimate(example, self.capture), example.valid)
        terms["total"].backward()
        longest = config.optimiser.gradient_clip or float("inf")
        norm = nn.utils.clip_grad_norm_(self.network.parameters(), longest)
        own = torch.stack([value.detach().double() for value in terms.values()])
        sums = self.group.add(torch.cat([own, own.new_tensor([norm, stop.wanted])])).tolist()
        means = [value / self.group.ranks for value in sums[:-1]]
        values = dict(zip([*terms, "gradient_norm"], means, strict=True))
        if not torch.isfinite(torch.tensor(means)).all():
            self._refuse(dict(zip(terms, own.tolist(), strict=True)), float(norm))
        self.optimiser.step()
        progress.step += 1
        for name, value in values.items():
            progress.sums[name] = progress.sums.get(name, 0.0) + value
        progress.counted += 1
        return sums[-1] > 0

    def _refuse(self, terms: dict[str, float], norm: float) -> NoReturn:
        """Raise the error of a step whose numbers are none, with the ids of the processes whose loss it is."""
        progress, config, group = self.progress, self.config, self.group
        order = Batches(len(self.examples), config.batch, seed=config.seed, rank=group.rank, ranks=group.ranks)
        ids = [self.examples.dataset.ids[draw.position] for draw in order.batch(progress.step)]
        finite = bool(torch.isfinite(torch.tensor(list(terms.values()))).all())
        reports = group.gather((finite, ids, terms, norm))
        guilty = [report for report in reports if not report[0]] or reports
        every = [identifier for report in guilty for identifier in report[1]]
        raise diverged(progress.step + 1, guilty[0][2], guilty[0][3], every, self._kept())

    def _kept(self) -> str:
        there = (self.folder / STATE).exists()
        return f"the state in {self.folder} is that of an earlier step" if there else "nothing is saved yet"

    def _batches(self) -> Iterator[Example]:
        config, group = self.config, self.group
        order = Batches(
            len(self.examples),
            config.batch,
            seed=config.seed,
            first=self.progress.step,
            rank=group.rank,
            ranks=group.ranks,
        )
        return iter(self._loader(self.examples, order, self.workers))

    def _validation_batches(self) -> DataLoader[Example]:
        own = list(range(self.group.rank, len(self.held_out), self.group.ranks))
        size = max(self.config.batch // self.group.ranks, 1)
        parts = [own[first : first + size] for first in range(0, len(own), size)]
        return self._loader(self.held_out, parts, min(self.workers, 1))

    def _loader(self, examples: ExampleSet, order: Batches | list[list[int]], workers: int) -> DataLoader[Example]:
        return DataLoader(
            examples,
            batch_sampler=order,
            num_workers=workers,
            pin_memory=self.group.device.type == "cuda",
            worker_init_fn=ignore_interrupts,
            persistent_workers=workers > 0,
            generator=torch.Generator(),  # its own: the loader draws a number from it that nothing uses
        )

    def _write_log(self, log: Log | None, rate: float) -> None:
        progress, config = self.progress, self.config
        means = {name: value / progress.counted for name, value in progress.sums.items()}
        means["learning_rate"] = learning_rate(progress.step - 1, config.steps, config.optimiser)
        means["samples_per_second"] = rate
        progress.sums, progress.counted = {}, 0
        if log is not None:
            log.write(progress.step, "train", means)

    def _validate(self, batches: DataLoader[Example], log: Log | None) -> None:
        progress = self.progress
        metrics = validate(self.network, batches, self.loss, self.capture, precision=self.precision, group=self.group)
        if not all(map(math.isfinite, metrics.values())):
            raise diverged_in_validation(progress.step, metrics, self._kept())
        progress.last = {"step": progress.step, **metrics}
        better = metrics["total"] < progress.best.get("total", float("inf"))
        if better:
            progress.best = progress.last
        if log is not None:
            log.write(progress.step, "validation", metrics)
            shown = torch.utils.data.default_collate([self.held_out[n] for n in range(min(SHOWN, len(self.held_out)))])
            example = to_device(shown, self.group.device)
            log.show(progress.step, draw(self.network, example, self.capture, precision=self.precision))
            if better:
                self.save_network(True)
        self.say(
            f"step {progress.step}: validation loss {metrics['total']:.4g}, PSNR {metrics['psnr_db']:.2f} dB, depth RMSE "
            f"{metrics['depth_rmse_cm']:.2f} cm{' (best)' if better else ''}"
        )

    def _save(self) -> None:
        if self.progress.step == self.config.steps:
            self.save_network(False)  # before the state that says that all is done
        save_state(self.folder / STATE, self.network, self.optimiser, self.progress)
