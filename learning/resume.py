"""What an interrupted training goes on from: its folder, its state, its record, and how it ends before its time."""

from __future__ import annotations

import fcntl
import io
import json
import os
import shlex
import signal
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

import torch
from torch import nn

from learning.config import TrainConfig
from simulator.dataset.fingerprint import difference
from simulator.dataset.plain import readable_json
from simulator.errors import InputError
from simulator.files import TEMPORARY_PREFIX, remove_leftovers, storage_errors, write_atomic

DESCRIPTION = "training.json"
"""What is trained on what."""
STATE = "state.pt"
"""All that a training needs to go on."""
METRICS = "metrics.jsonl"
"""One line per log entry and per validation."""
BEST, LAST = "best.safetensors", "last.safetensors"
TENSORBOARD = "tensorboard"
PREVIEW = "validation.png"

# What does not decide a number that is learned, or is said otherwise: `start` by its content, `precision` as it was resolved.
_FREE = ("output", "steps", "device", "log_every", "checkpoint_every_s")
_RESOLVED = ("start", "precision")
_FREE_OF_DATA = ("cache", "workers")


def check_folder(folder: Path, parts: dict[str, Any]) -> None:
    """See that a folder is new, or holds the same training.

    Args:
        folder: the folder.
        parts: see `described`.

    Raises:
        InputError: the folder holds something else, or another training: what differs is listed.
    """
    if folder.exists() and not folder.is_dir():
        msg = f"output: {folder} is a file; choose another folder"
        raise InputError(msg)
    path = folder / DESCRIPTION
    if path.exists():
        lines = difference(_read(path), json.loads(readable_json(parts)))
        if lines and (folder / STATE).exists():
            msg = (
                f"output: {folder} holds a training of another configuration; choose another folder, or undo the change "
                f"(only {', '.join(_FREE[1:])}, data.cache and data.workers may change):\n{lines}"
            )
            raise InputError(msg)
        return
    foreign = [each.name for each in sorted(folder.iterdir())] if folder.exists() else []
    foreign = [name for name in foreign if not name.startswith(TEMPORARY_PREFIX)]
    if foreign:
        msg = f"output: {folder} is not empty and holds no training ({foreign[0]}, ...); choose another folder, or empty it"
        raise InputError(msg)


@contextmanager
def sole_use(folder: Path, parts: dict[str, Any]) -> Iterator[None]:
    """Make the folder of a training and keep other trainings out; the system forgets the lock when the process dies.

    What lies in the folder is looked at under the lock, so that no other training can change it in between. The description
    replaces that of a training that never came to save anything.

    Args:
        folder: the folder; see `check_folder`.
        parts: see `described`.

    Raises:
        InputError: another process trains there, or see `check_folder`.
        StorageError: the folder cannot be written to.
    """
    check_folder(folder, parts)  # a folder of somebody else's is not locked, nor cleared of leftovers
    with storage_errors(folder):
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            msg = f"output: another process trains in {folder} now; wait for it, or choose another folder"
            raise InputError(msg) from error
        except OSError:
            pass  # a file system without locks
        check_folder(folder, parts)
        remove_leftovers(folder)
        if not (folder / STATE).exists():
            write_atomic(folder / DESCRIPTION, readable_json(parts))
        yield
    finally:
        os.close(descriptor)


def described(
    config: dict[str, Any], data: dict[str, Any], *, precision: str, start: dict[str, Any] | None
) -> dict[str, Any]:
    """Return what decides the numbers of a training.

    Args:
        config: its configuration, plain.
        data: what is known of the data sets and the camera; plain.
        precision: ``float32`` or ``bfloat16``; ``auto`` means one or the other on another device.
        start: what is known of the checkpoint that it begins with; plain.
    """
    kept = {key: value for key, value in config.items() if key not in (*_FREE, *_RESOLVED)}
    kept["data"] = {key: value for key, value in config["data"].items() if key not in _FREE_OF_DATA}
    return {"config": kept, "data sets": data, "precision": precision, "start": start}


def _read(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_bytes())
    except (OSError, ValueError) as error:
        msg = f"{path} cannot be read ({error}); restore it from a copy, or choose another output folder"
        raise InputError(msg) from error
    if not isinstance(content, dict):
        msg = f"{path} is no description of a training; restore it from a copy, or choose another output folder"
        raise InputError(msg)
    return content


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


class DivergedError(InputError):
    """The loss or its gradient is no number any more; the weights before that step are kept."""


class Stop:
    """Whether somebody asked the training to stop."""

    def __init__(self) -> None:
        self.wanted = False


@contextmanager
def stop_signals() -> Iterator[Stop]:
    """Turn the first Ctrl-C or SIGTERM into a wish that the loop sees after its step; the second acts at once."""
    stop = Stop()
    if threading.current_thread() is not threading.main_thread():  # Python lets no other thread listen
        yield stop
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

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


def ignore_interrupts(_: int) -> None:
    """Let a worker of the loader live on after Ctrl-C, which the terminal sends to it too, until the loop has finished."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def unwrapped() -> Iterator[None]:
    """Give the message of bad input in a worker of the loader without the traceback that torch wraps it in."""
    try:
        yield
    except InputError as error:
        _, found, message = str(error).rpartition("Error: ")
        if not (found and str(error).startswith("Caught ")):
            raise
        raise InputError(message.strip()) from error


def diverged(
    step: int, terms: Mapping[str, float], gradient_norm: float, ids: Sequence[str], kept: str
) -> DivergedError:
    """Return the error of a step whose loss or gradient is not finite.

    Args:
        step: number of the step, which was not taken.
        terms: of the loss.
        gradient_norm: length of the gradient.
        ids: of the samples in the batch.
        kept: what can be gone on from.
    """
    numbers = ", ".join(f"{name} {value:.4g}" for name, value in {**terms, "gradient": gradient_norm}.items())
    msg = (
        f"step {step}: the loss or its gradient is not finite ({numbers}) for samples {', '.join(ids)}; the step was not "
        f"taken, {kept}. A smaller optimiser.learning_rate or an optimiser.gradient_clip may help, in another output folder "
        "(start: goes on from a checkpoint); look at these samples first"
    )
    return DivergedError(msg)


def diverged_in_validation(step: int, metrics: Mapping[str, float], kept: str) -> DivergedError:
    """Return the error of a validation whose numbers are none.

    Args:
        step: after which it was made.
        metrics: of the validation.
        kept: what can be gone on from.
    """
    numbers = ", ".join(f"{name} {value:.4g}" for name, value in metrics.items())
    cure = "Try precision: float32, or a smaller optimiser.learning_rate, in another output folder"
    msg = f"validation after step {step} is not finite ({numbers}); {kept}. {cure}"
    return DivergedError(msg)


_PATHS = ("output", "start", "data.train", "data.validation", "data.stack", "data.cache")


def portable_command(path: Path | str, overrides: Sequence[str]) -> str:
    """Return the command of a training, with the last names of paths; other values with a folder in them become ``...``.

    Args:
        path: the YAML file.
        overrides: ``a.b=c`` each.

    Example:
        >>> portable_command("/home/ann/net.yaml", ["seed=1", "output=/home/ann/my run", "data={train: /home/ann/set}"])
        "flatlight train net.yaml --set seed=1 --set 'output=my run' --set data=..."
    """
    words = ["flatlight", "train", Path(path).name]
    for override in overrides:
        key, _, value = override.partition("=")
        if key.strip() in _PATHS:
            value = _name(value)
        elif "/" in value or "\\" in value:
            value = "..."
        words += ["--set", f"{key}={value}"]
    return shlex.join(words)


def portable_config(config: TrainConfig) -> dict[str, Any]:
    """Return a configuration as plain data, with the last names of paths; the data sets' fingerprints say what they held."""
    plain = config.dump()
    for key in _PATHS:
        section, _, name = key.rpartition(".")
        place = plain[section] if section else plain
        if isinstance(place[name], str):
            place[name] = _name(place[name])
    return plain


def _name(text: str) -> str:
    """Return a path's last name, on whichever system it was written."""
    return text.strip().rstrip("/\\").replace("\\", "/").rpartition("/")[2]
