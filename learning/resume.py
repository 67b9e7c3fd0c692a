"""What an interrupted training goes on from: its folder and its state; how it ends early; what its checkpoints say of it."""

from __future__ import annotations

import io
import json
import os
import shlex
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

import torch
from torch import nn

from learning.config import FileSection
from learning.provenance import read_description
from simulator.dataset.fingerprint import difference
from simulator.errors import InputError
from simulator.io.files import is_own_folder, remove_leftovers, storage_errors, write_atomic
from simulator.io.json import readable_json
from simulator.io.locks import take_lock

DESCRIPTION = "training.json"
"""What is trained on what."""
STATE = "state.pt"
"""All that a training needs to go on."""
BEST, LAST = "best.safetensors", "last.safetensors"

# What does not decide a number that is learned, or is said otherwise: `init_from` by its content, `precision` as resolved.
_FREE = ("output", "steps", "device", "log_every", "checkpoint_every_s")
_RESOLVED = ("init_from", "precision")
_FREE_OF_DATA = ("cache", "workers")
_PATHS = ("output", "init_from", "data.train", "data.validation", "data.stack", "data.cache")
_FORMAT = "flatlight training state 1"


def described(
    config: dict[str, Any], data: dict[str, Any], *, precision: str, init_from: dict[str, Any] | None
) -> dict[str, Any]:
    """Return what decides the numbers of a training, plain; ``precision`` is resolved, as ``auto`` depends on the device."""
    kept = {key: value for key, value in config.items() if key not in (*_FREE, *_RESOLVED)}
    kept["data"] = {key: value for key, value in config["data"].items() if key not in _FREE_OF_DATA}
    return {"config": kept, "data sets": data, "precision": precision, "init_from": init_from}


def check_folder(folder: Path, parts: dict[str, Any]) -> None:
    """See that a folder is new, or holds the training that `described` tells of."""
    if not is_own_folder(folder, DESCRIPTION, "training"):
        return
    lines = difference(read_description(folder / DESCRIPTION, "training"), json.loads(readable_json(parts)))
    if lines and (folder / STATE).exists():
        free = f"only {', '.join(_FREE[1:])}, data.cache and data.workers may change"
        cure = f"choose another folder, or undo the change ({free})"
        raise InputError("output", f"{folder} holds a training of another configuration; {cure}:\n{lines}")


@contextmanager
def sole_use(folder: Path, parts: dict[str, Any]) -> Iterator[None]:
    """Make the folder of a training and keep other trainings out; the system forgets the lock when the process dies.

    What lies in the folder is looked at under the lock, so that no other training can change it in between. The description
    replaces that of a training that never came to save anything. An InputError says that another process trains there.
    """
    check_folder(folder, parts)  # a folder of somebody else's is not locked, nor cleared of leftovers
    with storage_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder, os.O_RDONLY)
    try:
        with storage_errors(folder):
            taken = take_lock(descriptor)
        if taken is False:  # not None: a file system without locks
            busy = f"another process trains in {folder} now; wait for it, or choose another folder"
            raise InputError("output", busy)
        check_folder(folder, parts)
        remove_leftovers(folder)
        if not (folder / STATE).exists():
            write_atomic(folder / DESCRIPTION, readable_json(parts))
        yield
    finally:
        os.close(descriptor)


@dataclass
class TrainingProgress:
    """How far a training is.

    Attributes:
        step: steps done; the position in the endless series of batches.
        seconds: spent on them, all sessions together.
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


def save_state(path: Path, network: nn.Module, optimiser: torch.optim.Optimizer, progress: TrainingProgress) -> None:
    """Write all that a training needs to go on as if it had never stopped: one file, replaced as a whole.

    It holds no random state: what is random in a step, its examples and their noise, follows from the seed and the step's
    number. On a CPU with as many threads the weights are the same bit for bit; on CUDA in general not, where some kernels
    add in the order in which threads finish (`torch.use_deterministic_algorithms`). On a StorageError the old state stays.
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


def load_state(path: Path, network: nn.Module, optimiser: torch.optim.Optimizer) -> TrainingProgress:
    """Read the state into a network and its optimiser, which are as they were built; nothing in the file is run."""
    try:
        content: dict[str, Any] = torch.load(path, map_location="cpu", weights_only=True)
        if content["format"] != _FORMAT:
            raise InputError(path, f"got {content['format']!r}, expected {_FORMAT!r} of this version of Flatlight")
        network.load_state_dict(content["network"])
        optimiser.load_state_dict(content["optimiser"])
        return TrainingProgress(**content["progress"])
    except InputError:
        raise
    except Exception as error:  # torch raises what it likes for a damaged file
        text = f"{type(error).__name__}: {str(error).splitlines()[0][:200]}"
        raise InputError(path, f"cannot be read ({text}); restore it, or delete it to begin again") from error


@dataclass
class Stop:
    """Whether somebody asked the training to stop."""

    wanted: bool = False


@contextmanager
def stop_signals() -> Iterator[Stop]:
    """Turn the first Ctrl-C, SIGTERM or SIGHUP into a request that the loop honours after its step; the second acts at once.

    A SIGHUP that is ignored (``nohup``) stays so.
    """
    stop = Stop()
    if threading.current_thread() is not threading.main_thread():  # Python lets no other thread listen
        yield stop
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        before[signal.SIGHUP] = signal.getsignal(signal.SIGHUP)

    def ask(number: int, _: FrameType | None) -> None:
        stop.wanted = True
        signal.signal(number, signal.default_int_handler)

    for number in before:
        signal.signal(number, ask)
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


class DivergedError(InputError):
    """A non-finite loss or gradient; the weights before that step are kept."""


def portable_command(command: str, path: Path | str, overrides: Sequence[str]) -> str:
    """Return the command of a training, with the last names of paths; other values with a folder in them become ``...``.

    A checkpoint says what one needs to make it again, and nothing of the machine's folders.

    Example:
        >>> portable_command("train", "/home/ann/net.yaml", ["output=/home/ann/my run", "data={train: /home/ann/set}"])
        "flatlight train net.yaml --set 'output=my run' --set data=..."
    """
    words = ["flatlight", command, Path(path).name]
    for override in overrides:
        key, _, value = override.partition("=")
        if key.strip() in _PATHS:
            value = _last_name(value)
        elif "/" in value or "\\" in value:
            value = "..."
        words += ["--set", f"{key}={value}"]
    return shlex.join(words)


def portable_config(config: FileSection) -> dict[str, Any]:
    """Return a configuration as plain data, with the last names of paths; the data sets' fingerprints say what they held."""
    plain = config.dump()
    for key in _PATHS:
        section, _, name = key.rpartition(".")
        place = plain[section] if section else plain
        if isinstance(place.get(name), str):
            place[name] = _last_name(place[name])
    return plain


def _last_name(text: str) -> str:
    """Return a path's last name, on whichever system it was written."""
    return text.strip().rstrip("/\\").replace("\\", "/").rpartition("/")[2]
