"""What every reconstruction gives and takes, learned or classical: estimates in sRGB codes and disparity, clock, device."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple, Protocol

import numpy as np
import torch
from torch import Tensor

from learning.camera import CaptureModel
from simulator.dataset.reader import Dataset
from simulator.errors import InputError

_PERCENTILE = 99.0
_SAMPLES = 64


def encode(radiance: Tensor, white: float) -> Tensor:
    """Return sRGB codes of linear radiance, any shape: 0 for nothing, 1 for ``white``; values outside are clipped.

    Source: IEC 61966-2-1:1999 with amendment 1.
    """
    linear = (radiance / white).clamp(0, 1)
    return torch.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear.clamp_min(0.0031308) ** (1 / 2.4) - 0.055)


def decode(picture: Tensor, white: float) -> Tensor:
    """Return the linear radiance of sRGB codes, the inverse of `encode`; codes are clipped to 0..1."""
    codes = picture.clamp(0, 1)
    linear = torch.where(codes <= 0.04045, codes / 12.92, ((codes.clamp_min(0.04045) + 0.055) / 1.055) ** 2.4)
    return linear * white


def measure_white(dataset: Dataset) -> float:
    """Return the radiance that pictures of a data set show as 1: the 99th percentile of its first 64 samples.

    One number for the whole data set; brighter light is clipped in pictures, as a camera's is.

    Raises:
        InputError: an empty split, or one whose scenes are black.
    """
    if len(dataset) == 0:
        msg = f"split {dataset.split!r} of {dataset.root} is empty; generate some of its samples first"
        raise InputError(msg)
    values = [dataset.stored(position).frame(0).rgb for position in range(min(len(dataset), _SAMPLES))]
    white = float(np.percentile(np.stack(values), _PERCENTILE))
    if white <= 0:
        msg = f"split {dataset.split!r} of {dataset.root}: its scenes are black, so pictures of them have no scale"
        raise InputError(msg)
    return white


class Estimate(NamedTuple):
    """Pictures and depths of B scenes.

    Attributes:
        picture: ``(B, 3, h, w)`` sRGB codes, nominally 0..1 (a network's are not clipped); see `learning.method`.
        disparity: ``(B, 1, h, w)``, nominally 0 (far) to 1 (near); see `CaptureModel.disparity`.
    """

    picture: Tensor
    disparity: Tensor

    def clamped(self) -> Estimate:
        """Return the same within the ranges: what metrics see, of every method alike."""
        return Estimate(self.picture.clamp(0, 1), self.disparity.clamp(0, 1))

    def depth_m(self, capture: CaptureModel) -> Tensor:
        """Return depths ``(B, 1, h, w)`` in metres, clamped to the stack's range."""
        return capture.depth_m(self.disparity)


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
