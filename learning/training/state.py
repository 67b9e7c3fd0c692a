"""All that a training needs to go on as if it had never stopped; one file, replaced as a whole.

Randomness is no part of it: what is random in a step, its examples and their noise, follows from the seed and the step's
number. Bit for bit the same weights come out on a CPU with as many threads; on CUDA not in general, where some kernels add
in the order in which threads finish (`torch.use_deterministic_algorithms`).
"""

from __future__ import annotations

import io
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import nn

from simulator.errors import InputError
from simulator.io.files import write_atomic

_FORMAT = "flatlight training state 1"


@dataclass
class Progress:
    """How far a training is.

    Attributes:
        step: steps done; the position in the endless series of batches.
        seconds: spent on them, all sittings together.
        best: step and metrics of the best validation so far; empty before the first.
        last: the same of the last one.
        sums: of each logged number since the last line of the log.
        counted: steps in them.
        lengths: pairs of a step and the ``steps`` of the configuration from there on, which the learning rate followed; more
            than one where ``steps`` was changed.
    """

    step: int = 0
    seconds: float = 0.0
    best: dict[str, float] = field(default_factory=dict)
    last: dict[str, float] = field(default_factory=dict)
    sums: dict[str, float] = field(default_factory=dict)
    counted: int = 0
    lengths: list[list[int]] = field(default_factory=list)


def save_state(path: Path, network: nn.Module, optimiser: torch.optim.Optimizer, progress: Progress) -> None:
    """Write the state.

    Raises:
        StorageError: the place cannot be written to; the state that was there stays.
    """
    content = {
        "format": _FORMAT,
        "network": network.state_dict(),
        "optimiser": optimiser.state_dict(),
        "progress": asdict(progress),
    }
    buffer = io.BytesIO()
    torch.save(content, buffer)
    write_atomic(path, buffer.getvalue())


def load_state(path: Path, network: nn.Module, optimiser: torch.optim.Optimizer) -> Progress:
    """Read the state into a network and its optimiser, which are as they were built; nothing in the file is run.

    Raises:
        InputError: a damaged file, or the state of another network.
    """
    cure = "restore it from a copy, or delete it to begin the training again"
    try:
        content: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
        if content["format"] != _FORMAT:
            msg = f"{path}: got {content['format']!r}, expected {_FORMAT!r}; another version of Flatlight wrote it"
            raise InputError(msg)
        network.load_state_dict(content["network"])
        optimiser.load_state_dict(content["optimiser"])
        return Progress(**content["progress"])
    except InputError:
        raise
    except Exception as error:  # torch raises what it likes for a damaged file
        msg = f"{path} cannot be read ({type(error).__name__}: {str(error).splitlines()[0][:200]}); {cure}"
        raise InputError(msg) from error
