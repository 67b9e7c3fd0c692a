"""The checkpoint that a training begins with, known by its content: a path says nothing of what lay there."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from learning.checkpoint import Checkpoint, load_checkpoint
from learning.config.train import TrainConfig
from learning.models.flatnet import FlatNet
from learning.models.transfer import transfer
from simulator.io.files import sha256_file


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
