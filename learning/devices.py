"""Where tensors are computed: the CPU, or a GPU where torch finds one."""

from __future__ import annotations

import torch

from simulator.errors import InputError


def choose_device(wanted: str) -> torch.device:
    """Return the device of a word.

    Args:
        wanted: ``auto`` (CUDA where there is some), ``cpu`` or ``cuda``.

    Raises:
        InputError: another word, or CUDA where there is none.
    """
    cuda = torch.cuda.is_available()
    if wanted not in ("auto", "cpu", "cuda"):
        msg = f"device: got {wanted!r}, expected auto, cpu or cuda"
        raise InputError(msg)
    if wanted == "cuda" and not cuda:
        msg = "device: got cuda, but torch finds no CUDA device here; take cpu, or auto"
        raise InputError(msg)
    return torch.device("cuda" if cuda and wanted != "cpu" else "cpu")
