"""One process or several under torchrun: device and precision, sums over processes."""

from __future__ import annotations

import gc
import inspect
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor, nn
from torch.nn.parallel import DistributedDataParallel

from learning.method import Estimate, choose_device
from simulator.errors import InputError

_LONGEST = timedelta(hours=2)  # rank 0 may write or validate for long while the others wait


@dataclass(frozen=True)
class Processes:
    """This process among those that train one network: its device, its number (0 writes), and how many there are.

    ``on_this_machine`` of them share its cores.
    """

    device: torch.device
    rank: int = 0
    world_size: int = 1
    on_this_machine: int = 1

    @property
    def is_rank_zero(self) -> bool:
        """Whether this process writes files and speaks."""
        return self.rank == 0

    @property
    def on_cuda(self) -> bool:
        """Whether the device is a GPU."""
        return self.device.type == "cuda"

    def add(self, values: Tensor) -> Tensor:
        """Return the sum of a tensor over all processes."""
        if self.world_size > 1:
            values = values.clone()
            dist.all_reduce(values)
        return values

    def gather(self, value: Any) -> list[Any]:
        """Return every process's value, plain data, by rank."""
        if self.world_size == 1:
            return [value]
        values: list[Any] = [None] * self.world_size
        dist.all_gather_object(values, value)
        return values

    def wrap(self, network: nn.Module) -> nn.Module:
        """Return the network whose gradients are means over all processes; itself where there is one."""
        if self.world_size == 1:
            return network
        # All began with the same weights and see the same statistics, so that nothing has to be sent but gradients.
        known = inspect.signature(DistributedDataParallel).parameters  # torch 2.13 gave it another name
        name = "forward_sync_buffers" if "forward_sync_buffers" in known else "broadcast_buffers"
        options: dict[str, Any] = {name: False}
        return DistributedDataParallel(network, init_sync=False, **options)


@contextmanager
def processes(device: str) -> Iterator[Processes]:
    """Join the processes that torchrun started; without it this is the only one. ``device``: see `choose_device`.

    Raises:
        InputError: CUDA is asked for and absent, or torchrun started more processes than there are GPUs.
    """
    kind = choose_device(device).type
    world_size = int(os.environ.get("WORLD_SIZE", "1"))
    if world_size == 1:
        yield Processes(torch.device(kind))
        return
    local = int(os.environ["LOCAL_RANK"])
    if kind == "cuda" and local >= torch.cuda.device_count():
        there = f"on this machine, which has {torch.cuda.device_count()} GPU(s)"
        raise InputError("device", f"torchrun started process {local + 1} {there}; lower --nproc-per-node")
    place = torch.device(kind, local) if kind == "cuda" else torch.device(kind)
    if kind == "cuda":
        torch.cuda.set_device(place)
    dist.init_process_group("nccl" if kind == "cuda" else "gloo", timeout=_LONGEST)
    try:
        yield Processes(place, dist.get_rank(), world_size, int(os.environ.get("LOCAL_WORLD_SIZE", world_size)))
    finally:
        dist.destroy_process_group()
        gc.collect()  # DistributedDataParallel holds the group in cycles; threads that outlive the interpreter abort it


@dataclass(frozen=True)
class Precision:
    """How a network is evaluated: ``float32`` or ``bfloat16``, and on which device."""

    kind: str
    device: torch.device

    @classmethod
    def choose(cls, wanted: str, device: torch.device) -> Precision:
        """Return the precision ``float32``, ``bfloat16``, or of ``auto``: bfloat16 on a CUDA device that has it."""
        fits = device.type == "cuda" and torch.cuda.is_bf16_supported(including_emulation=False)
        if wanted == "bfloat16" and device.type == "cuda" and not fits:
            name = torch.cuda.get_device_name(device)
            raise InputError("precision", f"got bfloat16, which {name} lacks; take float32, or auto")
        kind = wanted if wanted != "auto" else "bfloat16" if fits else "float32"
        return cls(kind, device)

    def autocast(self) -> torch.autocast:
        """Return the context for a network: it takes convolutions and matrix products, which come out in this precision."""
        return torch.autocast(self.device.type, torch.bfloat16, enabled=self.kind == "bfloat16")

    def estimate(self, network: nn.Module, measurement: Tensor) -> Estimate:
        """Return a network's estimate, float32, as are inversion, soft head and statistics in it."""
        with self.autocast():
            image, disparity = network(measurement)
        return Estimate(image.float(), disparity.float())
