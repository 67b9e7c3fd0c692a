"""The methods that take part, each once per seed: what decides them, and how they are built for a camera."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from learning.camera import CaptureModel
from learning.checkpoint import load_checkpoint
from learning.classical.method import DEFAULTS, build_classical
from learning.config import EvaluateConfig, MethodConfig
from learning.evaluate.leakage import check_learned, check_tuned
from learning.evaluate.outcome import Kind
from learning.method import Method
from learning.models.flatnet import LearnedMethod
from learning.tune.study import load_tuned
from simulator.dataset.reader import Dataset
from simulator.io.files import sha256_file


class Entry(ABC):
    """A method with one seed.

    Attributes:
        name: how tables call it.
        kind: learned or classical.
        capture: the camera that it knows by itself; None for methods that are told.
    """

    name: str
    kind: Kind
    capture: CaptureModel | None

    @abstractmethod
    def identity(self, noise_db: float) -> dict[str, Any]:
        """Return what decides it at a level of noise, beside the camera."""

    @abstractmethod
    def note(self, noise_db: float) -> str:
        """Return what a reader should know of it at a level of noise."""

    @abstractmethod
    def build(self, capture: CaptureModel, noise_db: float, device: torch.device) -> Method:
        """Return it, ready on a device, for a camera and a level of noise.

        Raises:
            InputError: the camera has other channels or planes than a network was trained for.
        """

    def tuned_db(self, noise_db: float) -> float | None:
        """Return the level at which its parameters for a level were tuned; None where none were."""
        return None


@dataclass(frozen=True, eq=False)
class LearnedEntry(Entry):
    """A network's checkpoint."""

    name: str
    path: Path
    digest: str
    capture: CaptureModel | None
    architecture: Mapping[str, Any]
    record: Mapping[str, Any]
    kind: Kind = "learned"

    def plain(self) -> dict[str, Any]:
        """Return what results.json says of it."""
        about = {"architecture": dict(self.architecture), "record": dict(self.record)}
        return {"file": self.path.name, "sha256": self.digest, **about}

    def identity(self, noise_db: float) -> dict[str, Any]:
        """Return the file's hash."""
        return {"checkpoint": self.digest}

    def note(self, noise_db: float) -> str:
        """Return the architecture in words."""
        return ", ".join(str(self.architecture[name]) for name in ("network", "size") if name in self.architecture)

    def build(self, capture: CaptureModel, noise_db: float, device: torch.device) -> Method:
        """Return the network for a camera."""
        network = load_checkpoint(self.path, capture=capture).network
        return LearnedMethod(self.name, network.to(device), capture)


@dataclass(frozen=True, eq=False)
class ClassicalEntry(Entry):
    """A classical method, with parameters that may depend on the noise."""

    name: str
    algorithm: str
    tuned: Path | None
    parameters: Mapping[str, Any] | None
    capture: CaptureModel | None = None
    kind: Kind = "classical"

    def identity(self, noise_db: float) -> dict[str, Any]:
        """Return algorithm and parameters."""
        return {"classical": self.algorithm, "parameters": self._chosen(noise_db)[0]}

    def note(self, noise_db: float) -> str:
        """Return the parameters and where they come from."""
        parameters, level = self._chosen(noise_db)
        shown = {name: f"{value:.4g}" if isinstance(value, float) else value for name, value in parameters.items()}
        words = ", ".join(f"{name} {value}" for name, value in shown.items())
        return f"{words or 'defaults'} ({'as given' if level is None else f'tuned at {level:g} dB'})"

    def tuned_db(self, noise_db: float) -> float | None:
        """Return the level at which the parameters for a level were tuned; None where they were given."""
        return self._chosen(noise_db)[1]

    def build(self, capture: CaptureModel, noise_db: float, device: torch.device) -> Method:
        """Return the method for a camera."""
        method = build_classical(capture, self.algorithm, self._chosen(noise_db)[0]).to(device)
        method.name = self.name
        return method

    def _chosen(self, noise_db: float) -> tuple[dict[str, Any], float | None]:
        if self.tuned is None:
            return DEFAULTS[self.algorithm] | dict(self.parameters or {}), None
        parameters, level = load_tuned(self.tuned).parameters(self.algorithm, noise_db)
        return DEFAULTS[self.algorithm] | parameters, level


def read_methods(config: EvaluateConfig, test: Dataset) -> list[list[Entry]]:
    """Return the methods in their order, each a list of its seeds.

    Raises:
        InputError: a file that is missing, damaged or of another kind; a network that learned from the test scenes or was
            chosen by them, parameters that were tuned on them.
    """
    return [_seeds(config, method, test) for method in config.methods]


def _seeds(config: EvaluateConfig, method: MethodConfig, test: Dataset) -> list[Entry]:
    if method.checkpoints is None:
        assert method.classical is not None
        tuned = None if method.tuned is None else config.resolve_path(method.tuned)
        if tuned is not None:
            check_tuned(method.name, tuned, test)
        return [ClassicalEntry(method.name, method.classical, tuned, method.parameters)]
    entries: list[Entry] = []
    for text in method.checkpoints:
        path = config.resolve_path(text)
        one = load_checkpoint(path)
        check_learned(method.name, path, one.record, test)
        entries.append(LearnedEntry(method.name, path, sha256_file(path), one.capture, one.architecture, one.record))
    return entries
