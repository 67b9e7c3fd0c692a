"""How much memory a grid will take, said before it is taken: a job that cannot fit is refused, not killed half-way."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from simulator.arrays import Array, is_torch
from simulator.errors import InputError

SHARE = 0.8  # of the machine's memory: the rest is for Python, the stack and the system
# How a container is limited: unified and legacy control groups (Linux kernel, admin-guide/cgroup-v2.rst, memory.max).
_CONTROL_GROUPS = (Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes"))


def require_memory(
    name: str, grid: tuple[int, ...], fields: float, bytes_per_sample: int, cure: str, limit_bytes: int | None = None
) -> int:
    """Return the memory that complex fields on one grid take, or refuse it before anything is allocated.

    Args:
        name: the argument that made the grid this large, for the message.
        grid: rows and columns of the padded grid.
        fields: how many of them are held at a time; parts of a field count.
        bytes_per_sample: 8 for complex64, 16 for complex128.
        cure: what to do about it, for the message.
        limit_bytes: the most that may be taken; None allows ``SHARE`` of this machine's (or container's) memory.

    Returns:
        The estimate, bytes.

    Raises:
        InputError: with the estimate, the limit and the cure.

    Example:
        >>> require_memory("oversampling", (1024, 1024), 2, 8, "use less", limit_bytes=10**9)
        16777216
        >>> require_memory("oversampling", (65536, 65536), 2, 8, "use a narrower mask", limit_bytes=10**9)
        Traceback (most recent call last):
        simulator.errors.InputError: oversampling: the grid of 65536 x 65536 samples would take 69 GB of memory, of \
which 1 GB are allowed; use a narrower mask
    """
    estimate = int(grid[0] * grid[1] * fields * bytes_per_sample)
    limit = int(SHARE * machine_bytes()) if limit_bytes is None else limit_bytes
    if estimate > limit:
        msg = (
            f"{name}: the grid of {grid[0]} x {grid[1]} samples would take {_gigabytes(estimate)} of memory, of which "
            f"{_gigabytes(limit)} are allowed; {cure}"
        )
        raise InputError(msg)
    return estimate


def free_bytes(array: Array) -> int | None:
    """Return the free memory of the GPU that holds an array; None where the machine's own memory counts."""
    if not is_torch(array) or array.device.type != "cuda":
        return None
    import torch

    return int(SHARE * torch.cuda.mem_get_info(array.device)[0])


def machine_bytes() -> int:
    """Return the memory of this machine, or of the container where that is less; huge where neither is known."""
    limits = []
    if hasattr(os, "sysconf") and "SC_PHYS_PAGES" in os.sysconf_names:
        limits.append(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    for path in _CONTROL_GROUPS:
        try:
            text = path.read_text(encoding="ascii").strip()
        except OSError:
            continue
        if text.isdigit():  # "max" where there is no limit
            limits.append(int(text))
    return min((limit for limit in limits if limit > 0), default=sys.maxsize)


def _gigabytes(count: int) -> str:
    return f"{float(f'{count / 1e9:.2g}'):g} GB"
