"""The loop of every training: steps, log, validations, checkpoints and states; an interrupted training resumes.

Read downwards: the folder and the data, what is decided before the folder is touched, the optimiser, and the loop; each kind
of training defines its plan, its examples, its loss and metrics, and what is drawn and saved.
"""

from __future__ import annotations

import math
import os
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Generic, NoReturn, Protocol, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.utils.data import default_collate

from learning.camera import CaptureModel
from learning.config import LoopConfig, OptimiserConfig
from learning.data import Batches, Examples, Item, Loader, check_dataset
from learning.distributed import Precision, Processes, processes
from learning.method import Progress, Say
from learning.provenance import scenes_of
from learning.resume import (
    BEST,
    LAST,
    STATE,
    DivergedError,
    Stop,
    TrainingProgress,
    described,
    load_state,
    portable_command,
    portable_config,
    save_state,
    sole_use,
    stop_signals,
)
from learning.validation import SHOWN, Log, errors_in_words, to_device
from simulator import __version__
from simulator.dataset import open_dataset
from simulator.dataset.reader import Dataset, spread_positions
from simulator.errors import InputError
from simulator.io.cache import cache_folder

_MOST_WORKERS = 8
_CONVOLUTION = 4  # dimensions of its weights, at least: norms, biases and the inversion's P and lambda must not decay


@dataclass(frozen=True)
class TrainResult:
    """What became of a training: ``folder`` holds ``best.safetensors``, ``last.safetensors`` and the rest.

    ``steps`` are those of this session, 0 of a training that was finished before; ``seconds`` are of all sessions; ``best``
    has step and metrics of the best validation.
    """

    folder: Path
    steps: int
    seconds: float
    best: dict[str, float]


def run(kind: type[Training[Any]], config: LoopConfig, progress: Progress, say: Say) -> TrainResult:
    """Train, or go on with a training that was interrupted; under torchrun with all of its processes.

    Args:
        kind: what is trained.
        config: the training, of this kind.
        progress: called with a stage, what is done and how much there is in all.
        say: called with lines for a person.

    Raises:
        InputError: a mistake in the file, data that nothing can be learned from, or another training in the folder.
        KeyboardInterrupt: when it was asked to stop; the same call goes on from there.
        StorageError: the disk is full or protected; the same call goes on from the last state.
    """
    with processes(config.device) as group, torch.random.fork_rng([group.device] if group.on_cuda else []):
        return _run(kind.plan(config, group), kind, progress, say)


def _run(plan: Plan, kind: type[Training[Any]], progress: Progress, say: Say) -> TrainResult:
    """Train; all that holds the group of processes ends with this call."""
    with held_folder(plan):
        heard = plan.group.is_rank_zero  # the other processes are silent
        training = kind(plan, progress if heard else lambda *_: None, say if heard else lambda _: None)
        first = training.progress.step
        if first < plan.config.steps:
            training.estimate_ahead()
            with stop_signals() as stop:
                training.run(stop)
    reached = training.progress
    return TrainResult(training.folder, reached.step - first, reached.seconds, reached.best)


def open_splits(config: LoopConfig) -> tuple[Dataset, Dataset]:
    """Open what is learned from and what is measured, and look at some of their samples.

    Raises:
        InputError: no such data set, an empty split, or data that nothing can be learned from.
    """
    root = config.resolve_path(config.data.train)
    other = root if config.data.validation is None else config.resolve_path(config.data.validation)
    train, validation = open_dataset(root, "train"), open_dataset(other, "validation")
    for dataset in (train, validation):
        check_dataset(dataset)
    return train, validation


def find_cache(dataset: Dataset, config: LoopConfig, say: Say) -> Path | None:
    """Return where decoded samples are kept, of which ``say`` is told; None where they are not."""
    if not (place := config.data.cache):
        return None
    cache = cache_folder() / "samples" if place is True else config.resolve_path(place)
    say(f"{dataset.split}: {len(dataset)} samples, kept decoded in {cache}")
    return cache


def count_workers(config: LoopConfig, processes: int) -> int:
    """Return how many workers each of this machine's processes has for reading: at most one less than its share of cores."""
    if config.data.workers != "auto":
        return config.data.workers
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return min(max(cores // processes - 1, 0), _MOST_WORKERS)


class RecordedLoss(Protocol):
    """The loss: a module that gives its terms by name, ``total`` among them, and a record of what they are."""

    __call__: Callable[..., dict[str, Tensor]]

    def to(self, device: torch.device, /) -> Self:
        """Return it on a device."""
        ...

    def record(self) -> dict[str, Any]:
        """Return what a checkpoint says of it."""
        ...


@dataclass(frozen=True, eq=False)
class Plan:
    """What can be known of a training without its folder.

    Attributes:
        capture: the camera, with the PSFs that the inversion knows and the reference white.
        camera: what of it decides the numbers, beside the data sets; plain.
        network: with the weights to begin with, on the CPU, as is the loss.
        architecture: all from which the network can be built anew for its camera, plain; see `learning.models`.
        init_from: the checkpoint that it begins with, identified by content, because a path does not tell what lay there;
            with what its network was trained on.
        taken: lines that say what was taken from that checkpoint.
    """

    config: LoopConfig
    group: Processes
    train: Dataset
    validation: Dataset
    capture: CaptureModel
    camera: dict[str, Any]
    network: nn.Module
    architecture: dict[str, Any]
    loss: RecordedLoss
    init_from: dict[str, Any] | None = None
    taken: Sequence[str] = ()

    def __post_init__(self) -> None:
        """Refuse what the processes cannot share."""
        size, batch, scenes = self.group.world_size, self.config.batch, len(self.validation)
        if batch % size:
            raise InputError(
                "batch", f"got {batch} for {size} processes, which share it; choose a multiple, or other processes"
            )
        if scenes < size:
            reason = f"its validation split has {scenes} samples for {size} processes, one each at least"
            raise InputError(
                "data.validation", f"{reason}; generate more (dataset.validation), or take fewer processes"
            )

    @cached_property
    def precision(self) -> Precision:
        """That of the network's body."""
        return Precision.choose(self.config.precision, self.group.device)

    @property
    def data(self) -> dict[str, Any]:
        """What decides the numbers, of data sets and camera, plain."""
        splits = {
            each.split: {"name": each.info.name, "fingerprint": each.fingerprint, "samples": len(each)}
            for each in (self.train, self.validation)
        }
        return splits | self.camera

    @cached_property
    def scenes(self) -> dict[str, list[str]]:
        """What is seen of each split, see `learning.provenance.scenes_of`: an evaluation must not test on these."""
        return {each.split: scenes_of(each) for each in (self.train, self.validation)}


@contextmanager
def held_folder(plan: Plan) -> Iterator[None]:
    """Let rank 0 take the folder; the other processes wait until it has, and give up where it could not."""
    config, start = plan.config, plan.init_from
    start = start and {key: start[key] for key in ("sha256", "architecture")}
    parts = described(config.dump(), plan.data, precision=plan.precision.kind, init_from=start)
    with ExitStack() as stack:
        error = None
        if plan.group.is_rank_zero:
            try:
                stack.enter_context(sole_use(config.resolve_path(config.output), parts))
            except InputError as found:
                error = found
        told = plan.group.gather(None if error is None else (error.path, error.reason))[0]
        if told is not None:
            raise error or InputError(*told)
        yield


def build_optimiser(
    network: nn.Module, config: OptimiserConfig, rate_of: Callable[[nn.Module], float] = lambda _: 1.0
) -> torch.optim.Optimizer:
    """Return AdamW over all parameters that learn; without weight decay it is Adam.

    Groups have their own ``rate``, a multiple of the learning rate: ``rate_of`` the module whose parameters they are. What
    has a rate of 0 gets no gradients either: nothing would clear them, and they would count in the norm that is clipped.
    """
    groups: dict[tuple[float, float], list[nn.Parameter]] = {}
    for module in network.modules():
        rate = rate_of(module)
        for parameter in module.parameters(recurse=False):
            decay = config.weight_decay if parameter.ndim >= _CONVOLUTION else 0.0
            parameter.requires_grad_(parameter.requires_grad and rate > 0)
            if parameter.requires_grad:
                groups.setdefault((rate, decay), []).append(parameter)
    return torch.optim.AdamW(
        [{"params": each, "rate": rate, "weight_decay": decay} for (rate, decay), each in groups.items()],
        lr=config.learning_rate,
    )


def learning_rate(step: int, steps: int, config: OptimiserConfig) -> float:
    """Return the learning rate of a step, 0 to ``steps - 1``: a function of the step, so that nothing has to be saved.

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


class Training(ABC, Generic[Item]):
    """The loop: batches, steps, the log, validations, states to go on from; what is trained fills in the last six methods.

    Attributes:
        command: of `flatlight`, that starts it.
        folder: where it writes; held, see `held_folder`.
        progress: how far it is.
    """

    command: ClassVar[str]

    def __init__(self, plan: Plan, progress: Progress, say: Say) -> None:
        """Build everything, and read the state where there is one."""
        self._plan, self._show, self._say = plan, progress, say
        self._config, self._group, self._capture = config, group, _ = plan.config, plan.group, plan.capture
        self.folder = config.resolve_path(config.output)
        self._network = _placed(plan.network, group)
        self._loss = plan.loss.to(group.device)
        self._optimiser = build_optimiser(self._network, config.optimiser, self._rate)
        state = self.folder / STATE
        begun = state.exists()
        self.progress = load_state(state, self._network, self._optimiser) if begun else TrainingProgress()
        step = self.progress.step
        for line in [f"{self.folder}: going on after step {step} of {config.steps}"] if begun else plan.taken:
            say(line)
        if step > config.steps:
            raise InputError("steps", f"got {config.steps}, expected at least the {step} that {self.folder} has done")
        self._note_length()
        self._examples, self._held_out = (self._open(each) for each in (plan.train, plan.validation))
        self._workers = count_workers(config, group.on_this_machine)

    def _note_length(self) -> None:
        """Keep a record of the steps that the learning rate's schedule is stretched over, and say when they change."""
        progress, step, steps = self.progress, self.progress.step, self._config.steps
        before = progress.lengths[-1][1] if progress.lengths else steps
        if step == steps or (progress.lengths and before == steps):
            return
        progress.lengths.append([step, steps])
        if before != steps:
            optimiser = self._config.optimiser
            last, now = (learning_rate(n, of, optimiser) for n, of in ((step - 1, before), (step, steps)))
            change = f"the learning rate goes from {last:.3g} to {now:.3g} there"
            self._say(f"steps: {before} -> {steps} after step {step}; {change}")

    def estimate_ahead(self) -> None:
        """Compute and keep, before the first step, what the workers would take long for; here nothing.

        A signal ends it at once; the same call goes on from there.
        """

    def run(self, stop: Stop) -> None:
        """Train to the end.

        Raises:
            KeyboardInterrupt: when it was asked to stop; the state is saved.
            DivergedError: a loss or gradient that is not finite.
            StorageError: the disk is full or protected; the last state is kept.
        """
        parameters = sum(parameter.numel() for parameter in self._network.parameters())
        several = f" in each of {self._group.world_size} processes" if self._group.world_size > 1 else ""
        self._say(
            f"{self._config.network.name}: {parameters / 1e6:.2f} million parameters, {self._plan.precision.kind}, "
            f"{_device_name(self._group.device)}, {self._workers} workers{several}"
        )
        with ExitStack() as stack:
            log = Log(self.folder, self.progress.step) if self._group.is_rank_zero else None
            if log is not None:
                stack.callback(log.close)
            loaders = self._loaders()
            for loader in loaders:
                stack.callback(loader.close)
            self._run(*loaders, stop, log)
        self._show("steps", self.progress.step, self._config.steps)

    def _loaders(self) -> tuple[Loader[Item], Loader[Item]]:
        """Return what reads the batches of this process, to learn from and to validate on."""
        config, group, pin = self._config, self._group, self._group.on_cuda
        own = list(range(group.rank, len(self._held_out), group.world_size))
        size = max(config.batch // group.world_size, 1)
        parts = [own[first : first + size] for first in range(0, len(own), size)]
        return (
            Loader(self._examples, self._order(self.progress.step), self._workers, pin_memory=pin),
            Loader(self._held_out, parts, min(self._workers, 1), pin_memory=pin),
        )

    def _order(self, first: int) -> Batches:
        config, group = self._config, self._group
        ranks = {"rank": group.rank, "world_size": group.world_size}
        return Batches(len(self._examples), config.batch, seed=config.seed, first=first, **ranks)

    def _run(self, examples: Loader[Item], held_out: Loader[Item], stop: Stop, log: Log | None) -> None:
        progress, config = self.progress, self._config
        wrapped = self._group.wrap(self._network)
        batches = iter(examples)
        self._network.train()
        saved = time.monotonic()
        since, logged = time.monotonic(), progress.step
        while progress.step < config.steps:
            begin = time.monotonic()
            asked = self._step(wrapped, next(batches), stop)
            progress.seconds += time.monotonic() - begin
            self._show("steps", progress.step, config.steps)
            if progress.step % config.log_every == 0 or progress.step == config.steps:
                # Of this session: an earlier one may have counted steps of this line before it was stopped.
                self._write_log(log, (progress.step - logged) * config.batch / (time.monotonic() - since))
                since, logged = time.monotonic(), progress.step
            if progress.step % config.validate_every == 0 or progress.step == config.steps:
                begin = time.monotonic()
                self._validate(held_out, log)
                progress.seconds += time.monotonic() - begin
                since += time.monotonic() - begin
            halted = asked if self._group.world_size > 1 else stop.wanted  # several must agree on the step
            over = halted or progress.step == config.steps
            if self._group.is_rank_zero and (over or time.monotonic() - saved > config.checkpoint_every_s):
                if progress.step == config.steps:
                    self._save_network(LAST)  # before the state that says that all is done
                save_state(self.folder / STATE, self._network, self._optimiser, progress)
                saved = time.monotonic()
            if halted and progress.step < config.steps:
                self._say(f"stopped after step {progress.step} of {config.steps}; the same command goes on from there")
                raise KeyboardInterrupt

    def _step(self, wrapped: nn.Module, batch: Item, stop: Stop) -> bool:
        """Learn from a batch and return whether any process was asked to stop."""
        progress, config = self.progress, self._config
        self._schedule()
        example = to_device(batch, self._group.device)
        self._optimiser.zero_grad(set_to_none=True)
        terms = self._terms(wrapped, example)
        terms["total"].backward()
        longest = config.optimiser.gradient_clip or float("inf")
        norm = nn.utils.clip_grad_norm_(self._network.parameters(), longest)
        own = torch.stack([value.detach().double() for value in terms.values()])
        sums = self._group.add(torch.cat([own, own.new_tensor([norm, stop.wanted])])).tolist()
        means = [value / self._group.world_size for value in sums[:-1]]
        if not all(map(math.isfinite, means)):
            self._refuse(dict(zip(terms, own.tolist(), strict=True)), float(norm))
        self._optimiser.step()
        progress.step += 1
        for name, value in zip([*terms, "gradient_norm"], means, strict=True):
            progress.sums[name] = progress.sums.get(name, 0.0) + value
        progress.counted += 1
        return sums[-1] > 0

    def _refuse(self, terms: dict[str, float], norm: float) -> NoReturn:
        """Raise the error of a non-finite step, with the samples of the processes whose loss it is."""
        ids = [self._examples.dataset.ids[draw.position] for draw in self._order(0).batch(self.progress.step)]
        reports = self._group.gather((all(map(math.isfinite, terms.values())), ids, terms, norm))
        guilty = [report for report in reports if not report[0]] or reports
        every = [identifier for report in guilty for identifier in report[1]]
        raise DivergedError(
            f"step {self.progress.step + 1}",
            f"non-finite loss or gradient ({_listed({**guilty[0][2], 'gradient': guilty[0][3]})}) for samples "
            f"{', '.join(every)}; the step was not taken, {self._kept()}. Look at these samples; a smaller "
            "optimiser.learning_rate or a gradient_clip may help, in another folder (init_from: goes on from a checkpoint)",
        )

    def _kept(self) -> str:
        saved = f"the state in {self.folder} is that of an earlier step"
        return saved if (self.folder / STATE).exists() else "nothing is saved yet"

    def _write_log(self, log: Log | None, rate: float) -> None:
        progress, config = self.progress, self._config
        means = {name: value / progress.counted for name, value in progress.sums.items()}
        means["learning_rate"] = learning_rate(progress.step - 1, config.steps, config.optimiser)
        means["samples_per_second"] = rate
        progress.sums, progress.counted = {}, 0
        if log is not None:
            log.write(progress.step, "train", means)

    def _validate(self, batches: Loader[Item], log: Log | None) -> None:
        progress, metrics = self.progress, self._metrics(batches)
        if not all(map(math.isfinite, metrics.values())):
            cure = "try precision: float32, or a smaller optimiser.learning_rate, in another output folder"
            reason = f"non-finite metrics ({_listed(metrics)}); {self._kept()}; {cure}"
            raise DivergedError(f"validation after step {progress.step}", reason)
        progress.last = {"step": progress.step, **metrics}
        better = metrics["score"] > progress.best.get("score", float("-inf"))
        if better:
            progress.best = progress.last
        if log is not None:
            log.write(progress.step, "validation", metrics)
            shown = default_collate([self._held_out[position] for position in self._shown(SHOWN)])
            example = to_device(shown, self._group.device)
            log.show(progress.step, self._drawn(example))
            if better:
                self._save_network(BEST)
        errors = f"validation {errors_in_words(metrics)}, loss {metrics['total']:.4g}"
        self._say(f"step {progress.step}: {errors}{' (best)' if better else ''}")

    def _save_network(self, name: str) -> None:
        config, plan, progress, source = self._config, self._plan, self.progress, self._config.source
        called = f"{type(self).__module__}, called from Python"
        record = {
            "name": config.name,
            "config": portable_config(config),
            "command": called if source is None else portable_command(self.command, *source),
            "data sets": plan.data,
            "scenes": plan.scenes,
            "init_from": plan.init_from,
            "loss": self._loss.record(),
            "validation": {"best": progress.best, "last": progress.last},
            "step": progress.step,
            "steps": [{"from": first, "of": steps} for first, steps in progress.lengths],
            "seconds": progress.seconds,
            "precision": plan.precision.kind,
            "device": _device_name(self._group.device),
            "processes": self._group.world_size,
            "versions": {"flatlight": __version__, "torch": str(torch.__version__)},
        }
        self._save(self.folder / name, plan.architecture, record)

    def _shown(self, count: int) -> list[int]:
        """Return the positions of what is shown of the validation split."""
        return spread_positions(len(self._held_out), count)

    def _rate(self, module: nn.Module) -> float:
        """Return the learning rate of a module's own parameters, as a multiple of the configuration's."""
        return 1.0

    def _schedule(self) -> None:
        """Set what depends on how far the training is, before a step."""
        for group in self._optimiser.param_groups:
            group["lr"] = group["rate"] * learning_rate(self.progress.step, self._config.steps, self._config.optimiser)

    @classmethod
    @abstractmethod
    def plan(cls, config: Any, group: Processes) -> Plan:
        """Read what a configuration of its kind needs, and build the network; a mistake then leaves no folder behind."""

    @abstractmethod
    def _open(self, dataset: Dataset) -> Examples[Item]:
        """Return what is read of a split."""

    @abstractmethod
    def _terms(self, wrapped: nn.Module, example: Item) -> dict[str, Tensor]:
        """Return the terms of the loss of a batch, ``total`` among them."""

    @abstractmethod
    def _metrics(self, batches: Loader[Item]) -> dict[str, float]:
        """Return means over the validation split by name; the network is left in training mode.

        Among them: ``total``, the loss, and ``score``, by whose maximum the best checkpoint is chosen. All are logged, and
        must be finite; see `learning.validation.errors_in_words` for those that people are told.
        """

    @abstractmethod
    def _drawn(self, example: Item) -> NDArray[np.uint8]:
        """Return an image of a batch, for people."""

    @abstractmethod
    def _save(self, path: Path, architecture: dict[str, Any], record: dict[str, Any]) -> None:
        """Write the network's file."""


def _listed(numbers: Mapping[str, float]) -> str:
    return ", ".join(f"{name} {value:.4g}" for name, value in numbers.items())


def _placed(network: nn.Module, group: Processes) -> nn.Module:
    """Bring a network to its device and to the processes that share a batch."""
    for module in network.modules():
        if isinstance(module, nn.Conv2d):
            module.to(memory_format=torch.channels_last)  # pyright: ignore[reportCallIssue]  torch types no such call
    if group.on_cuda and group.world_size > 1:
        network = nn.SyncBatchNorm.convert_sync_batchnorm(network)
    return network.to(group.device)


def _device_name(device: torch.device) -> str:
    if device.type == "cuda":
        return torch.cuda.get_device_name(device)
    return f"CPU with {torch.get_num_threads()} threads"
