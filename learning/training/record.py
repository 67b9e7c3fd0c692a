"""What a checkpoint says of its making: what one needs to make it again, and nothing of the machine's folders."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from learning.config.train import TrainConfig

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
