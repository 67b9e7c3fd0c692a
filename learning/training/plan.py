"""What is decided before a training touches its folder: data, network, loss; and the folder's taking."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from learning.config.train import TrainConfig
from learning.losses import ReconstructionLoss
from learning.models import build_network
from learning.models.flatnet import FlatNet
from learning.training.distributed import Processes
from learning.training.folder import described, sole_use
from learning.training.material import Material, find_material
from learning.training.precision import Precision
from learning.training.start import Start
from simulator.errors import InputError


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
        """What decides its numbers; see `learning.training.folder.described`."""
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
        InputError: see `learning.training.folder.sole_use`.
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
