"""Reads the public weights of Super SloMo: named tensors only, never code."""

from __future__ import annotations

import datetime
from pathlib import Path
from typing import Any

from simulator.errors import InputError
from simulator.importers.raising._network import tensor_shapes

NETWORKS = {"state_dictFC": (6, 4), "state_dictAT": (20, 5)}
"""The checkpoint's two networks, by its keys, with their channels in and out: flow computation, then flow interpolation."""

_CURE = "give the public SuperSloMo.ckpt (A. Paliwal's), or its tensors named state_dictFC.conv1.weight and so on"


def read_checkpoint(path: Path) -> dict[str, dict[str, Any]]:
    """Return the float32 tensors of both networks, by the keys of :data:`NETWORKS`.

    A ``.safetensors`` file is flat, so its names are prefixed: ``state_dictFC.conv1.weight``. Any other file is read by
    ``torch.load`` with ``weights_only``, which refuses all that could run; beside numbers and tensors only the date is let
    pass at which the public file was saved.

    Raises:
        InputError: naming the file, when it is missing, is no checkpoint, or holds other tensors than the two networks need.
    """
    if not path.is_file():
        msg = f"superslomo_checkpoint: {path} is not a file; {_CURE}"
        raise InputError(msg)
    content = _safetensors(path) if path.suffix == ".safetensors" else _pickled(path)
    return {key: _network(path, content, key) for key in NETWORKS}


def _safetensors(path: Path) -> dict[str, dict[str, Any]]:
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    try:
        flat = load_file(path)
    except (SafetensorError, OSError) as error:
        msg = f"superslomo_checkpoint: cannot read {path} as safetensors: {error}; {_CURE}"
        raise InputError(msg) from error
    return {
        key: {name.removeprefix(f"{key}."): tensor for name, tensor in flat.items() if name.startswith(f"{key}.")}
        for key in NETWORKS
    }


def _pickled(path: Path) -> Any:
    import torch

    try:
        # A date holds numbers alone; without it the public file, which notes when it was saved, would not be read.
        with torch.serialization.safe_globals([datetime.datetime]):
            return torch.load(path, weights_only=True, map_location="cpu")
    except Exception as error:  # torch.load meets a foreign file with almost any exception
        # Torch's own words may end in the advice to let the file run its code.
        msg = f"superslomo_checkpoint: cannot read {path} as weights of torch ({type(error).__name__}); {_CURE}"
        raise InputError(msg) from error


def _network(path: Path, content: Any, key: str) -> dict[str, Any]:
    import torch

    found = content.get(key) if isinstance(content, dict) else None
    if not isinstance(found, dict) or not found:
        keys = ", ".join(map(str, content)) if isinstance(content, dict) else type(content).__name__
        msg = f"superslomo_checkpoint: {path} holds {keys[:200]}, expected {' and '.join(NETWORKS)}; {_CURE}"
        raise InputError(msg)
    expected = tensor_shapes(*NETWORKS[key])
    for name, shape in expected.items():
        tensor = found.get(name)
        if not isinstance(tensor, torch.Tensor) or tuple(tensor.shape) != shape or not tensor.is_floating_point():
            got = f"{tensor.dtype} {tuple(tensor.shape)}" if isinstance(tensor, torch.Tensor) else "nothing"
            msg = f"superslomo_checkpoint: {path}: {key}: {name} is {got}, expected float32 {shape}; {_CURE}"
            raise InputError(msg)
        if not torch.isfinite(tensor).all():
            msg = f"superslomo_checkpoint: {path}: {key}: {name} holds NaN or inf, the file is damaged; {_CURE}"
            raise InputError(msg)
    if unknown := sorted(set(found) - set(expected)):
        msg = f"superslomo_checkpoint: {path}: {key} also holds {', '.join(map(str, unknown[:5]))}: another network; {_CURE}"
        raise InputError(msg)
    return {name: found[name].float() for name in expected}
