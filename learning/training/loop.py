"""The loop: batches, steps, the log, validations, states to go on from."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader

from learning.batches import Batches
from learning.capture import CaptureModel
from learning.config.train import TrainConfig
from learning.data import Example, ExampleSet
from learning.training.distributed import Processes
from learning.training.folder import STATE
from learning.training.log import Log
from learning.training.optimiser import learning_rate
from learning.training.precision import Precision
from learning.training.state import Progress, save_state
from learning.training.stopping import Stop, diverged, diverged_in_validation, ignore_interrupts, unwrapped
from learning.training.targets import to_device, true_estimate
from learning.training.validation import SHOWN, draw, validate


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
