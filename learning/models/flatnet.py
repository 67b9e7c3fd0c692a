"""FlatNet3D and FlatNet2D: image and depth from one measurement of a still scene; their sizes; a trained one as a method.

Source: the thesis, sections 4.3 and 5.2.3; FlatNet: Khan et al., FlatNet: Towards Photorealistic Scene Reconstruction from
Lensless Measurements, TPAMI 2020.
"""

from __future__ import annotations

import inspect
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.layers.inversion import RegularisedInversion, noise_ratio
from learning.layers.multiscale import MultiScaleNetwork
from learning.layers.naf import NafNet
from learning.layers.padding import check_measurement
from learning.layers.unet import UNet
from learning.method import Clock, Estimate, check_choices, linear_to_srgb
from simulator.errors import InputError
from simulator.validation import now_called

_NOISE_WEIGHT = 1.0
"""Initial weight of noise / signal in lambda, the published Wiener filter's for scenes as bright at all frequencies."""
_BRIGHTEST = 4.0  # of what the soft head chooses, in white: noise in the inversion is no light
_FAINTEST, _DECADES = 1e-8, 3.0  # of noise / signal: the least that counts, and what makes its logarithm about 0 to 1


class PlaneWeights(NamedTuple):
    """Which weights of a network belong to the planes of its camera.

    Attributes:
        per_plane: names of tensors whose first axis is the planes.
        first: name of the first convolution's; its inputs are volumes, planes within, channels within, then what has none.
        volumes: how many there are.
        width: inputs of a plane of a volume.
        last: names of the last convolution's, whose outputs are some without a plane, then those of each plane; or none.
        fixed: how many have none.
        stem: how many each plane has.
    """

    per_plane: tuple[str, ...]
    first: str
    volumes: int
    width: int
    last: tuple[str, ...]
    fixed: int
    stem: int


class FlatNet(nn.Module):
    """Inversion at some planes, then a network from all of them to sRGB codes and disparity: what both FlatNets share.

    The thesis's is a U-Net with a linear output. Beyond it: NAF blocks as ``body``; lambda that follows the noise, and the
    noise's level as a further input; a ``joint`` inversion of all planes beside the plane-wise one; a ``soft`` head that
    chooses among the planes, with softmax weights, image and disparity alike, and adds what these lack.
    """

    def __init__(
        self,
        capture: CaptureModel,
        *,
        body: Literal["naf", "unet"] = "unet",
        filters: int = 16,
        blocks: int = 1,
        levels: int = 5,
        attention: bool = False,
        stem: int = 1,
        noise_aware: bool = False,
        joint: bool = False,
        head: Literal["soft", "linear"] = "linear",
        regularisation_lambda: float = 0.1,
        tikhonov: float = 1.0,
    ) -> None:
        """Build the network for a camera; see `NafNet`, `UNet` for sizes, `RegularisedInversion` for lambda and P at first.

        Raises:
            InputError: an unknown body or head, or what this body has not: blocks of the U-Net, attention of NAF blocks.
        """
        super().__init__()
        check_choices(("body", body, ("naf", "unet")), ("head", head, ("soft", "linear")))
        if (body == "naf" and attention) or (body == "unet" and blocks != 1):
            name, value = ("attention", attention) if attention else ("blocks", blocks)
            raise InputError(
                name, f"got {value} with body: {body}, which has none; leave it out, or take the other body"
            )
        planes = self.planes_of(capture)
        joint = joint and len(planes) > 1  # of one plane it is the plane-wise one
        weight = _NOISE_WEIGHT if noise_aware else None

        def inversion(joint: bool) -> RegularisedInversion:
            return RegularisedInversion(
                capture,
                planes,
                regularisation_lambda=regularisation_lambda,
                tikhonov=tikhonov,
                noise_weight=weight,
                joint=joint,
            )

        self.inversion = inversion(joint=False)
        self.joint = inversion(joint=True) if joint else None
        self.noise_aware, self.soft = noise_aware, head == "soft"
        channels, count = len(capture.stack.channels), len(planes)
        inputs = count * channels * (1 + joint) + noise_aware
        outputs = 4 + (count if self.soft else 0)
        # What a linear head begins at: the middle of both ranges; a soft one adds to what it chose.
        sizes: dict[str, Any] = {"filters": filters, "levels": levels, "stem": stem, "start": 0.0 if self.soft else 0.5}
        if body == "naf":
            self.enhancement: MultiScaleNetwork = NafNet(inputs, outputs, blocks=blocks, **sizes)
        else:
            self.enhancement = UNet(inputs, outputs, attention=attention, **sizes)
        to_srgb = torch.from_numpy(np.linalg.pinv(capture.scene_to_camera)).to(torch.get_default_dtype())
        self.register_buffer("to_srgb", to_srgb, persistent=False)
        disparities = torch.from_numpy(self.inversion.disparities).to(torch.get_default_dtype())
        self.register_buffer("disparities", disparities, persistent=False)

    to_srgb: Tensor
    disparities: Tensor

    @property
    def plane_weights(self) -> PlaneWeights:
        """Which weights belong to planes."""
        inversions = {"inversion": self.inversion, "joint": self.joint}
        of_inversions = [
            f"{name}.{key}"
            for name, each in inversions.items()
            if each is not None
            for key, _ in each.named_parameters()
        ]
        body, naf = self.enhancement, isinstance(self.enhancement, NafNet)
        return PlaneWeights(
            per_plane=tuple(of_inversions),
            first="enhancement.intro.weight" if naf else "enhancement.down.0.0.weight",
            volumes=1 if self.joint is None else 2,
            width=len(self.inversion.channels) * body.stem**2,
            last=("enhancement.head.weight", "enhancement.head.bias") if self.soft else (),
            fixed=4 * body.stem**2,
            stem=body.stem**2,
        )

    @staticmethod
    @abstractmethod
    def planes_of(capture: CaptureModel) -> Sequence[int]:
        """Return the planes of a camera's stack that the network inverts at."""

    def forward(self, measurement: Tensor) -> Estimate:
        """Return the estimate of measurements ``(B, C, H, W)``, DN / 2^bits."""
        return self.enhance(*self.invert(measurement))

    def invert(self, measurement: Tensor) -> tuple[Tensor, Tensor | None]:
        """Return volumes ``(B, V, K, C, h, w)``, plane-wise and joint, and log10 of noise / signal ``(B,)`` if it counts."""
        first = self.inversion
        check_measurement(measurement, first.offset, first.rows, first.columns)
        with torch.autocast(measurement.device.type, enabled=False):
            light = first.light(measurement)
            spectrum, noise = first.spectrum(light), noise_ratio(light) if self.noise_aware else None
            volumes = [each.volume(spectrum, noise) for each in (first, self.joint) if each is not None]
            level = None if noise is None else noise.mean(dim=1).clamp_min(_FAINTEST).log10()
            return torch.stack(volumes, dim=1), level

    def enhance(self, volumes: Tensor, noise: Tensor | None) -> Estimate:
        """Return the estimate of what `invert` gave."""
        inputs = volumes.flatten(1, 3)
        if noise is not None:
            level = (noise / _DECADES + 1)[:, None, None, None].expand(-1, 1, *volumes.shape[-2:])
            inputs = torch.cat([inputs, level.to(inputs)], dim=1)
        output = self.enhancement(inputs)
        image, disparity = output[:, :3], output[:, 3:4]
        if not self.soft:
            return Estimate(image, disparity)
        with torch.autocast(volumes.device.type, enabled=False):
            weights = output[:, 4:].to(volumes).softmax(dim=1)
            chosen = torch.einsum("ac,bkchw,bkhw->bahw", self.to_srgb, volumes[:, 0], weights)
            image = image + linear_to_srgb(chosen.clamp(0, _BRIGHTEST), 1.0, clip=False)
            return Estimate(image, disparity + torch.einsum("k,bkhw->bhw", self.disparities, weights)[:, None])


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
_THESIS: dict[str, Any] = {"noise_aware": False, "joint": False, "head": "linear"}
_OURS: dict[str, Any] = {"body": "naf", "blocks": 1, "stem": 1, "noise_aware": True, "joint": True, "head": "soft"}
SIZES: dict[str, dict[str, Any]] = {
    "thesis": {"body": "unet", "filters": 64, "levels": 5, "attention": True, "stem": 1} | _THESIS,
    "compact": _OURS | {"filters": 24, "levels": 4},
    "tiny": _OURS | {"filters": 8, "levels": 3},
}
FIRST_VERSION: dict[str, Any] = {"body": "unet", "blocks": 1} | _THESIS
"""What all networks were before checkpoints said it: version 1 of their format."""


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
        self.name, self.network, self.capture = name, network, capture

    def reconstruct(self, measurement: Tensor, clock: Clock | None = None) -> Estimate:
        """Return the estimate of measurements ``(B, C, H, W)``; stages ``inversion`` and ``network``."""
        clock = clock or Clock(measurement.device)
        training = self.network.training
        self.network.eval()  # batch normalisation by what training saw, not by this batch
        try:
            with torch.no_grad():
                with clock.stage("inversion"):
                    inverted = self.network.invert(measurement)
                with clock.stage("network"):
                    return self.network.enhance(*inverted)
        finally:
            self.network.train(training)
