"""A training's checkpoint made ready to be given away: filters of half the size, no paths of the machine that it is from."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from learning.checkpoint import load_checkpoint, save_checkpoint
from simulator.files import sha256_file

# Absolute, with at least two parts: `/tmp/runs`, `~/runs`, `C:\\runs`; not `W/m` or `https://...`.
_PATH = re.compile(r"""(?<![^\s'"=,(:\[])(?:~|[A-Za-z]:)?[/\\](?:[^\s'"=,/\\]+[/\\])*([^\s'"=,/\\]+)[/\\]?""")


def ship_checkpoint(source: Path | str, target: Path | str) -> None:
    """Write a checkpoint of `flatlight train` as those that Flatlight brings along: see `learning.checkpoint`.

    Filters of convolutions and PSFs are rounded to float16; all other weights and numbers stay exact. Of each absolute path
    in the record and in the PSFs' provenance the last part is left. The record tells under ``shipped`` of which file this
    is.

    Args:
        source: the file; stays as it is.
        target: the file to write, by custom ``*.safetensors``.

    Raises:
        InputError: no checkpoint, or filters beyond float16.
        StorageError: the target cannot be written.
    """
    checkpoint = load_checkpoint(source)
    stack = checkpoint.capture.stack
    shipped = {"sha256 of the training's file": sha256_file(Path(source)), "filters and PSFs": "float16"}
    save_checkpoint(
        target,
        checkpoint.network,
        architecture=checkpoint.architecture,
        capture=replace(checkpoint.capture, stack=replace(stack, provenance=without_paths(stack.provenance))),
        record=without_paths(checkpoint.record) | {"shipped": shipped},
        precision=torch.float16,
    )


def without_paths(value: Any) -> Any:
    """Return plain values in which each absolute path is replaced by its last part.

    >>> without_paths({"command": "train a.yaml --set output=/home/anna/runs/s0", "rate": "1 / s, W/m", "steps": [3]})
    {'command': 'train a.yaml --set output=s0', 'rate': '1 / s, W/m', 'steps': [3]}
    """
    if isinstance(value, dict):
        return {without_paths(key): without_paths(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [without_paths(part) for part in value]
    return _PATH.sub(r"\1", value) if isinstance(value, str) else value
