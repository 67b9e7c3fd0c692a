"""What all reconstructions have in common, learned or classical, and the clock that times their stages alike."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Protocol

import torch
from torch import Tensor

from learning.capture import CaptureModel
from learning.estimate import Estimate


class Clock:
    """Seconds by stage, summed over calls; on CUDA a stage ends when its work is done.

    Attributes:
        seconds: by stage, in the order in which stages were first entered.
    """

    def __init__(self, device: torch.device | str = "cpu") -> None:
        self._device = torch.device(device)
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time what happens inside."""
        self._finish()
        start = time.perf_counter()
        yield
        self._finish()
        self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def _finish(self) -> None:
        if self._device.type == "cuda":
            torch.cuda.synchronize(self._device)


class Method(Protocol):
    """A reconstruction of still scenes.

    Attributes:
        name: in tables and figures.
        capture: the camera that it believes in.
    """

    name: str
    capture: CaptureModel

    def reconstruct(self, measurement: Tensor, clock: Clock | None = None) -> Estimate:
        """Return the estimate of measurements ``(B, C, H, W)``, DN / 2^bits, on their device; without gradients.

        Args:
            measurement: what the camera stored.
            clock: times the stages; None times nothing.
        """
        ...
