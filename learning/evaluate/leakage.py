"""Train-test leakage: scenes that decide must be new to every method; what saw them before is refused."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from learning.tune.study import load_tuned
from simulator.dataset.reader import Dataset
from simulator.errors import InputError

_USED = {"train": "learned from", "validation": "was chosen among its own steps by"}


def check_learned(name: str, path: Path, record: Mapping[str, Any], test: Dataset) -> None:
    """Refuse a network that knows the test scenes, be it from the training of the checkpoint that it began with.

    Args:
        name: of the method.
        path: its checkpoint, for messages.
        record: what the checkpoint says of its making; ``data sets`` in it, at any depth, hold fingerprints by split.
        test: the scenes that decide.

    Raises:
        InputError: the scenes are those of its train split, or of the validation split by which its best step was chosen.
    """
    for used in _data_sets(record):
        for split, words in _USED.items():
            known = used.get(split)
            fingerprint = known.get("fingerprint") if isinstance(known, Mapping) else None
            if (fingerprint, split) == (test.fingerprint, test.split):
                msg = (
                    f"{name}: {path} {words} the scenes that decide here, split {test.split!r} of {test.root}; evaluate on "
                    "its test split, or on another data set"
                )
                raise InputError(msg)


def check_tuned(name: str, tuned: Path, test: Dataset) -> None:
    """Refuse parameters of a method that `flatlight tune` found on the test scenes.

    Raises:
        InputError: the scenes are those that were tuned on, or the file cannot be read.
    """
    content = load_tuned(tuned).content["identity"]
    if (content.get("data"), content.get("split")) == (test.fingerprint, test.split):
        msg = (
            f"{name}: {tuned} was tuned on the scenes that decide here, split {test.split!r}; tune on validation scenes"
        )
        raise InputError(msg)


def _data_sets(record: Mapping[str, Any]) -> Iterator[Mapping[str, Any]]:
    for key, value in record.items():
        if isinstance(value, Mapping):
            if key == "data sets":
                yield value
            yield from _data_sets(value)
