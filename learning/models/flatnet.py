"""FlatNet3D and FlatNet2D: image and depth from one measurement of a still scene; their sizes; a trained one as a method.

Source: the thesis, sections 4.3 and 5.2.3; FlatNet: Khan et al., FlatNet: Towards Photorealistic Scene Reconstruction from
Lensless Measurements, TPAMI 2020.
"""

from __future__ import annotations

import inspect
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.layers.inversion import RegularisedInversion
from learning.layers.unet import UNet
from learning.method import Clock, Estimate, check_choices
from simulator.errors import InputError
from simulator.validation import now_called


class FlatNet(nn.Module):
    """Inversion at some planes, then a U-Net from all of them to sRGB codes and disparity: what both networks share."""

    def __init__(
        self,
        capture: CaptureModel,
        *,
        filters: int = 16,
        levels: int = 5,
        attention: bool = False,
        stem: int = 1,
        regularisation_lambda: float = 0.1,
        tikhonov: float = 1.0,
    ) -> None:
        """Build the network for a camera: see `UNet` for its size, `RegularisedInversion` for lambda and P at first."""
        super().__init__()
        planes = self.planes_of(capture)
        self.inversion = RegularisedInversion(
            capture, planes, regularisation_lambda=regularisation_lambda, tikhonov=tikhonov
        )
        channels = len(capture.stack.channels)
        self.enhancement = UNet(
            len(planes) * channels, 4, filters=filters, levels=levels, attention=attention, stem=stem, start=0.5
        )

    @staticmethod
    @abstractmethod
    def planes_of(capture: CaptureModel) -> Sequence[int]:
        """Return the planes of a camera's stack that the network inverts at."""

    def forward(self, measurement: Tensor) -> Estimate:
        """Return the estimate of measurements ``(B, C, H, W)``, DN / 2^bits."""
        return self.enhance(self.inversion(measurement))

    def enhance(self, volume: Tensor) -> Estimate:
        """Return the estimate of the inversion's volume ``(B, K, C, h, w)``."""
        output = self.enhancement(volume.flatten(1, 2))
        return Estimate(output[:, :3], output[:, 3:])


class FlatNet3D(FlatNet):
    """Learned inversion at all depths of the stack, then a U-Net: equations 4.10 and 4.11 of the thesis."""

    @staticmethod
    def planes_of(capture: CaptureModel) -> Sequence[int]:
        """Return all planes."""
        return range(len(capture.stack.depths_m))


class FlatNet2D(FlatNet):
    """The same with the PSF of one depth only, the hyperfocal one: in the middle of the disparities."""

    @staticmethod
    def planes_of(capture: CaptureModel) -> Sequence[int]:
        """Return the hyperfocal plane."""
        return [hyperfocal_plane(capture)]


def hyperfocal_plane(capture: CaptureModel) -> int:
    """Return the plane whose PSF is nearest to those of all depths: the PSF scales with 1 / z, so the middle disparity.

    Of two equally near, the nearer to the camera.
    """
    return int(np.argmin(np.abs(capture.plane_disparities() - 0.5).round(9)))


NETWORKS: dict[str, type[FlatNet3D] | type[FlatNet2D]] = {"flatnet3d": FlatNet3D, "flatnet2d": FlatNet2D}
SIZES: dict[str, dict[str, Any]] = {
    "thesis": {"filters": 64, "levels": 5, "attention": True, "stem": 1},
    "compact": {"filters": 16, "levels": 5, "attention": False, "stem": 1},
    "tiny": {"filters": 4, "levels": 3, "attention": False, "stem": 1},
}


def build_network(capture: CaptureModel, name: str, size: str = "compact", **changes: Any) -> FlatNet:
    """Return a network of `NETWORKS` and `SIZES` for a camera, its weights drawn from torch's generator.

    ``changes`` are of the size's numbers; see `FlatNet`.

    Raises:
        InputError: an unknown name or size, or numbers that the network refuses.
    """
    check_choices(("network", name, NETWORKS), ("size", size, SIZES))
    numbers = [key for key in inspect.signature(NETWORKS[name]).parameters if key != "capture"]
    for key in changes:
        if key not in numbers:
            raise InputError(key, f"unknown; {name} has {', '.join(numbers)}{now_called(key, numbers)}")
    return NETWORKS[name](capture, **SIZES[size] | changes)


def full_architecture(architecture: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``network``, ``size`` and changes with all numbers of the size: it stays the same network when sizes change.

    Raises:
        InputError: an unknown name or size.

    Example:
        >>> full_architecture({"network": "flatnet3d", "size": "tiny", "filters": 8})["filters"]
        8
    """
    name, size = architecture.get("network"), architecture.get("size", "compact")
    check_choices(("network", name, NETWORKS), ("size", size, SIZES))
    return {"network": name, "size": size, **SIZES[size], **architecture}


class LearnedMethod:
    """A network that stands beside the classical methods; see `learning.method.Method`.

    Its weights, mode and device stay as they are, and may change between reconstructions.
    """

    def __init__(self, name: str, network: FlatNet, capture: CaptureModel) -> None:
        """Work out the inversion's W(z), as constrained least squares has it ready."""
        self.name, self.network, self.capture = name, network, capture
        self._inverse, self._made_from = self._work_out()

    def reconstruct(self, measurement: Tensor, clock: Clock | None = None) -> Estimate:
        """Return the estimate of measurements ``(B, C, H, W)``; stages ``inversion`` and ``network``."""
        clock = clock or Clock(measurement.device)
        before, now = self._made_from, _sources(self.network)
        if any(a[1:] != b[1:] or a[0].data_ptr() != b[0].data_ptr() for a, b in zip(before, now, strict=True)):
            self._inverse, self._made_from = self._work_out()
        training = self.network.training
        self.network.eval()  # batch normalisation by what training saw, not by this batch
        try:
            with torch.no_grad():
                with clock.stage("inversion"):
                    volume = self.network.inversion(measurement, self._inverse)
                with clock.stage("network"):
                    return self.network.enhance(volume)
        finally:
            self.network.train(training)

    def _work_out(self) -> tuple[Tensor, list[tuple[Tensor, int, torch.dtype]]]:
        with torch.no_grad():
            return self.network.inversion.inverse(), _sources(self.network)


def _sources(network: FlatNet) -> list[tuple[Tensor, int, torch.dtype]]:
    """Return what W follows from, with how often each was written to; as long as it is kept, none else gets its address."""
    inversion = network.inversion
    values = (inversion.log_lambda, inversion.filters, inversion.numerator)
    return [(value.detach(), value._version, value.dtype) for value in values]
