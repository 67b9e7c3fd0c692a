"""What every reconstruction gives and takes, learned or classical: estimates in sRGB codes and disparity, clock, device."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any, NamedTuple, Protocol, Self

import torch
from torch import Tensor, nn

from learning.camera import CaptureModel
from simulator.errors import InputError
from simulator.text import show

Value = float | int | str
"""Of a parameter of a classical method."""
Progress = Callable[[str, int, int], None]
"""Called with a stage, what is done and how much there is in all."""
Say = Callable[[str], None]
"""Called with lines for a person."""


def linear_to_srgb(radiance: Tensor, white: float, *, clip: bool = True) -> Tensor:
    """Return sRGB codes of linear radiance, any shape: 0 for nothing, 1 for the reference ``white``.

    All else is clipped, or, without ``clip``, follows the curve's two ends. In the tensor's precision and with its gradients;
    `simulator.colour` has the curve in float64.

    Source: IEC 61966-2-1:1999 with amendment 1.
    """
    linear = (radiance / white).clamp(0, 1) if clip else radiance / white
    return torch.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear.clamp_min(0.0031308) ** (1 / 2.4) - 0.055)


def srgb_to_linear(codes: Tensor, white: float, *, clip: bool = True) -> Tensor:
    """Return the linear radiance of sRGB codes, the inverse of `linear_to_srgb`; ``clip`` clips codes to 0..1 first."""
    codes = codes.clamp(0, 1) if clip else codes
    linear = torch.where(codes <= 0.04045, codes / 12.92, ((codes.clamp_min(0.04045) + 0.055) / 1.055) ** 2.4)
    return linear * white


class Estimate(NamedTuple):
    """Images and depths of B scenes; of clips, those of N frames, ``(B, N, ...)`` in place of ``(B, ...)``.

    Attributes:
        image: ``(B, 3, h, w)`` sRGB codes, nominally 0..1 but not clipped: what is brighter than white is more than 1.
        disparity: ``(B, 1, h, w)``, nominally 0 (far) to 1 (near); see `CaptureModel.disparity`.
    """

    image: Tensor
    disparity: Tensor

    def clamped(self) -> Estimate:
        """Return the same within the ranges: what metrics see, of every method alike."""
        return Estimate(self.image.clamp(0, 1), self.disparity.clamp(0, 1))

    def depth_m(self, capture: CaptureModel) -> Tensor:
        """Return depths in metres, as many as disparities, clamped to the stack's range."""
        return capture.depth_m(self.disparity)


class Clock:
    """``seconds`` by stage, in the order of first entry, summed over calls; on CUDA a stage ends when its work is done."""

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
    """A reconstruction, of stills or of clips as its camera says.

    Attributes:
        name: in tables and figures.
        capture: the camera with its assumed PSFs.
    """

    name: str
    capture: CaptureModel

    def to(self, device: torch.device | str) -> Self:
        """Move all that it computes with to a device, and return this."""
        ...

    def reconstruct(self, measurement: Tensor, clock: Clock | None = None) -> Estimate:
        """Return the estimate of measurements ``(B, C, H, W)``, DN / 2^bits, on their device, without gradients.

        The clock, where there is one, times the stages. An InputError refuses measurements of another camera's shape.
        """
        ...


def check_choices(*choices: tuple[str, Any, Iterable[str]]) -> None:
    """Refuse a value that is not one of those known; of each argument its name, its value, and what it may be.

    Raises:
        InputError: naming the argument.
    """
    for name, value, known in choices:
        if value not in known:
            raise InputError(name, f"got {show(value)}, expected one of {', '.join(known)}")


def aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows as lines of equal columns, the first at the left, the others at the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join([row[0].ljust(widths[0]), *(text.rjust(n) for text, n in zip(row[1:], widths[1:], strict=True))])
        for row in rows
    ]


def choose_device(wanted: str) -> torch.device:
    """Return the device of a word: ``auto`` (CUDA where there is some), ``cpu`` or ``cuda``.

    Raises:
        InputError: another word, or CUDA where there is none.
    """
    cuda = torch.cuda.is_available()
    check_choices(("device", wanted, ("auto", "cpu", "cuda")))
    if wanted == "cuda" and not cuda:
        raise InputError("device", "got cuda, but torch finds no CUDA device here; take cpu, or auto")
    return torch.device("cuda" if cuda and wanted != "cpu" else "cpu")


WORTH_THREADS = 2**20
"""Numbers in an array from which on several threads pay; see `threads_for`."""


@contextmanager
def inference(network: nn.Module) -> Iterator[None]:
    """Apply a network without gradients, its batch normalisation by what training saw; its mode is restored afterwards."""
    training = network.training
    network.eval()
    try:
        with torch.no_grad():
            yield
    finally:
        network.train(training)


@contextmanager
def torch_threads(count: int | None) -> Iterator[None]:
    """Let torch compute with so many threads inside; None leaves them as they are."""
    before = torch.get_num_threads()
    torch.set_num_threads(before if count is None else count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def threads_for(numbers: int) -> AbstractContextManager[None]:
    """Let torch compute with one thread inside, where its largest arrays hold fewer numbers than `WORTH_THREADS`.

    Threads wait for each other after every operation, and spin as they wait. On two cores that others used, too, two of them
    took 3 to 68 times the CPU time of one for arrays of 120 000 numbers, and 2 to 65 times as long.
    """
    return torch_threads(None if numbers >= WORTH_THREADS else 1)


def describe_device(device: torch.device) -> str:
    """Return the processor, and for a CPU how many threads torch uses on it."""
    if device.type == "cuda":
        return torch.cuda.get_device_name(device)
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    except OSError:
        names = [platform.processor()]
    processor = (names and names[0]) or platform.machine()
    return f"{processor}, {torch.get_num_threads()} of {os.cpu_count()} threads"
