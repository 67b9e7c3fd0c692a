"""FlatNet3D and FlatNet2D: image and depth from one measurement of a still scene; their sizes; a trained one as a method.

Source: the thesis, sections 4.3 and 5.2.3; FlatNet: Khan et al., FlatNet: Towards Photorealistic Scene Reconstruction from
Lensless Measurements, TPAMI 2020.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple, Self, cast

import numpy as np
import torch
from torch import Tensor, nn

from learning.camera import CaptureModel
from learning.layers.inversion import RegularisedInversion
from learning.layers.multiscale import MultiScaleNetwork
from learning.layers.naf import NafNet
from learning.layers.noise import level_image, noise_ratio
from learning.layers.padding import check_measurement
from learning.layers.unet import UNet
from learning.method import Clock, Estimate, check_choices, inference, linear_to_srgb
from learning.models.refinement import MOST_RADIANCE, PlaneChoice, Refinement, Surface
from simulator.errors import InputError

_NOISE_WEIGHT = 30.0
"""Initial weight of noise / signal in lambda, about what is learned: at high frequencies scenes are faint."""
_BORDER = 8
"""Pixels around the image that a network with refinements estimates, too: all that a narrow stop leaves of the field."""


class Inverted(NamedTuple):
    """What an enhancement sees.

    Attributes:
        volumes: ``(B, V, K, C, h, w)``, plane-wise and joint.
        light: ``(B, C, H, W)``, the measurement without its offset, DN / 2^bits.
        noise: ratio of noise to signal ``(B, C)``, where it counts.
    """

    volumes: Tensor
    light: Tensor
    noise: Tensor | None


class PlaneWeights(NamedTuple):
    """Which weights of a network belong to the planes of its camera.

    Attributes:
        per_plane: names of tensors whose first axis is the planes.
        first: name of the first convolution's; its inputs are volumes, planes within, channels within, then what has none.
        volumes: how many there are.
        width: inputs of a plane of a volume.
        choice: how many of these, the last ones, are a choice's weights, whose sum over the planes is 1.
        last: names of the last convolution's, whose outputs are some without a plane, then those of each plane; or none.
        fixed: how many have none.
        stem: how many each plane has.
    """

    per_plane: tuple[str, ...]
    first: str
    volumes: int
    width: int
    choice: int
    last: tuple[str, ...]
    fixed: int
    stem: int


class FlatNet(nn.Module):
    """Inversion at some planes, then a network from all of them to sRGB codes and disparity: what both FlatNets share.

    The thesis's is a U-Net with a linear output. Beyond it: NAF blocks as ``body``; lambda that follows the noise, and the
    noise's level as a further input; a ``joint`` inversion of all planes beside the plane-wise one; a ``soft`` head that
    chooses among the planes, with softmax weights, image and disparity alike, and adds what these lack; ``refinements``,
    steps that invert and enhance again what the estimate leaves unexplained, each with weights of its own; ``repeats`` of the
    last one, with shared weights, as MoDL shares them among all steps.
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
        refinements: int = 0,
        repeats: int = 0,
        head: Literal["soft", "linear"] = "linear",
        regularisation_lambda: float = 0.1,
        tikhonov: float = 1.0,
    ) -> None:
        """Build the network for a camera; see `NafNet`, `UNet` for sizes, `RegularisedInversion` for lambda and P at first.

        Raises:
            InputError: an unknown body or head, or what this one lacks: blocks of the U-Net, attention of NAF blocks,
                refinements of the U-Net or a linear head, a refinement to repeat.
        """
        super().__init__()
        if capture.timing is not None:
            raise InputError(
                "capture", f"got clips of {capture.frames} frames, but a FlatNet is for stills; take videonet"
            )
        check_choices(("body", body, ("naf", "unet")), ("head", head, ("soft", "linear")))
        if body == "naf" and attention:
            raise InputError("attention", "got true with body: naf, which has none; take false, or body: unet")
        if body == "unet" and blocks != 1:
            raise InputError("blocks", f"got {blocks} with body: unet, which has none; take 1, or body: naf")
        if refinements and (body, head) != ("naf", "soft"):
            got = f"got {refinements} with body: {body} and head: {head}"
            raise InputError("refinements", f"{got}, expected 0; or take body: naf and head: soft")
        if repeats and not refinements:
            raise InputError("repeats", f"got {repeats} without refinements, expected 0; or take refinements: 1")
        planes = self.planes_of(capture)
        joint = joint and len(planes) > 1  # of one plane it is the plane-wise one
        image = capture.scene_shape
        capture = capture.with_border(_BORDER) if refinements else capture
        self.image = capture.middle(image)
        options: dict[str, Any] = {
            "regularisation_lambda": regularisation_lambda,
            "tikhonov": tikhonov,
            "noise_weight": _NOISE_WEIGHT if noise_aware else None,
        }
        self.inversion = RegularisedInversion(capture, planes, **options)
        self.joint = RegularisedInversion(capture, planes, joint=True, **options) if joint else None
        self.noise_aware, self.soft = noise_aware, head == "soft"
        channels, count = len(capture.stack.channels), len(planes)
        inputs = count * channels * (1 + joint) + noise_aware
        outputs = 4 + (count if self.soft else 0)
        sizes: dict[str, Any] = {"filters": filters, "levels": levels, "stem": stem}
        # What a linear head begins at: the middle of both ranges; a soft one adds to what it chose.
        start = 0.0 if self.soft else 0.5
        if body == "naf":
            self.enhancement: MultiScaleNetwork = NafNet(inputs, outputs, blocks=blocks, start=start, **sizes)
        else:
            self.enhancement = UNet(inputs, outputs, attention=attention, start=start, **sizes)
        self.choice = PlaneChoice(capture, planes)
        steps = (Refinement(capture, planes, options, noise_aware, blocks=blocks, **sizes) for _ in range(refinements))
        self.refinements = cast("Sequence[Refinement]", nn.ModuleList(steps))
        self.repeats = repeats

    @property
    def plane_weights(self) -> list[PlaneWeights]:
        """Which weights belong to planes, of each body."""
        channels = len(self.inversion.channels)
        inversions = {"inversion": self.inversion, "joint": self.joint}
        own = _plane_weights("", self.enhancement, inversions, channels, 0, self.soft)
        return [own] + [
            _plane_weights(f"refinements.{n}.", each.enhancement, {"inversion": each.inversion}, channels, 1, True)
            for n, each in enumerate(self.refinements)
        ]

    @staticmethod
    @abstractmethod
    def planes_of(capture: CaptureModel) -> Sequence[int]:
        """Return the planes of a camera's stack that the network inverts at."""

    def forward(self, measurement: Tensor) -> Estimate:
        """Return the estimate of measurements ``(B, C, H, W)``, DN / 2^bits."""
        inverted = self.invert(measurement)
        return self.refine(self.enhance(inverted), inverted)

    def invert(self, measurement: Tensor) -> Inverted:
        """Return what the measurements are inverted to."""
        first = self.inversion
        check_measurement(measurement, first.offset, first.rows, first.columns)
        with torch.autocast(measurement.device.type, enabled=False):
            light = first.light(measurement)
            noise = noise_ratio(light) if self.noise_aware else None
            spectrum = first.spectrum(light)
            volumes = [each.volume(spectrum, noise) for each in (first, self.joint) if each is not None]
            return Inverted(torch.stack(volumes, dim=1), light, noise)

    def enhance(self, inverted: Inverted) -> Surface:
        """Return the first estimate; without a soft head it has no logits of planes."""
        volumes, _, noise = inverted
        inputs = volumes.flatten(1, 3)
        if noise is not None:
            inputs = torch.cat([inputs, level_image(noise, inputs)], dim=1)
        image, disparity, logits = self.enhancement(inputs).split(
            [3, 1, len(self.choice.disparities) if self.soft else 0], 1
        )
        if not self.soft:
            return Surface(image, disparity, logits)
        with torch.autocast(volumes.device.type, enabled=False):
            logits = logits.to(volumes)
            weights = logits.softmax(dim=1)
            chosen = self.choice.light(volumes[:, 0], weights).clamp(0, MOST_RADIANCE)
            image = image + linear_to_srgb(chosen, 1.0, clip=False)
            return Surface(image, disparity + self.choice.disparity(weights), logits)

    def refine(self, surface: Surface, inverted: Inverted) -> Estimate:
        """Return the estimate of the image after all refinement steps."""
        _, light, noise = inverted
        level = None if noise is None else level_image(noise, surface.image)
        for each in (*self.refinements, *list(self.refinements)[-1:] * self.repeats):
            surface = each(surface, light, noise, level)
        return Estimate(surface.image[self.image], surface.disparity[self.image])


def _plane_weights(
    prefix: str,
    body: MultiScaleNetwork,
    inversions: Mapping[str, RegularisedInversion | None],
    channels: int,
    choice: int,
    soft: bool,
) -> PlaneWeights:
    own = {name: each for name, each in inversions.items() if each is not None}
    head = [f"{prefix}enhancement.head.{key}" for key, _ in body.head.named_parameters()]
    return PlaneWeights(
        per_plane=tuple(f"{prefix}{name}.{key}" for name, each in own.items() for key, _ in each.named_parameters()),
        first=f"{prefix}enhancement.{body.first_weight}",
        volumes=len(own),
        width=(channels + choice) * body.stem**2,
        choice=choice * body.stem**2,
        last=tuple(head) if soft else (),
        fixed=4 * body.stem**2,
        stem=body.stem**2,
    )


class FlatNet3D(FlatNet):
    """Learned inversion at all depths of the stack, then the body: equations 4.10 and 4.11 of the thesis."""

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


_THESIS: dict[str, Any] = {"noise_aware": False, "joint": False, "refinements": 0, "repeats": 0, "head": "linear"}
_OURS: dict[str, Any] = {
    **{"body": "naf", "blocks": 1, "stem": 1, "noise_aware": True},
    **{"joint": True, "refinements": 0, "repeats": 0, "head": "soft"},
}
SIZES: dict[str, dict[str, Any]] = {
    "thesis": {"body": "unet", "filters": 64, "levels": 5, "attention": True, "stem": 1} | _THESIS,
    "compact": _OURS | {"filters": 24, "levels": 4},
    "tiny": _OURS | {"filters": 8, "levels": 3},
}
FIRST_VERSION: dict[str, Any] = {"body": "unet", "blocks": 1} | _THESIS
"""What all networks were before checkpoints said it: version 1 of their format."""


class LearnedMethod:
    """A network that stands beside the classical methods; see `learning.method.Method`.

    Its weights, mode and device stay as they are, and may change between reconstructions.
    """

    def __init__(self, name: str, network: FlatNet, capture: CaptureModel) -> None:
        self.name, self.network, self.capture = name, network, capture

    def to(self, device: torch.device | str) -> Self:
        """Move the network to a device, and return this."""
        self.network.to(device)
        return self

    def reconstruct(self, measurement: Tensor, clock: Clock | None = None) -> Estimate:
        """Return the estimate of measurements ``(B, C, H, W)``; stages ``inversion``, ``network`` and ``refinement``."""
        clock = clock or Clock(measurement.device)
        with inference(self.network):
            with clock.stage("inversion"):
                inverted = self.network.invert(measurement)
            with clock.stage("network"):
                surface = self.network.enhance(inverted)
            with clock.stage("refinement" if self.network.refinements else "network"):
                return self.network.refine(surface, inverted)
